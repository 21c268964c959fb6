# SPDX-License-Identifier: Apache-2.0
"""
Three-phase motors: delta-wound linear (3.4 to 3.8), wye-wound rotary (3.9 to 3.15).

The three winding currents are states. In a delta the windings lie between the terminals (12, 23,
31) and a current can circulate in the triangle; in a wye they lie between terminal and star point,
and Kirchhoff's law (3.15) leaves two of them free. For winding w, with u_w the voltage across it,

    L di_w/dt = u_w - R i_w - k s_w v        force = sum of k s_w i_w

where v is the speed of the coordinate (m/s, rad/s), k the amplitude of the winding's back-EMF
constant and s_w its phase, a sine of the electrical angle. Back-EMF and force use the same k s_w,
so what the current loses electrically is what the mechanism gains; (3.12) to (3.14) leave the
phase out and would not conserve power.

A motor may warm up. Its windings are one heat capacity C (J/K) that gives heat to the air through
one thermal resistance (K/W), and their electrical resistance follows their temperature:

    C dT/dt = sum of R i_w^2 - (T - T_air) / R_thermal        R = R_0 (1 + alpha (T - T_0))

with alpha = 0.393 %/K for copper. These are the heat ports that chapter 7 of the thesis asks for.
Iron losses, and magnets that weaken as they warm, are left out. A motor without heating stays at
T_0.

Convention, shared with the amplifier: line k has the phase sin(angle - 2 pi (k - 1) / 3), with
angle zero at position zero, and line currents of amplitude I in that phase give the largest
positive force,

    force = 3/2 k I (wye)        force = sqrt(3)/2 k I (delta)

A delta winding leads the line that it starts from by 30 degrees, with sqrt(3) times the amplitude
of the equivalent star. Assumption: equal, constant R and L, sinusoidal EMF, no iron loss.

Imperfections
-------------
All are off unless the description names them, and act on k s_w, so on force and back-EMF alike:

    k s_w  becomes  k s_w (1 + b_w) (1 + sum of c_j cos(n_j theta) + d_j sin(n_j theta)) g(I)

- `ripple`: theta is the electrical angle, n_j the order (6 is the usual one of a three-phase motor;
  a fraction counts slower periods); c_j, d_j are relative, -. Torque ripple that grows with the
  current. Cogging, which is there without current, is a force of the mechanism.
- `phase_imbalance`: b_1 and b_2, relative, of the windings 1 and 2 (12 and 23 of a delta); b_3 = 0.
  In a wye the EMFs then need not sum to zero and the star point moves: only what differs from the
  mean of the three acts. In a delta they drive a current round the triangle, which brakes.
- `saturation_current_a`: g(I) = 1 / sqrt(1 + (I / I_s)^2), I the amplitude of the line currents, A.
  At I_s the force is 0.71 of the linear one; it never exceeds the linear one at I_s. Like
  Froehlich's saturation curve, 1 / (1 + |I| / I_s), but without its kink at zero. I is that expected
  at the middle of the step.

Power is conserved with each of them, as force and EMF share their factor: electrical energy =
copper loss + mechanical work + energy in the windings, to rounding. What saturation leaves out: the
inductance, which falls in the real motor, and the difference between the force's constant at a
current and the EMF's (a lossless motor would have the slope of the force over the current there).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError
from waferbot_plant.description import Description, Motor
from waferbot_plant.multibody import sine_and_cosine

NONE, WYE, DELTA = 0, 1, 2
"""How a motor is wound; NONE where an axis has no motor."""

RIPPLES = 4
"""Places for ripples of one motor."""

COLD_DEGC = 25.0
"""Temperature of the windings of a motor that does not warm up: that of most data sheets."""

_HALF_ROOT_3 = math.sqrt(3.0) / 2.0


def parameter_fields(motors: int) -> list[tuple]:
    """
    Return the parameters of so many motors, a place for each axis.

    Of a winding: resistance in ohm at the temperature `resistance_at` (degC) and its rise (1/K);
    inductance in H, back-EMF amplitude in V s/m or V s/rad. Of all windings of a motor together: heat
    capacity in J/K, zero if the motor does not warm up, heat flow to the air in W/K, temperatures in
    degC. `motor_imperfect` tells whether what follows it is looked at at all; `saturation` is 1 / I_s^2
    in 1/A2, zero without.
    """
    return [
        ('winding', 'i8', (motors,)),
        ('motor_coordinate', 'i8', (motors,)),
        ('motor_ratio', 'f8', (motors,)),
        ('electrical_gain', 'f8', (motors,)),
        ('resistance', 'f8', (motors,)),
        ('inductance', 'f8', (motors,)),
        ('back_emf', 'f8', (motors,)),
        ('resistance_at', 'f8', (motors,)),
        ('resistance_rise', 'f8', (motors,)),
        ('heat_capacity', 'f8', (motors,)),
        ('heat_to_air', 'f8', (motors,)),
        ('air_temperature', 'f8', (motors,)),
        ('start_temperature', 'f8', (motors,)),
        ('motor_imperfect', 'i8', (motors,)),
        ('saturation', 'f8', (motors,)),
        ('phase_imbalance', 'f8', (motors, 2)),
        ('ripple_count', 'i8', (motors,)),
        ('ripple_order', 'f8', (motors, RIPPLES)),
        ('ripple_cosine', 'f8', (motors, RIPPLES)),
        ('ripple_sine', 'f8', (motors, RIPPLES)),
    ]


def state_fields(motors: int) -> list[tuple]:
    """
    Return the state of so many motors.

    Winding currents (A); whether the amplifier leaves the terminals open; energy taken from the
    amplifier and turned to heat in the copper since the start (J); temperature of the windings (degC)
    and heat that they gave to the air since the start (J); and the workings of a step.
    """
    return [
        ('winding_current', 'f8', (motors, 3)),
        ('terminals_open', 'i8', (motors,)),
        ('electrical_energy', 'f8', (motors,)),
        ('copper_loss', 'f8', (motors,)),
        ('winding_temperature', 'f8', (motors,)),
        ('heat_given_to_air', 'f8', (motors,)),
        ('winding_phase', 'f8', (motors, 3)),
        ('driven_current', 'f8', (motors, 3)),
        ('current_per_speed', 'f8', (motors,)),
        ('phase_squares', 'f8', (motors,)),
    ]


def winding_data(motor: Motor) -> tuple[int, float, float, float]:
    """
    Return (how wound, resistance, inductance, back-EMF constant) of one winding.

    Data sheets state values from lead to lead. Delta, (3.4), (3.5): one winding in parallel with
    two, so R = 3/2 R_ll, L = 3/2 L_ll, and the EMF is the winding's. Wye, (3.9) to (3.11): two
    windings in series, so R = R_ll / 2, L = L_ll / 2, k = k_ll / sqrt(3).
    """
    if motor.winding == 'delta':
        return DELTA, 1.5 * motor.resistance, 1.5 * motor.inductance, motor.back_emf
    return WYE, motor.resistance / 2, motor.inductance / 2, motor.back_emf / math.sqrt(3.0)


def force_constant(motor: Motor) -> float:
    """Return force or torque per ampere of line current amplitude, N/A or Nm/A."""
    return _HALF_ROOT_3 * motor.back_emf


def back_emf_of(force_per_ampere: float) -> float:
    """Return the back-EMF lead to lead, V s/m or V s/rad, of a `force_constant`."""
    return force_per_ampere / _HALF_ROOT_3


def check_windings(description: Description) -> None:
    """
    Raise `UserError` if a motor cannot be driven by an amplifier's voltages.

    One that is known by its force per ampere alone, or whose description has the lag of a drive.
    """
    for axis, motor in description.motors.items():
        if motor.by_force:
            raise UserError(
                f'{description.name}: motor {axis} is known by its force per ampere alone, which is '
                'enough for measured logs; to run it with an amplifier, give winding, resistance, '
                'inductance and back-EMF (docs/machine_description.md)'
            )
        if motor.lag:
            raise UserError(
                f'{description.name}: motor {axis} has the lag of a drive that is not modelled, '
                f'{motor.lag:g} s, which is for measured logs; to run it with an amplifier, which has '
                'its own, leave lag_s out'
            )


def heating_data(motor: Motor) -> dict[str, float]:
    """Return the thermal parameters of a motor; those of one that stays cold have no effect."""
    heating = motor.heating
    if heating is None:
        return dict.fromkeys(('resistance_at', 'air_temperature', 'start_temperature'), COLD_DEGC)
    return {
        'resistance_at': heating.resistance_at,
        'resistance_rise': heating.coefficient,
        'heat_capacity': heating.capacity,
        'heat_to_air': 1.0 / heating.to_air,
        'air_temperature': heating.air,
        'start_temperature': heating.start,
    }


def imperfection_data(motor: Motor) -> dict[str, Any]:
    """Return the parameters of a motor's imperfections, all zero where it has none."""
    ripples = np.zeros((3, RIPPLES))
    for place, ripple in enumerate(motor.ripple):
        ripples[:, place] = ripple.order, ripple.cosine, ripple.sine
    saturated = motor.saturation_current > 0.0
    return {
        'motor_imperfect': saturated or bool(motor.ripple) or any(motor.phase_imbalance),
        'saturation': motor.saturation_current**-2 if saturated else 0.0,
        'phase_imbalance': motor.phase_imbalance,
        'ripple_count': len(motor.ripple),
        'ripple_order': ripples[0],
        'ripple_cosine': ripples[1],
        'ripple_sine': ripples[2],
    }


