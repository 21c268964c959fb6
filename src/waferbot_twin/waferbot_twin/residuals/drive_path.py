# SPDX-License-Identifier: Apache-2.0
"""
What a drive does between two samples of a log, of which the log has nothing.

    i(t) = i_k + (i_k+1 - i_k) f(s),   f(s) = (1 - exp(-a s)) / (1 - exp(-a)),   s = (t - t_k) / h   (1)

the path of a current loop that gets a new command with every sample: a = h / tau, h the time between
samples, tau the loop's time constant. For a to infinity it is there at once, for a to minus infinity it
stands until the next sample, for a = 0 it goes straight. On average it is earlier than that by

    x = h / 2 L(a / 2),        L(y) = coth y - 1 / y (Langevin's function),                         (2)

half a step at most, and that is what a fit finds. A drive that is moved in time by x instead mixes
samples that do not belong together: at steps of the current the plant is then wrong by as much as
small causes are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from waferbot_twin.logs.measured import Signal

Array = NDArray[np.float64]

FASTEST = 200.0
"""Largest a: within a hundredth of a sample that is at once."""

STRAIGHT = 1e-3
"""Below that a series is exact to rounding."""


@dataclass(frozen=True)
class DrivePath:
    """
    Of each axis' drive at the edges of all ticks (n + 1, axes), zeros for one that is held.

    rise    h (i_k+1 - i_k) of the interval between samples in which an edge is, A s
    before  the sum of that over all intervals before, A s
    share   s, how far in its interval an edge is, 0 to 1
    step_s  the usual time between samples (axes,), s; 0 for one that is held
    """

    rise: Array
    before: Array
    share: Array
    step_s: Array

    def part(self, ticks: slice) -> DrivePath:
        """Return that of some ticks."""
        edges = slice(ticks.start, ticks.stop + 1)
        return DrivePath(self.rise[edges], self.before[edges], self.share[edges], self.step_s)

    def in_longer_ticks(self, times: int) -> DrivePath:
        """Return that of ticks so many times as long."""
        return DrivePath(
            self.rise[::times], self.before[::times], self.share[::times], self.step_s
        )

    def earlier_by(self, early_s: Array, tick_s: float) -> Array:
        """Return what means over ticks (n, axes) change, A, for drives `early_s` (axes,) earlier."""
        changes = np.zeros((len(self.rise) - 1, self.rise.shape[1]))
        for place, early in enumerate(early_s.tolist()):
            if early == 0.0 or self.step_s[place] == 0.0:
                continue
            bend = _bend(2.0 * early / float(self.step_s[place]))
            area = _area(bend, self.share[:, place]) - 0.5 * self.share[:, place] ** 2
            more = float(_area(bend, np.ones(1))[0]) - 0.5
            of_path = more * self.before[:, place] + self.rise[:, place] * area
            changes[:, place] = np.diff(of_path) / tick_s
        return changes


def no_path(edges: int, axes: int) -> DrivePath:
    """Return that of the drives of so many axes, which are all held."""
    nothing = np.zeros((edges, axes))
    return DrivePath(nothing, nothing, nothing, np.zeros(axes))


def with_signal(
    path: DrivePath, place: int, drive: Signal, edges_s: Array, per_unit: float
) -> DrivePath:
    """Return a path with a signal as the drive of an axis, so many A per unit; a held one has none."""
    if drive.held or len(drive.time_s) < 2:
        return path
    steps_s = np.diff(drive.time_s)
    # Nothing is known of a gap: there it stays straight.
    rises = np.where(steps_s <= drive.gap_s, steps_s * np.diff(drive.value), 0.0) * per_unit
    row = np.clip(np.searchsorted(drive.time_s, edges_s, side='right') - 1, 0, len(steps_s) - 1)
    columns = (
        rises[row],
        np.concatenate([[0.0], np.cumsum(rises)])[row],
        np.clip((edges_s - drive.time_s[row]) / steps_s[row], 0.0, 1.0),
    )
    own = [array.copy() for array in (path.rise, path.before, path.share)]
    for array, column in zip(own, columns, strict=True):
        array[:, place] = column
    step_s = path.step_s.copy()
    step_s[place] = float(np.median(steps_s))
    return DrivePath(own[0], own[1], own[2], step_s)


def _bend(half_steps: float) -> float:
    """Return a of equation (2) for x in half steps, -1 to 1."""
    if abs(half_steps) < STRAIGHT / 6.0:
        return 6.0 * half_steps
    fastest = _langevin(0.5 * FASTEST)
    if abs(half_steps) >= fastest:
        return math.copysign(FASTEST, half_steps)
    return 2.0 * float(brentq(lambda y: _langevin(y) - half_steps, -0.5 * FASTEST, 0.5 * FASTEST))


def _langevin(value: float) -> float:
    return value / 3.0 if abs(value) < STRAIGHT else 1.0 / math.tanh(value) - 1.0 / value


def _area(bend: float, share: Array) -> Array:
    """Return the integral of f from 0 to `share`, equation (1)."""
    if abs(bend) < STRAIGHT:
        return np.asarray(0.5 * share**2 + bend * (0.25 * share**2 - share**3 / 6.0))
    gone = -np.expm1(-bend * share)
    return np.asarray((share - gone / bend) / -math.expm1(-bend))
