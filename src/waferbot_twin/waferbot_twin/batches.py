# SPDX-License-Identifier: Apache-2.0
"""
Independent evaluations on several processes, or on the workers of a `cluster`, batch by batch.

Each result is that of its point alone, and they come in the order of the points: neither the number of
processes nor the loss of a worker changes a bit of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Result = TypeVar('Result')

BATCH = 8
"""Points of a batch per process: progress is told, and what is done kept, after each batch."""


def in_batches(
    function: Callable[[Floats], Result], points: Floats, workers: int
) -> Iterator[list[Result]]:
    """Yield what a function returns for each point of (n, k), in lists of `BATCH` times `workers`."""
    size = BATCH * workers
    with joblib.Parallel(n_jobs=workers) as parallel:
        for start in range(0, len(points), size):
            yield parallel(joblib.delayed(function)(one) for one in points[start : start + size])