def motor_data(motor: Motor) -> dict[str, Any]:
    """Return all parameters of a motor by their names, but for the coordinate that it drives."""
    winding, resistance, inductance, back_emf = winding_data(motor)
    return {
        'winding': winding,
        'resistance': resistance,
        'inductance': inductance,
        'back_emf': back_emf,
        'electrical_gain': motor.electrical_gain,
        **heating_data(motor),
        **imperfection_data(motor),
    }


def current_of_force(
    parameters: np.ndarray, motor: int, electrical_angle: float, force: float
) -> float:
    """
    Return the amplitude of line currents (A) in phase with the motor that makes `force` (N, Nm).

    With a the force per ampere of the motor at that angle and c = 1 / I_s^2, the inverse of
    F = a I / sqrt(1 + c I^2). Infinite if the saturated motor cannot make that force.
    """
    p = parameters[0]
    constant = force_constant_at(p, motor, electrical_angle)
    square = constant * constant - p['saturation'][motor] * force * force
    return math.copysign(math.inf, force) if square <= 0.0 else force / math.sqrt(square)


@compiled
def lag_step(told, acting, lag, step):
    """
    Return the mean over a step of what follows `told` with a first-order lag, and its value at the end.

    T di/dt = i_told - i,    i_told held over the step dt,

        mean = i_told + (i - i_told) (T / dt) (1 - e^(-dt / T))
        end  = i_told + (i - i_told) e^(-dt / T)

    with T = `lag` and dt = `step` in s, i = `acting` at the beginning, in the unit of `told`. Exact; for
    a short T it is a delay of T. T = 0: at once.
    """
    if lag == 0.0:
        return told, told
    left = math.exp(-step / lag)
    return told + (acting - told) * (lag / step) * (1.0 - left), told + (acting - told) * left


