# SPDX-License-Identifier: Apache-2.0
"""
Time of the twin: a whole number of ticks, and nothing else.

Tick k of the current loop is the instant k / 18000 s. That is no whole number of nanoseconds, so a
stamp is always computed from the tick, rounded down, and never summed up:

    stamp(k) = floor(k * 10^9 / 18000) = k * 500000 // 9    nanoseconds

The slower loops run on whole multiples of the tick: encoders on every 2nd (9 kHz, the phase cycle
of the MACRO ring), the servo on every 8th (2.25 kHz).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError

NANOSECONDS_PER_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Timing:
    """
    Rates of the three loops.

    `current_loop_hz` is the tick rate in Hz; `encoder_divider` and `servo_divider` are whole
    multiples of the tick. The servo acts on encoder ticks only, so `servo_divider` must be a
    multiple of `encoder_divider`; otherwise a servo tick would have no new counts to act on.
    """

    current_loop_hz: int = 18000
    encoder_divider: int = 2
    servo_divider: int = 8

    def __post_init__(self) -> None:
        """Refuse rates that do not nest."""
        if min(self.current_loop_hz, self.encoder_divider, self.servo_divider) < 1:
            raise UserError('timing: rates and dividers must be whole numbers of 1 or more')
        if self.servo_divider % self.encoder_divider:
            raise UserError(
                f'timing: servo_divider {self.servo_divider} must be a multiple of '
                f'encoder_divider {self.encoder_divider}'
            )

    @property
    def tick_s(self) -> float:
        """Length of one tick in seconds, for the equations of motion (never to be summed)."""
        return 1.0 / self.current_loop_hz

    @property
    def servo_hz(self) -> float:
        """Rate of the servo in Hz."""
        return self.current_loop_hz / self.servo_divider

    @property
    def encoder_hz(self) -> float:
        """Rate of the encoder messages in Hz."""
        return self.current_loop_hz / self.encoder_divider

    def stamp_ns(self, tick: int) -> int:
        """Return the stamp of `tick` in nanoseconds of sim time, rounded down."""
        return tick * NANOSECONDS_PER_SECOND // self.current_loop_hz

    def stamps_ns(self, ticks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the stamps of ticks (n,), as `stamp_ns`."""
        seconds, rest = np.divmod(ticks, self.current_loop_hz)
        return np.asarray(
            seconds * NANOSECONDS_PER_SECOND
            + rest * NANOSECONDS_PER_SECOND // self.current_loop_hz,
            np.int64,
        )

    def seconds(self, tick: int) -> float:
        """Return the time of `tick` in seconds, correctly rounded."""
        return tick / self.current_loop_hz

    def ticks(self, seconds: float) -> int:
        """Return the number of whole ticks nearest to `seconds`."""
        return round(seconds * self.current_loop_hz)

    def messages(self, ticks: int, divider: int) -> int:
        """Return how many of the ticks 0 .. ticks - 1 are multiples of `divider`."""
        return -(-ticks // divider)
