# SPDX-License-Identifier: Apache-2.0
"""A measured log laid on the ticks of the twin: what the blocks are replayed with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.timing import Timing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """
    One log.

    line_current  (ticks, 6) A, lines 1 and 2 of each motor, or None
    current       (ticks, 3) A, the part of the current that makes force; NaN for an axis without
    reading       (rows, 4) counts of each encoder at encoder ticks, as published; NaN where missing
    commanded     (cycles, 3) counts, commanded position at servo ticks, or None
    command       (cycles, 3) A, current command at servo ticks, or None
    """

    name: str
    timing: Timing
    current: Array
    reading: Array
    commanded: Array | None
    command: Array | None

    @property
    def ticks(self) -> int:
        """How many ticks of the current loop the log has."""
        return len(self.current)

    def part(self, first_s: float, last_s: float) -> Record:
        """Return what lies between two times, on whole servo cycles."""
        begin = self.timing.servo_divider * round(first_s * self.timing.servo_hz)
        end = self.timing.servo_divider * round(last_s * self.timing.servo_hz)
        servo = slice(begin // self.timing.servo_divider, end // self.timing.servo_divider)
        rows = slice(begin // self.timing.encoder_divider, end // self.timing.encoder_divider)
        return Record(
            f'{self.name} {first_s:g} to {last_s:g} s',
            self.timing,
            self.current[begin:end],
            self.reading[rows],
            None if self.commanded is None else self.commanded[servo],
            None if self.command is None else self.command[servo],
        )
