# SPDX-License-Identifier: Apache-2.0
"""
Sim time against the wall clock.

Sim time may come to tick k at wall time

    due(k) = start + (k - first) / (rate factor)

with `rate` the ticks per sim second and `factor` the sim seconds asked for per wall second. Where the
machine is too slow, sim time falls behind that. A short delay is made up for; of a longer one, the
wall time is written off: `start` moves, sim time goes on from where it is, and `written_off_s` says
how much was lost.
"""

from __future__ import annotations

LONGEST_LAG_S = 0.1
"""Wall time that is made up for; after a longer delay the plant would run far ahead of all others."""


class Pace:
    """When each tick is due; wall times are monotonic, in s."""

    def __init__(self, factor: float, tick_s: float) -> None:
        """Stand still until `start`."""
        self.factor = factor
        self.written_off_s = 0.0
        self.worst_lag_s = 0.0
        self._wall_tick_s = tick_s / factor
        self._start_s: float | None = None
        self._first = self._tick = 0
        self._rated = 0, 0.0  # tick and wall time from which the rate counts

    @property
    def running(self) -> bool:
        """Whether sim time goes on."""
        return self._start_s is not None

    def start(self, tick: int, now_s: float) -> None:
        """Go on from `tick`, which is now."""
        self._first, self._start_s = tick, now_s
        self._tick, self._rated = tick, (tick, now_s)

    def stop(self) -> None:
        """Stand still."""
        self._start_s = None

    def due_s(self, tick: int) -> float:
        """Return the wall time at which `tick` may come; infinite while time stands still."""
        if self._start_s is None:
            return float('inf')
        return self._start_s + (tick - self._first) * self._wall_tick_s

    def come_to(self, tick: int, now_s: float, longest_s: float = LONGEST_LAG_S) -> None:
        """Note that sim time comes to `tick`; write off its delay if it is longer than `longest_s`."""
        self._tick = tick
        lag_s = now_s - self.due_s(tick)
        self.worst_lag_s = max(self.worst_lag_s, lag_s)
        if lag_s > longest_s:
            self.written_off_s += lag_s
            self._first, self._start_s = tick, now_s

    def rate(self, now_s: float) -> float | None:
        """Return sim seconds per wall second since the last call or the start; None at rest."""
        tick, since_s = self._rated
        if self._start_s is None or now_s <= since_s:
            return None
        self._rated = self._tick, now_s
        return (self._tick - tick) * self._wall_tick_s * self.factor / (now_s - since_s)
