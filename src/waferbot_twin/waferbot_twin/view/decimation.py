# SPDX-License-Identifier: Apache-2.0
"""As many samples of a signal as a screen can show, with its peaks among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def decimated(
    time_s: Vector, values: Vector, start_s: float, end_s: float, stretches: int
) -> tuple[Vector, Vector]:
    """
    Return the samples within [start_s, end_s], one more at each side, and no more than needed.

    `time_s` (n,) ascends. Up to 2 `stretches` samples stay as they are; of more, the least and the
    greatest of each of `stretches` stretches are kept, at their times. So every value returned is a
    sample, at most 2 `stretches` + 2 are, and no peak is lost.
    """
    first = max(int(np.searchsorted(time_s, start_s)) - 1, 0)
    last = min(int(np.searchsorted(time_s, end_s, side='right')) + 1, len(time_s))
    time_s, values = time_s[first:last], values[first:last]
    count = len(values)
    if count <= 2 * stretches:
        return time_s, values
    width = -(-count // stretches)
    filled = np.full(-(-count // width) * width, values[-1])
    filled[:count] = values
    table = filled.reshape(-1, width)
    begin = np.arange(len(table)) * width
    least, greatest = begin + table.argmin(axis=1), begin + table.argmax(axis=1)
    chosen = np.concatenate([[0], least, greatest, [count - 1]])
    chosen = np.unique(np.minimum(chosen, count - 1))
    return time_s[chosen], values[chosen]
