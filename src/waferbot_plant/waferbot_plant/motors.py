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
of the equivalent star. Assumption: equal, constant R and L, no saturation, no cogging, sinusoidal
EMF.
"""

from __future__ import annotations

import math

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_plant.description import Motor
from waferbot_plant.multibody import sine_and_cosine

MOTORS = 3
"""Places for motors: the axes of the contract."""

NONE, WYE, DELTA = 0, 1, 2
"""How a motor is wound; NONE where an axis has no motor."""

COLD_DEGC = 25.0
"""Temperature of the windings of a motor that does not warm up: that of most data sheets."""

_HALF_ROOT_3 = math.sqrt(3.0) / 2.0

PARAMETER_FIELDS: list[tuple] = [
    ('winding', 'i8', (MOTORS,)),
    ('motor_coordinate', 'i8', (MOTORS,)),
    ('motor_ratio', 'f8', (MOTORS,)),
    ('electrical_gain', 'f8', (MOTORS,)),
    ('resistance', 'f8', (MOTORS,)),
    ('inductance', 'f8', (MOTORS,)),
    ('back_emf', 'f8', (MOTORS,)),
    ('resistance_at', 'f8', (MOTORS,)),
    ('resistance_rise', 'f8', (MOTORS,)),
    ('heat_capacity', 'f8', (MOTORS,)),
    ('heat_to_air', 'f8', (MOTORS,)),
    ('air_temperature', 'f8', (MOTORS,)),
]
"""
Of a winding: resistance in ohm at the temperature `resistance_at` (degC) and its rise (1/K);
inductance in H, back-EMF amplitude in V s/m or V s/rad. Of all windings of a motor together: heat
capacity in J/K, zero if the motor does not warm up, and heat flow to the air in W/K.
"""

STATE_FIELDS: list[tuple] = [
    ('winding_current', 'f8', (MOTORS, 3)),
    ('terminals_open', 'i8', (MOTORS,)),
    ('electrical_energy', 'f8', (MOTORS,)),
    ('copper_loss', 'f8', (MOTORS,)),
    ('winding_temperature', 'f8', (MOTORS,)),
    ('heat_given_to_air', 'f8', (MOTORS,)),
    ('winding_phase', 'f8', (MOTORS, 3)),
    ('driven_current', 'f8', (MOTORS, 3)),
    ('current_per_speed', 'f8', (MOTORS,)),
]
"""
Winding currents (A); whether the amplifier leaves the terminals open; energy taken from the
amplifier and turned to heat in the copper since the start (J); temperature of the windings (degC)
and heat that they gave to the air since the start (J); and the workings of a step.
"""


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


def heating_data(motor: Motor) -> dict[str, float]:
    """Return the thermal parameters of a motor; those of one that stays cold have no effect."""
    heating = motor.heating
    if heating is None:
        return {'resistance_at': COLD_DEGC, 'air_temperature': COLD_DEGC}
    return {
        'resistance_at': heating.resistance_at,
        'resistance_rise': heating.coefficient,
        'heat_capacity': heating.capacity,
        'heat_to_air': 1.0 / heating.to_air,
        'air_temperature': heating.air,
    }


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
    (n,) holds the coordinates at the middle of the step, `voltage` (9,) the terminal voltages. An
    open terminal carries no current; the energy of the windings goes back to the amplifier within
    one step (really, through its diodes, in a few).
    """
    for motor in range(MOTORS):
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
        sine, cosine = sine_and_cosine(angle)
        first = voltage[3 * motor]
        second = voltage[3 * motor + 1]
        third = voltage[3 * motor + 2]
        if winding == DELTA:
            phase[0] = _HALF_ROOT_3 * sine + 0.5 * cosine
            phase[1] = -cosine
            phase[2] = -_HALF_ROOT_3 * sine + 0.5 * cosine
            first, second, third = first - second, second - third, third - first
        else:
            phase[0] = sine
            phase[1] = -0.5 * sine - _HALF_ROOT_3 * cosine
            phase[2] = -0.5 * sine + _HALF_ROOT_3 * cosine
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


@compiled
def force_and_damping(s, p, motor):
    """
    Return (f, d): the mean force of a motor over the step is f - d v, N and N s/m (Nm, Nm s/rad).

    The squares of the three phases always sum to 3/2.
    """
    phase = s['winding_phase'][motor]
    driven = s['driven_current'][motor]
    back_emf = p['back_emf'][motor]
    force = back_emf * (phase[0] * driven[0] + phase[1] * driven[1] + phase[2] * driven[2])
    return force, 1.5 * back_emf * s['current_per_speed'][motor]


@compiled
def finish_step(s, p, mean_speed, voltage, step):
    """
    Finish the windings' step, now that the mean speed (n,) of the coordinates is known.

    Adds the electrical energy supplied and the copper loss of the step to the ledger of `s`, J.
    """
    for motor in range(MOTORS):
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
    for motor in range(MOTORS):
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
    Fill `line_currents` (6,) with lines 1 and 2 of each motor, A, positive into the motor.

    Lines of a delta: i_1 = i_12 - i_31, i_2 = i_23 - i_12. The third is minus the sum of the two.
    """
    for motor in range(MOTORS):
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
    third = -first - second
    currents = np.array([first, second, third])
    if parameters[0]['winding'][motor] == DELTA:
        currents = (currents - np.roll(currents, -1)) / 3.0
    state[0]['winding_current'][motor] = currents
