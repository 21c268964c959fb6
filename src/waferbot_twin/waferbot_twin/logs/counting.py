# SPDX-License-Identifier: Apache-2.0
"""
How a position became counts, and by how much its readings are too low because of that.

An encoder that counts edges shows floor(x / q) q: on average half a step q less than x. One that rounds
to the nearest is right on average. The mean of several counts that were rounded down (`average`) has
fractions of a step and is half a step low, too. Of one encoder nobody sees the difference: its zero is
somewhere anyhow. Two encoders of one axis with steps q and Q, both rounded down, differ by (Q - q) / 2:
that is no play and no eccentricity.

Which of the first two it is, the two tell themselves if their zeros agree: by the mean of what they
differ, as far as that is known (batch means: readings at rest all have the same error).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.measured import Signal

FLOOR, ROUND, AVERAGE = 'floor', 'round', 'average'

NEAR = 0.2
"""Share of the difference that rounding down makes by which the mean may miss it."""

FEWEST_READINGS = 200
"""Readings that two encoders must have in common to be compared."""

BLOCKS, SIGNIFICANT = 12, 4.0
"""Blocks of readings that tell the standard error of their mean, and how many of those are plain."""


def counted(signal: Signal, counting: str, up: bool, findings: list[Finding]) -> Signal:
    """
    Return a position that counts in this way; `up`: its counts rise as it does.

    Without a known step nothing can be said of half of it: then that is a finding.
    """
    if counting == ROUND:
        return replace(signal, counting=counting, half_step=0.0)
    if signal.resolution == 0.0:
        reason = f'counting: {counting} says nothing without a step; give its resolution'
        findings.append(Finding(signal.name, reason, 'note'))
        return signal
    half_step = 0.5 * signal.resolution * (1.0 if up else -1.0)
    return replace(signal, counting=counting, half_step=half_step)


def told_by_both(position: Signal, motor: Signal, ratio: float, up: tuple[bool, bool]) -> str:
    """
    Return how the two encoders of an axis count, '' if their difference does not tell.

    `ratio` is the motor's motion per motion of the axis; `up` of both as in `counted`.
    """
    steps = np.array([position.resolution, motor.resolution / abs(ratio)])
    if not np.all(steps > 0.0):
        return ''
    other, known = motor.at(position.time_s)
    if np.count_nonzero(known) < FEWEST_READINGS:
        return ''
    low = steps * np.where(up, 0.5, -0.5) * np.array([1.0, np.sign(ratio)])
    expected = float(low[0] - low[1])
    apart = other[known] / ratio - position.value[known]
    means = np.array([block.mean() for block in np.array_split(apart, BLOCKS)])
    error = float(means.std(ddof=1)) / math.sqrt(BLOCKS)
    if abs(expected) < SIGNIFICANT * error or expected == 0.0:
        return ''
    differs = float(apart.mean())
    misses = max(NEAR * abs(expected), 0.5 * SIGNIFICANT * error)
    if abs(differs - expected) < misses:
        return FLOOR
    return ROUND if abs(differs) < misses else ''
