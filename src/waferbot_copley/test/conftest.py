# SPDX-License-Identifier: Apache-2.0
"""For the tests: one amplifier on a motor of resistance and inductance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_copley.amplifier import initial_state, step
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import AXES

TICK_HZ = 18000.0
COUNTS_PER_CYCLE = 10**9


class DriveStand:
    """
    Axis x_rotate with a star of R and L per branch, and an electrical angle that the test sets.

    The motor is exact for voltages held over a tick: i(k+1) = a i(k) + (1 - a) / R * u(k) with
    a = exp(-R T / L), u the terminal voltage against the (isolated) star point.
    """

    axis = 1
    tick_hz = TICK_HZ

    def __init__(
        self, *, resistance: float = 2.0, inductance: float = 1e-3, **settings: float
    ) -> None:
        settings.setdefault('counts_per_electrical_cycle', COUNTS_PER_CYCLE)
        settings.setdefault('bus_voltage', 325.0)
        self.parameters = amplifier_parameters({AXES[self.axis]: settings})
        self.state = initial_state(self.parameters)
        self.decay = math.exp(-resistance / (inductance * TICK_HZ))
        self.resistance = resistance
        self.command = np.zeros(3)
        self.currents = np.zeros(6)
        self.counts = np.zeros(4, np.int64)
        self.voltage = np.zeros(9)

    @property
    def lines(self) -> np.ndarray:
        """Currents of lines 1, 2, 3 in A."""
        i1, i2 = self.currents[2:4]
        return np.array([i1, i2, -(i1 + i2)])

    @lines.setter
    def lines(self, value: np.ndarray) -> None:
        self.currents[2:4] = value[:2]

    @property
    def terminals(self) -> np.ndarray:
        """Voltages of terminals 1, 2, 3 in V."""
        return self.voltage[3:6].copy()

    @staticmethod
    def phasing(angle: float) -> np.ndarray:
        """Eq. (3.1) for the three lines."""
        return np.sin(angle - 2 * np.pi / 3 * np.arange(3))

    def field(self, name: str) -> np.ndarray:
        """Return a state field of this axis."""
        return self.state[name][0, self.axis]

    def set(self, name: str, value: float) -> None:
        """Set an input of the drive."""
        self.state[name][0, self.axis] = value

    def amplifier_only(self, command: float, angle: float = 0.0) -> np.ndarray:
        """Advance the amplifier by one tick at an electrical angle in rad, the motor not."""
        self.command[self.axis] = command
        self.counts[self.axis] = round(angle / (2 * math.pi) * COUNTS_PER_CYCLE)
        step(
            self.state, self.parameters, 1 << self.axis, self.command, self.currents,
            self.counts, self.voltage,
        )  # fmt: skip
        return self.terminals

    def tick(self, command: float, angle: float = 0.0) -> np.ndarray:
        """Advance amplifier and motor by one tick; return the line currents before it."""
        before = self.lines
        voltage = self.amplifier_only(command, angle)
        branch = voltage - voltage.mean()
        self.lines = self.decay * before + (1 - self.decay) / self.resistance * branch
        return before

    def loop_gains(self) -> tuple[float, float]:
        """Return Kp in V/A and Ki in V/A per tick, from the definitions of the settings."""
        p = self.parameters[0]
        scale = p['bus_compensation'][self.axis] * p['bus_gain'][self.axis]
        return p['proportional'][self.axis] * scale, p['integral'][self.axis] * scale


@pytest.fixture(scope='session')
def drive_stand() -> type[DriveStand]:
    """Hand out the class: each test sets its own stand up."""
    return DriveStand
