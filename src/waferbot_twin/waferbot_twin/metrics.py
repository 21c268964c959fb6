# SPDX-License-Identifier: Apache-2.0
"""
Figures of a step response, as chapter 4 of the thesis defines them.

All times count from the step. The response is the position of the axis at the encoder's rate;
crossings are interpolated linearly between samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SETTLING_BAND = 0.05


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


def step_metrics(time: np.ndarray, response: np.ndarray, step: float) -> StepMetrics:
    """
    Return the figures of a response to a step of height `step` commanded at time 0 from rest at 0.

    `time` (n,) in s, ascending; `response` (n,) in any unit, `step` in the same, not zero.
    Delay time: to half of the step. Rise time: from the step to the first arrival at its height.
    Peak: the largest value in the direction of the step.
    """
    relative = response / step
    peak_index = int(np.argmax(relative))
    outside = np.flatnonzero(np.abs(relative - 1.0) > SETTLING_BAND)
    settling = float('nan')
    if len(outside) == 0:
        settling = float(time[0])
    elif outside[-1] + 1 < len(time):
        edge = 1.0 + SETTLING_BAND * np.sign(relative[outside[-1]] - 1.0)
        settling = _crossing(time, relative, int(outside[-1]), float(edge))
    return StepMetrics(
        step=step,
        delay_time=_first_arrival(time, relative, 0.5),
        rise_time=_first_arrival(time, relative, 1.0),
        peak=float(response[peak_index]),
        overshoot_percent=100.0 * (float(relative[peak_index]) - 1.0),
        peak_time=float(time[peak_index]),
        settling_time=settling,
    )


def rms(error: np.ndarray) -> float:
    """Return the root mean square of an error (4.2)."""
    return float(np.sqrt(np.mean(np.square(error)))) if len(error) else float('nan')


def _first_arrival(time: np.ndarray, values: np.ndarray, level: float) -> float:
    above = np.flatnonzero(values >= level)
    if len(above) == 0:
        return float('nan')
    if above[0] == 0:
        return float(time[0])
    return _crossing(time, values, int(above[0]) - 1, level)


def _crossing(time: np.ndarray, values: np.ndarray, before: int, level: float) -> float:
    """Return when the line from sample `before` to the next one passes `level`."""
    rise = values[before + 1] - values[before]
    share = (level - values[before]) / rise if rise else 0.0
    return float(time[before] + share * (time[before + 1] - time[before]))
