# SPDX-License-Identifier: Apache-2.0
"""Lines of long signals: the least and the greatest value of each stretch, so that no peak is lost."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

MOST_SAMPLES = 4000
"""Samples up to which a signal is drawn as it is."""

STRETCHES = 1500
"""Stretches of a longer one: more than a picture has columns."""


def envelope(
    time_s: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """
    Return middle times, least and greatest value of `STRETCHES` stretches with equal numbers of samples.

    `time_s` and `values` (n,), n at least `STRETCHES`; the results (STRETCHES,).
    """
    starts = np.linspace(0, len(values), STRETCHES, endpoint=False).astype(int)
    ends = np.append(starts[1:], len(values)) - 1
    middle = 0.5 * (time_s[starts] + time_s[ends])
    return middle, np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)


def draw_signal(
    panel: Axes,
    time_s: NDArray[np.float64],
    values: NDArray[np.float64],
    colour: str,
    label: str,
) -> None:
    """Draw a signal (n,) over time in s: as a line, or if it is long as a band of its envelope."""
    if len(values) <= MOST_SAMPLES:
        panel.plot(time_s, values, color=colour, lw=0.7, label=label)
        return
    middle, least, greatest = envelope(time_s, values)
    panel.fill_between(middle, least, greatest, color=colour, lw=0.4, alpha=0.85, label=label)