@compiled
def lagged(told, lag, step):
    """
    Return what follows each column of `told` (n, motors) by its `lag` (motors,) s, mean in each `step`.

    It begins with the first value, and where nothing is known (NaN), with the first one behind.
    """
    mean = np.empty_like(told)
    for motor in range(told.shape[1]):
        acting = np.nan
        for tick in range(told.shape[0]):
            now = told[tick, motor]
            if acting != acting:
                acting = now
            mean[tick, motor], acting = lag_step(now, acting, lag[motor], step)
    return mean


@compiled
def winding_phases(winding, angle):
    """Return s_1, s_2, s_3 of perfect windings at an electrical angle in rad."""
    sine, cosine = sine_and_cosine(angle)
    if winding == DELTA:
        return (
            _HALF_ROOT_3 * sine + 0.5 * cosine,
            -cosine,
            -_HALF_ROOT_3 * sine + 0.5 * cosine,
        )
    return sine, -0.5 * sine - _HALF_ROOT_3 * cosine, -0.5 * sine + _HALF_ROOT_3 * cosine


@compiled
def imperfect_phases(p, motor, angle):
    """Return s_1, s_2, s_3 with imbalance and ripple, without saturation; see the module."""
    first, second, third = winding_phases(p['winding'][motor], angle)
    factor = 1.0
    for place in range(p['ripple_count'][motor]):
        sine, cosine = sine_and_cosine(p['ripple_order'][motor, place] * angle)
        factor += p['ripple_cosine'][motor, place] * cosine
        factor += p['ripple_sine'][motor, place] * sine
    first *= factor * (1.0 + p['phase_imbalance'][motor, 0])
    second *= factor * (1.0 + p['phase_imbalance'][motor, 1])
    third *= factor
    if p['winding'][motor] == WYE:
        mean = (first + second + third) / 3.0
        return first - mean, second - mean, third - mean
    return first, second, third


