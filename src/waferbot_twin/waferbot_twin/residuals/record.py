# SPDX-License-Identifier: Apache-2.0
"""A measured log laid on the ticks of the twin: what the blocks are replayed with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import ENCODERS
from waferbot_lockstep.timing import Timing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Terminals:
    """
    What was measured at the amplifiers' terminals, at every tick.

    current  (ticks, 6) A, lines 1 and 2 of each motor as the current sensors showed them at the tick
    voltage  (ticks, 9) V, terminals 1, 2, 3 of each motor over the tick, or None
    off      (ticks,) bit i set: the bridge of axis i is off, its terminals are open
    """

    current: Array
    voltage: Array | None
    off: NDArray[np.uint8]

    def part(self, ticks: slice) -> Terminals:
        """Return a stretch of ticks."""
        voltage = None if self.voltage is None else self.voltage[ticks]
        return Terminals(self.current[ticks], voltage, self.off[ticks])


@dataclass(frozen=True)
class Record:
    """
    One log.

    line_current  (ticks, 6) A, lines 1 and 2 of each motor as measured, mean over each tick; NaN for a
                  motor of which nothing is known
    reading       (rows, 4) counts of each encoder as published at encoder ticks, NaN where missing
    commanded     (cycles, 3) counts, commanded position at servo ticks, or None
    command       (cycles, 3) A, current command at servo ticks, or None
    terminals     what was measured at the amplifiers' terminals, or None

    current       (ticks, 3) A, the part of each motor's current that makes force, mean over each tick;
                  it drives motors whose line currents are not known; NaN or None where that is neither
    late_s        (rows, 4) s, how much after the tick of its row a reading was taken; None: not at all
    resolution    smallest step of each encoder's readings, counts
    notes         what a reader of the results should know of the log

    `whole_counts` tells whether readings are the whole counts that the controller saw. A log need not
    have a reading in every row: `late_s` and gaps of NaN keep the times at which it was really measured.
    What lies before `judged_from_s` is simulated, so that the machine is in the state that it had by
    then, but not judged.
    """

    name: str
    timing: Timing
    line_current: Array
    reading: Array
    commanded: Array | None
    command: Array | None
    whole_counts: bool = True
    terminals: Terminals | None = None
    judged_from_s: float = 0.0
    current: Array | None = None
    late_s: Array | None = None
    resolution: tuple[float, ...] = (1.0,) * len(ENCODERS)
    notes: tuple[str, ...] = ()

    @property
    def ticks(self) -> int:
        """How many ticks of the current loop the log has."""
        return len(self.line_current)

    @property
    def duration_s(self) -> float:
        """How long the log is, s."""
        return self.timing.seconds(self.ticks)

    def with_encoder_ticks(self) -> Record:
        """
        Return the record with ticks as long as the encoders' cycle and the mean current of each.

        Without what was measured at the terminals, which is of the shorter ticks.
        """
        timing, times = self.timing, self.timing.encoder_divider
        longer = Timing(timing.current_loop_hz // times, 1, timing.servo_divider // times)
        return replace(
            self,
            timing=longer,
            line_current=_means(self.line_current, times),
            current=None if self.current is None else _means(self.current, times),
            terminals=None,
        )

    def part(self, first_s: float, last_s: float) -> Record:
        """Return the record up to a time, of which only what lies between two times is judged."""
        cycles = round(last_s * self.timing.servo_hz)
        ticks = cycles * self.timing.servo_divider
        rows = ticks // self.timing.encoder_divider
        return replace(
            self,
            name=f'{self.name} {first_s:.2f} to {last_s:.2f} s',
            line_current=self.line_current[:ticks],
            reading=self.reading[:rows],
            commanded=None if self.commanded is None else self.commanded[:cycles],
            command=None if self.command is None else self.command[:cycles],
            terminals=None if self.terminals is None else self.terminals.part(slice(0, ticks)),
            judged_from_s=first_s,
            current=None if self.current is None else self.current[:ticks],
            late_s=None if self.late_s is None else self.late_s[:rows],
        )


def _means(values: Array, times: int) -> Array:
    """Return the mean of every so many rows of (n, k)."""
    whole = len(values) // times * times
    return np.asarray(values[:whole].reshape(-1, times, values.shape[1]).mean(axis=1))


def common_step(readings: Array) -> int:
    """
    Return the step of which all changes of an encoder's readings (n,) are multiples, counts.

    0 where readings are no whole counts, or never change.
    """
    changes = np.diff(readings[np.isfinite(readings)])
    if np.any(changes % 1.0 != 0.0):
        return 0
    return int(np.gcd.reduce(changes.astype(np.int64)))


def mean_over_ticks(current: Array) -> Array:
    """Return the mean of each tick's current, from the values at its beginning and end."""
    return 0.5 * (current + np.vstack([current[1:], current[-1:]]))
