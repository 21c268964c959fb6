# SPDX-License-Identifier: Apache-2.0
"""
Figures of a step response, as chapters 4 and 6 of the thesis define them, and their comparison.

All times count from the step. The response is the position of the axis at the encoder's rate;
crossings are interpolated linearly between samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

SETTLING_BAND = 0.05

RISE_RULES = ('first', 'main-peak')
"""
Where the rise ends: at the first arrival at the command, or at the arrival that leads to the
highest peak.

Chapter 6 uses the second for Y-Linear: the response of a soft machine may have a small peak that
reaches the command, or just misses it, long before the main one, and the first arrival then jumps
between the two from one run to the next.
"""

FIGURES = {
    'delay_time': 'Delay Time',
    'rise_time': 'Rise Time',
    'peak': 'Peak Response',
    'overshoot_percent': 'Peak Overshoot',
    'peak_time': 'Peak Time',
    'settling_time': 'Settling Time',
}
"""The figures that the tables of the thesis list, in their order, with their names there."""


@dataclass(frozen=True)
class StepMetrics:
    """
    Figures of one step; lengths in the unit of the response, times in s, NaN where there is none.

    `overshoot_percent` is relative to the commanded step. `settling_time` is the time after which the
    response stays within 5 % of the step; NaN if it is still outside at the end of the record.
    """

    step: float
    delay_time: float
    rise_time: float
    peak: float
    overshoot_percent: float
    peak_time: float
    settling_time: float


def step_metrics(
    time: np.ndarray,
    response: np.ndarray,
    step: float,
    rise: str = 'first',
    level_shift: float = 0.0,
) -> StepMetrics:
    """
    Return the figures of a response to a step of height `step` commanded at time 0 from rest at 0.

    `time` (n,) in s, ascending; `response` (n,) in any unit, `step` in the same, not zero.
    Delay time: to half of the step. Rise time: from the step to the arrival at its height, which
    one by `rise` (see `RISE_RULES`). Peak: the largest value in the direction of the step.
    """
    if rise not in RISE_RULES:
        raise ValueError(f'rise is {rise!r}; it is one of {", ".join(RISE_RULES)}')
    relative = response / step
    peak_index = int(np.argmax(relative))
    band = SETTLING_BAND + level_shift
    outside = np.flatnonzero(np.abs(relative - 1.0) > band)
    settling = float('nan')
    if len(outside) == 0:
        settling = float(time[0])
    elif outside[-1] + 1 < len(time):
        edge = 1.0 + band * np.sign(relative[outside[-1]] - 1.0)
        settling = _crossing(time, relative, int(outside[-1]), float(edge))
    arrival = _first_arrival if rise == 'first' else _last_arrival_before_peak
    return StepMetrics(
        step=step,
        delay_time=_first_arrival(time, relative, 0.5 + level_shift),
        rise_time=arrival(time, relative, 1.0 + level_shift),
        peak=float(response[peak_index]),
        overshoot_percent=100.0 * (float(relative[peak_index]) - 1.0),
        peak_time=float(time[peak_index]),
        settling_time=settling,
    )


def rms(error: np.ndarray) -> float:
    """Return the root mean square of an error (4.2)."""
    return float(np.sqrt(np.mean(np.square(error)))) if len(error) else float('nan')


def percent_difference(simulated: float, measured: float) -> float:
    """Return 100 |simulated - measured| / |measured| (4.1); NaN against zero."""
    if measured == 0.0:
        return float('nan')
    return 100.0 * math.fabs(simulated - measured) / math.fabs(measured)


def performance_improvement(before: float, after: float) -> float:
    """
    Return 100 (before - after) / before (6.1), in percent.

    `before` and `after` are what a model gets wrong (percent difference or RMS error) without and
    with an extension. Positive: the extension helped. Nothing wrong before: NaN, or zero if there
    is nothing wrong after either.
    """
    if before == 0.0:
        return 0.0 if after == 0.0 else float('nan')
    return 100.0 * (before - after) / before


def _first_arrival(time: np.ndarray, values: np.ndarray, level: float) -> float:
    above = np.flatnonzero(values >= level)
    if len(above) == 0:
        return float('nan')
    if above[0] == 0:
        return float(time[0])
    return _crossing(time, values, int(above[0]) - 1, level)


def _last_arrival_before_peak(time: np.ndarray, values: np.ndarray, level: float) -> float:
    peak = int(np.argmax(values))
    if values[peak] < level:
        return float('nan')
    below = np.flatnonzero(values[:peak] < level)
    return _crossing(time, values, int(below[-1]), level) if len(below) else float(time[0])


def _crossing(time: np.ndarray, values: np.ndarray, before: int, level: float) -> float:
    """Return when the line from sample `before` to the next one passes `level`."""
    rise = values[before + 1] - values[before]
    share = (level - values[before]) / rise if rise else 0.0
    return float(time[before] + share * (time[before + 1] - time[before]))