@compiled
def saturation_factor(p, motor, first, second, third):
    """Return g = 1 / sqrt(1 + (I / I_s)^2) at the three winding currents, A."""
    if p['winding'][motor] == DELTA:
        first, second = first - third, second - first
    squared = (4.0 / 3.0) * (first * first + first * second + second * second)
    return 1.0 / math.sqrt(1.0 + p['saturation'][motor] * squared)


@compiled
def winding_currents(winding, first, second):
    """Return the three winding currents (A) of line currents 1, 2 with none round the triangle."""
    third = -first - second
    if winding == DELTA:
        return (first - second) / 3.0, (second - third) / 3.0, (third - first) / 3.0
    return first, second, third


@compiled
def linear_force(p, motor, angle, first, second):
    """Return the force (N, Nm) of line currents 1, 2 (A), with all but saturation."""
    one, two, three = winding_currents(p['winding'][motor], first, second)
    phase_1, phase_2, phase_3 = imperfect_phases(p, motor, angle)
    return p['back_emf'][motor] * (phase_1 * one + phase_2 * two + phase_3 * three)


@compiled
def force_of_line_currents(p, motor, angle, first, second):
    """
    Return the force (N, Nm) of a motor at an electrical angle (rad) with line currents 1, 2 (A).

    With ripple, imbalance and saturation; without a current round the triangle of a delta; zero
    where there is no motor.
    """
    one, two, three = winding_currents(p['winding'][motor], first, second)
    return linear_force(p, motor, angle, first, second) * saturation_factor(
        p, motor, one, two, three
    )


@compiled
def lines_of_vector(angle, q, d):
    """Return lines 1 and 2 of q sin(theta_k) + d cos(theta_k), theta_k = angle - 120 (k - 1)."""
    sine, cosine = sine_and_cosine(angle)
    first = q * sine + d * cosine
    return first, _HALF_ROOT_3 * (d * sine - q * cosine) - 0.5 * first


@compiled
def force_at_angle(p, motor, angle, q, d):
    """Return the force as `force_of_currents` does, at an electrical angle in rad."""
    first, second = lines_of_vector(angle, q, d)
    return force_of_line_currents(p, motor, angle, first, second)


@compiled
def force_constant_at(p, motor, angle):
    """Return force per ampere of q at an electrical angle (rad), before saturation, N/A, Nm/A."""
    first, second = lines_of_vector(angle, 1.0, 0.0)
    return linear_force(p, motor, angle, first, second)


@compiled
def force_of_currents(s, p, motor, q, d):
    """
    Return the force (N, Nm) of a motor where it stands, for measured currents q and d (A).

    q and d are peaks of the sine: line k carries q sin(theta_k) + d cos(theta_k), with theta_k the
    electrical angle less 120 degrees for each line. So q is in phase with the back-EMF and makes
    force; d leads it by 90 degrees and makes none, but adds to what saturates. Of a perfect motor
    the force is q times `force_constant`. Leaves out a current round the triangle of a delta. For
    models that are driven by measured currents: the windings of the state are not looked at.
    """
    position = p['motor_ratio'][motor] * s['position'][p['motor_coordinate'][motor]]
    return force_at_angle(p, motor, p['electrical_gain'][motor] * position, q, d)


