# SPDX-License-Identifier: Apache-2.0
"""
What goes with a residual: its mean over speed and over position, its spectrum over position.

Pictures that need no hypothesis. A force that rises from rest, differs by direction or is no straight
line in speed shows over speed; gravity, a guide that is tight in places and end stops over position;
cogging, a screw, gear teeth and an eccentric encoder as lines in the spectrum over position, where they
stand at one period whatever the speed was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import t as student

Array = NDArray[np.float64]

BINS = 40
FEWEST_IN_BIN = 4

MOST_WAVES = 2000
"""Wave numbers of a spectrum at most."""

STANDS_OUT = 5.0
"""How many times the level about it a line must be."""

SURROUNDING = 51
"""Wave numbers whose median is the level about a line."""

MOST_LINES = 12


@dataclass(frozen=True, eq=False)
class BinnedMeans:
    """
    Means of a residual in bins of something else: `centre`, `mean`, `low95`, `high95` (N,).

    Intervals are from the scatter of *passes*, the means of each uninterrupted run through a bin, since
    samples within one are not independent; NaN where there was a single pass.
    """

    centre: Array
    mean: Array
    low95: Array
    high95: Array


def binned_means(over: Array, residual: Array, bins: int = BINS) -> BinnedMeans:
    """Return the means of `residual` (N,) in bins of equal width of `over` (N,), which are in time."""
    edges = np.linspace(float(over.min()), float(over.max()), bins + 1)
    place = np.clip(np.searchsorted(edges, over, side='right') - 1, 0, bins - 1)
    begins = np.flatnonzero(np.concatenate([[True], place[1:] != place[:-1]]))
    counts = np.diff(np.concatenate([begins, [len(over)]]))
    sums = np.add.reduceat(residual, begins)
    rows = []
    for one in range(bins):
        mine = place[begins] == one
        samples = counts[mine]
        total, passes = int(samples.sum()), len(samples)
        if total < FEWEST_IN_BIN:
            continue
        mean = float(sums[mine].sum()) / total
        reach = np.nan
        if passes > 1:
            # Passes weigh by their samples; variance of a ratio of sums.
            apart = sums[mine] - mean * samples
            variance = float(apart @ apart) * passes / (passes - 1.0) / total**2
            reach = float(student.ppf(0.975, passes - 1)) * np.sqrt(variance)
        rows.append((0.5 * (edges[one] + edges[one + 1]), mean, mean - reach, mean + reach))
    return BinnedMeans(*np.array(rows, np.float64).reshape(-1, 4).T)


@dataclass(frozen=True, eq=False)
class PositionSpectrum:
    """
    Amplitude of a residual over waves per m or rad of the position: `waves`, `amplitude`, `level` (N,).

    `lines` are the places in these of the waves that stand out, the largest first.
    """

    waves: Array
    amplitude: Array
    level: Array
    lines: tuple[int, ...]


def position_spectrum(
    position: Array, residual: Array, speed: Array, highest_hz: float
) -> PositionSpectrum | None:
    """
    Return the spectrum of `residual` (N,) over `position` (N,), None if the axis hardly went anywhere.

        a(k) = 2 |sum d_n e_n exp(-2 pi i k x_n)| / sum d_n,        d_n the way of sample n,

    so that slow stretches do not count more than fast ones, and with a Hann window over the stroke, so
    that neither its ends nor the mean leak. Waves are half a stroke apart, from two in a stroke on; the
    highest is that which passes, at the median speed, with `highest_hz`, the cut-off of the filter.
    """
    stroke = float(np.ptp(position))
    moving = np.abs(speed) > 0.0
    if stroke == 0.0 or not moving.any():
        return None
    highest = highest_hz / float(np.median(np.abs(speed[moving])))
    step = 0.5 / stroke
    count = min(int(highest / step), MOST_WAVES)
    if count < SURROUNDING:
        return None
    waves = step * np.arange(4, count + 1)
    window = np.sin(np.pi * (position - position.min()) / stroke) ** 2
    weight = np.abs(speed) * window
    from_mean = weight * (residual - float(weight @ residual) / float(weight.sum()))
    turning = np.exp(-2j * np.pi * step * position)
    phase = turning**4
    amplitude = np.empty(len(waves))
    for place in range(len(waves)):
        amplitude[place] = np.abs(from_mean @ phase)
        phase *= turning
    amplitude *= 2.0 / float(weight.sum())
    level = np.asarray(median_filter(amplitude, SURROUNDING, mode='nearest'), np.float64)
    lines = _lines(amplitude, level)
    return PositionSpectrum(np.asarray(waves, np.float64), amplitude, level, lines)


def _lines(amplitude: Array, level: Array) -> tuple[int, ...]:
    """Return where peaks stand out, the largest first; a Hann window's peak is four places wide."""
    found: list[int] = []
    for place in np.argsort(amplitude)[::-1]:
        near = amplitude[max(place - 2, 0) : place + 3]
        if amplitude[place] < STANDS_OUT * level[place] or amplitude[place] < near.max():
            continue
        if all(abs(int(place) - other) > 4 for other in found):
            found.append(int(place))
        if len(found) == MOST_LINES:
            break
    return tuple(found)
