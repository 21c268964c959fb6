# SPDX-License-Identifier: Apache-2.0
"""
Stretches of a log in which nothing at all was logged, made short.

What is simulated or put on even times costs by the time that it spans. A log of two seconds with an hour
between them is a log of three: what happened in that hour nobody knows, and behind it every estimate
begins anew, whether it lasted a second or an hour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.logs.measured import Signal

Array = NDArray[np.float64]

LONGEST_S = 1.0
"""What is left of a pause, s."""

LONGEST_STEPS = 2.0
"""What is left at least, in steps of time that are no gap yet: it has to stay one."""


@dataclass(frozen=True)
class Clock:
    """
    The way back to the times at which a log was logged.

    From `from_s` (n,) on, rising, on the clock of the short pauses, `left_out_s` (n,) were left out.
    """

    from_s: Array
    left_out_s: Array

    def logged_s(self, time_s: Array) -> Array:
        """Return when it was logged, s; `time_s` (m,) are times of the log with short pauses."""
        left_out_s = np.concatenate([[0.0], self.left_out_s])
        behind = np.searchsorted(self.from_s, time_s, side='right')
        return np.asarray(time_s + left_out_s[behind], np.float64)

    def __str__(self) -> str:
        """Return how much was left out, in words; nothing if it was nothing."""
        if len(self.from_s) == 0:
            return ''
        pauses = f'{len(self.from_s)} pauses' if len(self.from_s) > 1 else 'a pause'
        return f'{pauses} in which nothing was logged, shortened by {self.left_out_s[-1]:.6g} s'


def with_short_pauses(signals: Sequence[Signal], step_s: float) -> tuple[list[Signal], Clock]:
    """
    Return signals whose common pauses last about `LONGEST_S`, in their order, and the clock.

    A pause is a stretch without a sample of any signal. It is shortened by whole multiples of `step_s`,
    so that samples stay where they are on even times.
    """
    times_s = np.unique(np.concatenate([np.zeros(0), *(one.time_s for one in signals)]))
    steps_s = np.diff(times_s)
    usual_s = [one.gap_s for one in signals if np.isfinite(one.gap_s)]
    longest_s = max([LONGEST_S, *(LONGEST_STEPS * gap_s for gap_s in usual_s)])
    too_long_s = np.floor((steps_s - longest_s) / step_s) * step_s
    pauses = np.flatnonzero(too_long_s > 0.0)
    if len(pauses) == 0:
        return list(signals), Clock(np.zeros(0), np.zeros(0))
    begins_s, left_out_s = times_s[pauses + 1], np.cumsum(too_long_s[pauses])

    def moved(signal: Signal) -> Signal:
        behind = np.searchsorted(begins_s, signal.time_s, side='right')
        return replace(signal, time_s=signal.time_s - np.concatenate([[0.0], left_out_s])[behind])

    left_s = steps_s[pauses] - too_long_s[pauses]
    # Whatever is behind the middle of a pause belongs to what follows.
    clock = Clock(begins_s - left_out_s - 0.5 * left_s, left_out_s)
    return [moved(one) for one in signals], clock