@compiled
def winding_resistance(s, p, motor):
    """Return the resistance of one winding at its present temperature, ohm."""
    warmer = s['winding_temperature'][motor] - p['resistance_at'][motor]
    return p['resistance'][motor] * (1.0 + p['resistance_rise'][motor] * warmer)


@compiled
def begin_step(s, p, position, voltage, step):
    """
    Solve the windings' equations for a step of `step` seconds as far as that goes without the
    speed.

    The implicit midpoint rule on L di/dt gives for each winding its mean current over the step,

        i = (i_0 + step/(2L) (u - k s v)) / (1 + step R/(2L)) = driven - per_speed s v,

    linear in the mean speed v, which comes out of the mechanism's equations only later. `position`
    (n,) holds the coordinates at the middle of the step, `voltage` (3 axes,) the terminal voltages. An
    open terminal carries no current; the energy of the windings goes back to the amplifier within
    one step (really, through its diodes, in a few).
    """
    for motor in range(len(p['winding'])):
        winding = p['winding'][motor]
        if winding == NONE:
            continue
        phase = s['winding_phase'][motor]
        driven = s['driven_current'][motor]
        current = s['winding_current'][motor]
        angle = (
            p['electrical_gain'][motor]
            * p['motor_ratio'][motor]
            * position[p['motor_coordinate'][motor]]
        )
        phase[0], phase[1], phase[2] = winding_phases(winding, angle)
        first = voltage[3 * motor]
        second = voltage[3 * motor + 1]
        third = voltage[3 * motor + 2]
        if winding == DELTA:
            first, second, third = first - second, second - third, third - first
        else:
            star = (first + second + third) / 3.0
            first, second, third = first - star, second - star, third - star
        if s['terminals_open'][motor]:
            circulating = 0.0
            if winding == DELTA:
                circulating = (current[0] + current[1] + current[2]) / 3.0
            squares = current[0] * current[0] + current[1] * current[1] + current[2] * current[2]
            s['electrical_energy'][motor] -= (
                0.5 * p['inductance'][motor] * (squares - 3.0 * circulating * circulating)
            )
            current[0] = current[1] = current[2] = circulating
            first = second = third = 0.0
        half = 0.5 * step / p['inductance'][motor]
        denominator = 1.0 + half * winding_resistance(s, p, motor)
        driven[0] = (current[0] + half * first) / denominator
        driven[1] = (current[1] + half * second) / denominator
        driven[2] = (current[2] + half * third) / denominator
        s['current_per_speed'][motor] = (
            0.0 if s['terminals_open'][motor] else half * p['back_emf'][motor] / denominator
        )
        s['phase_squares'][motor] = 1.5
        if p['motor_imperfect'][motor]:
            _distort(s, p, motor, angle, half * p['back_emf'][motor] / denominator)


@compiled
def _distort(s, p, motor, angle, current_per_speed):
    """
    Give the windings of a step their imperfect phases.

    The current that saturates is the mean one of the step, with the speed that is expected of it.
    Of an open delta only the mean of the three EMFs has a circuit, the triangle.
    """
    phase = s['winding_phase'][motor]
    current = s['winding_current'][motor]
    driven = s['driven_current'][motor]
    phase[0], phase[1], phase[2] = imperfect_phases(p, motor, angle)
    if s['terminals_open'][motor] and p['winding'][motor] == DELTA:
        mean = (phase[0] + phase[1] + phase[2]) / 3.0
        phase[0] = phase[1] = phase[2] = mean
        s['current_per_speed'][motor] = current_per_speed
    if p['saturation'][motor] > 0.0:
        speed = p['motor_ratio'][motor] * s['middle_velocity'][p['motor_coordinate'][motor]]
        slope = s['current_per_speed'][motor] * speed
        slope *= saturation_factor(p, motor, current[0], current[1], current[2])
        factor = saturation_factor(
            p,
            motor,
            driven[0] - slope * phase[0],
            driven[1] - slope * phase[1],
            driven[2] - slope * phase[2],
        )
        for place in range(3):
            phase[place] *= factor
    s['phase_squares'][motor] = phase[0] * phase[0] + phase[1] * phase[1] + phase[2] * phase[2]


