# SPDX-License-Identifier: Apache-2.0
"""
Small motion of the closed loop: its eigenvalues over one servo cycle.

The machine at home is linearised, M z'' + D z' + K z = B i, dry friction left out; the current loop
is a first-order lag; the encoders are read with their delay, the servo law is that of the PMAC
without limits, and the current command is held over a servo cycle. One servo cycle is then a
matrix, and the loop is stable if no eigenvalue lies outside the unit circle. Growth rates are
log |eigenvalue| / cycle in 1/s, frequencies below half of the servo rate (what is above is folded).

What it is for: to see within milliseconds whether sampling and delay have turned the derivative
gain into negative damping of a structural mode. The verdict on a machine comes from running it:
friction may hold a mode that grows here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_plant import motors
from waferbot_plant.modes import damping_matrix, stiffness_at
from waferbot_plant.plant import Machine, mass_matrix

Matrix = NDArray[np.float64]

CURRENT_LOOP_HZ = 1500.0
"""Bandwidth that the gains of the amplifiers' current loops are set for, Hz."""


@dataclass(frozen=True)
class LoopMode:
    """A mode of the closed loop: growth rate in 1/s (negative decays), frequency in Hz."""

    growth_rate: float
    frequency_hz: float


def loop_modes(machine: Machine, servo: np.void, timing: Timing) -> list[LoopMode]:
    """
    Return the modes of a machine under a servo (its `SERVO_PARAMETERS` record), fastest growth
    first.
    """
    eigenvalues = np.linalg.eigvals(_one_cycle(machine, servo, timing))
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


def _one_cycle(machine: Machine, servo: np.void, timing: Timing) -> Matrix:
    """
    Return the matrix of one servo cycle.

    It acts on [z, z', currents (3), counts seen (4), counts seen a cycle before (4), integrals of
    the following error (3)].
    """
    steps = timing.servo_divider // timing.encoder_divider
    delay = machine.description.encoder_delay
    over_encoder_cycle, from_command = _machine_over_encoder_cycle(machine, timing)
    states = len(over_encoder_cycle)
    read = _encoder_matrix(machine, states)
    proportional, derivative, integral, error = _servo_matrices(servo, timing)

    size = states + 11
    motion, seen = slice(0, states), slice(states, states + 4)
    before, integrals = slice(states + 4, states + 8), slice(states + 8, size)
    command = np.zeros((3, size))
    command[:, seen] = proportional + derivative
    command[:, before] = -derivative
    command[:, integrals] = integral

    def after(count: int) -> Matrix:
        """Return motion after so many encoder cycles, with the command held."""
        result = np.zeros((states, size))
        result[:, motion] = np.linalg.matrix_power(over_encoder_cycle, count)
        held = sum(
            (np.linalg.matrix_power(over_encoder_cycle, power) for power in range(count)),
            np.zeros((states, states)),
        )
        return result + held @ from_command @ command

    cycle = np.zeros((size, size))
    cycle[motion] = after(steps)
    # A delay of more than a servo cycle would need more memory; it is taken as one cycle.
    cycle[seen] = read @ after(max(0, steps - delay))
    cycle[before, seen] = np.eye(4)
    cycle[integrals, integrals] = np.eye(3)
    cycle[integrals, seen] = error
    return cycle


def _machine_over_encoder_cycle(machine: Machine, timing: Timing) -> tuple[Matrix, Matrix]:
    """Return how [z, z', currents] goes on over an encoder cycle, by itself and by the command."""
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    size = len(machine.coordinates)
    mass = np.zeros((size, size))
    mass_matrix(state, parameters, mass)
    force = np.zeros((size, len(AXES)))
    for place, axis in enumerate(AXES):
        motor = machine.description.motors[axis]
        row, ratio = machine.assembly.placing[motor.coordinate]
        force[row, place] = ratio * motors.force_constant(motor)
    # The amplifier corrects the share 2 pi f dt of its error in a tick: a lag with this rate.
    lag = -np.log(1.0 - 2.0 * np.pi * CURRENT_LOOP_HZ * timing.tick_s) / timing.tick_s
    states = 2 * size + 3
    rates = np.zeros((states + 3, states + 3))
    rates[:size, size : 2 * size] = np.eye(size)
    stiffness = stiffness_at(machine, state, parameters)
    rates[size : 2 * size, :size] = -np.linalg.solve(mass, stiffness)
    rates[size : 2 * size, size : 2 * size] = -np.linalg.solve(mass, damping_matrix(machine))
    rates[size : 2 * size, 2 * size : states] = np.linalg.solve(mass, force)
    rates[2 * size : states, 2 * size : states] = -lag * np.eye(3)
    rates[2 * size : states, states:] = lag * np.eye(3)
    held = scipy.linalg.expm(rates * timing.tick_s * timing.encoder_divider)
    return held[:states, :states], held[:states, states:]


def _encoder_matrix(machine: Machine, states: int) -> Matrix:
    """Return counts (4) from [z, z', currents]."""
    read = np.zeros((4, states))
    for place, name in enumerate(ENCODERS):
        encoder = machine.description.encoders[name]
        column, ratio = machine.assembly.placing[encoder.coordinate]
        read[place, column] = encoder.counts_per_unit * ratio
    return read


def _servo_matrices(servo: np.void, timing: Timing) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return what counts, their change and the integrals add to the current, A; and the error."""
    proportional, derivative = np.zeros((3, 4)), np.zeros((3, 4))
    integral, error = np.zeros((3, 3)), np.zeros((3, 4))
    for axis in range(3):
        amperes = servo['amplifier_peak_current'][axis] / 32768.0
        gain = 2.0**-19 * servo['Ixx30'][axis] * amperes
        position, velocity = int(servo['Ixx03'][axis]), int(servo['Ixx04'][axis])
        proportional[axis, position] = -gain * servo['Ixx08'][axis]
        derivative[axis, velocity] = -gain * servo['Ixx31'][axis] * servo['Ixx09'][axis] / 128.0
        integral[axis, axis] = gain * servo['Ixx08'][axis] * servo['Ixx33'][axis] / 2.0**23
        error[axis, position] = -1.0
    return proportional, derivative, integral, error
