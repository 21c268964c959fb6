# SPDX-License-Identifier: Apache-2.0
"""
Small motion of the closed loop, sampled at the servo cycles.

The machine at a pose is linearised, M z'' + D z' + K z = B i, dry friction left out; the current loop
is a first-order lag; the encoders are read with their delay, and the current command is held over a
servo cycle. What the servo sees is then a linear system with one step per servo cycle, exactly
(`SampledPlant`), and so is the servo without its limits (`ServoLaw`): proportional, derivative and
integral gain, notch, feedback filter and command delay. The loop is stable if no eigenvalue of both
together lies outside the unit circle. Growth rates are log |eigenvalue| / cycle in 1/s, frequencies
below half of the servo rate (what is above is folded).

What it is for: to see within milliseconds whether sampling and delay have turned the derivative
gain into negative damping of a structural mode, and how far the gains are from that (`tuning`). The
verdict on a machine comes from running it: friction may hold a mode that grows here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from waferbot_lockstep.layout import SHIPPED
from waferbot_lockstep.timing import Timing
from waferbot_plant import motors
from waferbot_plant.modes import damping_matrix, stiffness_at
from waferbot_plant.plant import Machine, mass_matrix

Matrix = NDArray[np.float64]

CURRENT_LOOP_HZ = 1500.0
"""Bandwidth that the gains of the amplifiers' current loops are set for, Hz."""

NOTCH = ('Ixx36', 'Ixx37', 'Ixx38', 'Ixx39')


@dataclass(frozen=True)
class LoopMode:
    """A mode of the closed loop: growth rate in 1/s (negative decays), frequency in Hz."""

    growth_rate: float
    frequency_hz: float


@dataclass(frozen=True, eq=False)
class SampledPlant:
    """
    Machine and amplifiers over one servo cycle: x(k+1) = A x(k) + B u(k), y(k) = C x(k).

    u (3,) are the current commands, A; y (4,) the counts that the servo sees in cycle k, before it
    commands u(k). x holds z, z', the currents and the counts seen.
    """

    state: Matrix
    input: Matrix
    output: Matrix


@dataclass(frozen=True, eq=False)
class ServoLaw:
    """
    The servo: x(k+1) = A x(k) + B y(k), u(k) = C x(k) + D y(k).

    y are the counts of the encoders, u the currents of the axes, A.
    """

    state: Matrix
    input: Matrix
    output: Matrix
    feedthrough: Matrix


def loop_modes(machine: Machine, servo: np.void, timing: Timing) -> list[LoopMode]:
    """
    Return the modes of a machine under a servo (its `SERVO_PARAMETERS` record), fastest growth
    first.
    """
    law = servo_law(servo, len(machine.layout.encoders))
    return modes_of(closed(sampled_plant(machine, timing), law), timing)


def modes_of(cycle: Matrix, timing: Timing) -> list[LoopMode]:
    """Return the modes of a system that `cycle` takes over one servo cycle, fastest growth first."""
    eigenvalues = np.linalg.eigvals(cycle)
    cycle_s = timing.servo_divider * timing.tick_s
    rates = np.log(eigenvalues[np.abs(eigenvalues) > 1e-12].astype(complex)) / cycle_s
    modes = [
        LoopMode(float(rate.real), float(rate.imag) / (2.0 * np.pi))
        for rate in rates
        if rate.imag >= 0.0
    ]
    return sorted(modes, key=lambda mode: -mode.growth_rate)


def fastest_growth(modes: list[LoopMode], above_hz: float) -> float:
    """
    Return the largest growth rate in 1/s of the modes above a frequency.

    Well damped ones are folded to half of the servo rate and do not count there.
    """
    return max(mode.growth_rate for mode in modes if mode.frequency_hz > above_hz)


def closed(plant: SampledPlant, law: ServoLaw) -> Matrix:
    """Return the matrix of one servo cycle of both together."""
    return np.block(
        [
            [plant.state + plant.input @ law.feedthrough @ plant.output, plant.input @ law.output],
            [law.input @ plant.output, law.state],
        ]
    )


def sampled_plant(
    machine: Machine, timing: Timing, positions: Mapping[str, float] | None = None
) -> SampledPlant:
    """
    Return machine and amplifiers at a pose (m, rad; home by default) over one servo cycle.

    A delay of the encoders of more than a servo cycle is taken as one cycle. Raises `UserError` for an
    axis that the machine does not have.
    """
    steps = timing.servo_divider // timing.encoder_divider
    seen_after = max(0, steps - machine.description.encoder_delay)
    over_encoder_cycle, from_command = _over_encoder_cycle(machine, timing, positions)
    states = len(over_encoder_cycle)
    read = _encoder_matrix(machine, states)

    def after(count: int) -> tuple[Matrix, Matrix]:
        """Return motion after so many encoder cycles: by itself, and by a command that is held."""
        held = sum(
            (np.linalg.matrix_power(over_encoder_cycle, power) for power in range(count)),
            np.zeros((states, states)),
        )
        return np.linalg.matrix_power(over_encoder_cycle, count), held @ from_command

    encoders = len(read)
    size = states + encoders
    state, command = np.zeros((size, size)), np.zeros((size, from_command.shape[1]))
    for rows, reading, count in (
        (slice(0, states), np.eye(states), steps),
        (slice(states, size), read, seen_after),
    ):
        by_itself, by_command = after(count)
        state[rows, :states] = reading @ by_itself
        command[rows] = reading @ by_command
    output = np.zeros((encoders, size))
    output[:, states:] = np.eye(encoders)
    return SampledPlant(state, command, output)