@compiled
def force_and_damping(s, p, motor):
    """
    Return (f, d): the mean force of a motor over the step is f - d v, N and N s/m (Nm, Nm s/rad).

    The squares of the three phases sum to 3/2 in a perfect motor.
    """
    phase = s['winding_phase'][motor]
    driven = s['driven_current'][motor]
    back_emf = p['back_emf'][motor]
    force = back_emf * (phase[0] * driven[0] + phase[1] * driven[1] + phase[2] * driven[2])
    return force, s['phase_squares'][motor] * back_emf * s['current_per_speed'][motor]


@compiled
def finish_step(s, p, mean_speed, voltage, step):
    """
    Finish the windings' step, now that the mean speed (n,) of the coordinates is known.

    Adds the electrical energy supplied and the copper loss of the step to the ledger of `s`, J.
    """
    for motor in range(len(p['winding'])):
        winding = p['winding'][motor]
        if winding == NONE:
            continue
        phase = s['winding_phase'][motor]
        driven = s['driven_current'][motor]
        current = s['winding_current'][motor]
        speed = p['motor_ratio'][motor] * mean_speed[p['motor_coordinate'][motor]]
        slope = s['current_per_speed'][motor] * speed
        squares = 0.0
        supplied = 0.0
        for place in range(3):
            mean = driven[place] - slope * phase[place]
            after = place + 1 if place < 2 else 0
            across = voltage[3 * motor + place]
            if winding == DELTA:
                across -= voltage[3 * motor + after]
            squares += mean * mean
            supplied += across * mean
            current[place] = 2.0 * mean - current[place]
        if s['terminals_open'][motor]:
            supplied = 0.0
        heat = winding_resistance(s, p, motor) * squares * step
        s['copper_loss'][motor] += heat
        s['electrical_energy'][motor] += supplied * step
        if p['heat_capacity'][motor] > 0.0:
            _warm(s, p, motor, heat, step)


@compiled
def _warm(s, p, motor, heat, step):
    """
    Warm the windings of a motor by the heat (J) of a step; implicit midpoint rule, as the rest.

    The resistance used within the step is that of its beginning: an error of first order in the
    step, 1e-8 of the loss, as temperatures take minutes.
    """
    to_air = p['heat_to_air'][motor]
    capacity = p['heat_capacity'][motor]
    warmer = s['winding_temperature'][motor] - p['air_temperature'][motor]
    change = (heat - step * to_air * warmer) / (capacity + 0.5 * step * to_air)
    s['winding_temperature'][motor] += change
    s['heat_given_to_air'][motor] += step * to_air * (warmer + 0.5 * change)


@compiled
def magnetic_energy(s, p):
    """Return the energy stored in all windings, sum of L i^2 / 2, J."""
    energy = 0.0
    for motor in range(len(p['winding'])):
        for place in range(3):
            current = s['winding_current'][motor, place]
            energy += 0.5 * p['inductance'][motor] * current * current
    return energy


@compiled
def copper_loss_power(s, p, motor):
    """Return the heat in the windings of one motor, sum of R i^2, W."""
    current = s['winding_current'][motor]
    squares = current[0] * current[0] + current[1] * current[1] + current[2] * current[2]
    return winding_resistance(s, p, motor) * squares


@compiled
def measure_line_currents(s, p, line_currents):
    """
    Fill `line_currents` (2 axes,) with lines 1 and 2 of each motor, A, positive into the motor.

    Lines of a delta: i_1 = i_12 - i_31, i_2 = i_23 - i_12. The third is minus the sum of the two.
    """
    for motor in range(len(p['winding'])):
        current = s['winding_current'][motor]
        if p['winding'][motor] == DELTA:
            line_currents[2 * motor] = current[0] - current[2]
            line_currents[2 * motor + 1] = current[1] - current[0]
        else:
            line_currents[2 * motor] = current[0]
            line_currents[2 * motor + 1] = current[1]


def set_line_currents(state: np.ndarray, parameters: np.ndarray, motor: int, lines: tuple) -> None:
    """Set the winding currents of a motor from its line currents (1, 2), A, none circulating."""
    first, second = lines
    winding = int(parameters[0]['winding'][motor])
    state[0]['winding_current'][motor] = winding_currents(winding, first, second)