def servo_law(servo: np.void, encoders: int = len(SHIPPED.encoders)) -> ServoLaw:
    """
    Return the servo of all axes from its record of parameters, of a machine with so many encoders.

    An axis' state is its filtered position and velocity feedback of the cycle before (counts), the sum
    of its following errors (counts), and what waits in notch and command delay (A). Limits, deadband
    and a longer cycle (Ixx60) are left out.
    """
    laws = [_axis_law(servo, axis, encoders) for axis in range(len(servo['Ixx03']))]
    return ServoLaw(
        scipy.linalg.block_diag(*(law.state for law in laws)),
        np.vstack([law.input for law in laws]),
        scipy.linalg.block_diag(*(law.output for law in laws)),
        np.vstack([law.feedthrough for law in laws]),
    )


def servo_gain(servo: np.void, axis: int) -> float:
    """Return what 2^-19 Ixx30 stands for, A: current per count of error is that times Ixx08."""
    amperes = float(servo['amplifier_peak_current'][axis]) / 32768.0
    return 2.0**-19 * float(servo['Ixx30'][axis]) * amperes


def _axis_law(servo: np.void, axis: int, encoders: int) -> ServoLaw:
    """Return the servo of one axis."""
    gain = servo_gain(servo, axis)
    proportional = gain * servo['Ixx08'][axis]
    derivative = gain * servo['Ixx31'][axis] * servo['Ixx09'][axis] / 128.0
    integral = proportional * servo['Ixx33'][axis] / 2.0**23
    keeps = servo['feedback_filter'][axis] / (1.0 + servo['feedback_filter'][axis])
    position, velocity = np.zeros(encoders), np.zeros(encoders)
    position[int(servo['Ixx03'][axis])] = 1.0 - keeps
    velocity[int(servo['Ixx04'][axis])] = 1.0 - keeps

    # [filtered position, filtered velocity feedback, integral]; the new ones are kept x + (1 - keeps) y.
    state = np.diag([keeps, keeps, 1.0])
    state[2, 0] = -keeps
    law = ServoLaw(
        state,
        np.vstack([position, velocity, -position]),
        np.array([[-proportional * keeps, derivative * (1.0 - keeps), integral]]),
        (-proportional * position - derivative * velocity)[None, :],
    )
    n1, n2, d1, d2 = (float(servo[name][axis]) for name in NOTCH)
    if any((n1, n2, d1, d2)):
        # y = v + N1 v1 + N2 v2 - D1 y1 - D2 y2, in the transposed direct form.
        notch_state = np.array([[-d1, 1.0], [-d2, 0.0]])
        law = _in_series(
            law, notch_state, np.array([[n1 - d1], [n2 - d2]]), np.array([[1.0, 0.0]]), 1.0
        )
    delay = int(servo['command_delay'][axis])
    if delay:
        law = _in_series(
            law, np.eye(delay, k=-1), np.eye(delay, 1), np.eye(1, delay, delay - 1), 0.0
        )
    return law


def _in_series(
    law: ServoLaw, state: Matrix, given: Matrix, output: Matrix, feedthrough: float
) -> ServoLaw:
    """Return a law with a system of one input and output behind it."""
    return ServoLaw(
        np.block(
            [[law.state, np.zeros((len(law.state), len(state)))], [given @ law.output, state]]
        ),
        np.vstack([law.input, given @ law.feedthrough]),
        np.hstack([feedthrough * law.output, output]),
        feedthrough * law.feedthrough,
    )


def _over_encoder_cycle(
    machine: Machine, timing: Timing, positions: Mapping[str, float] | None
) -> tuple[Matrix, Matrix]:
    """Return how [z, z', currents] goes on over an encoder cycle, by itself and by the command."""
    parameters = machine.parameters()
    state = machine.initial_state(parameters, positions)
    size = len(machine.coordinates)
    mass = np.zeros((size, size))
    mass_matrix(state, parameters, mass)
    axes = len(machine.layout.axes)
    force = np.zeros((size, axes))
    for place, axis in enumerate(machine.layout.axes):
        if axis in machine.description.motors:
            motor = machine.description.motors[axis]
            row, ratio = machine.assembly.placing[motor.coordinate]
            force[row, place] = ratio * motors.force_constant(motor)
    # The amplifier corrects the share 2 pi f dt of its error in a tick: a lag with this rate.
    lag = -np.log(1.0 - 2.0 * np.pi * CURRENT_LOOP_HZ * timing.tick_s) / timing.tick_s
    states = 2 * size + axes
    rates = np.zeros((states + axes, states + axes))
    rates[:size, size : 2 * size] = np.eye(size)
    stiffness = stiffness_at(machine, state, parameters)
    rates[size : 2 * size, :size] = -np.linalg.solve(mass, stiffness)
    rates[size : 2 * size, size : 2 * size] = -np.linalg.solve(mass, damping_matrix(machine))
    rates[size : 2 * size, 2 * size : states] = np.linalg.solve(mass, force)
    rates[2 * size : states, 2 * size : states] = -lag * np.eye(axes)
    rates[2 * size : states, states:] = lag * np.eye(axes)
    held = scipy.linalg.expm(rates * timing.tick_s * timing.encoder_divider)
    return held[:states, :states], held[:states, states:]


def _encoder_matrix(machine: Machine, states: int) -> Matrix:
    """Return counts (encoders,) from [z, z', currents]."""
    layout = machine.layout
    read = np.zeros((len(layout.encoders), states))
    for place, name in enumerate(layout.encoders):
        if name in machine.description.encoders:
            encoder = machine.description.encoders[name]
            column, ratio = machine.assembly.placing[encoder.coordinate]
            read[place, column] = encoder.counts_per_unit * ratio
    return read
