# SPDX-License-Identifier: Apache-2.0
"""
Independent evaluations on several processes, or on the workers of a `cluster`.

Each result is that of its point alone: neither the number of processes nor the loss of a worker changes
a bit of them. No process waits for another: one that has ended its point gets the next.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Result = TypeVar('Result')

AS_THEY_END = (
    'generator_unordered'
    if tuple(map(int, joblib.__version__.split('.')[:2])) >= (1, 4)
    else 'generator'
)
"""joblib before 1.4 holds a result back until those before it are there; Ubuntu 24.04 has 1.3."""


WORKERS_PER_POINT = 8
"""
Points that are handed out together: one for each so many workers.

To hand out takes 1 to 4 ms on a cluster, and a run some 80: more workers than this would wait for it.
"""


def in_order(
    function: Callable[[Floats], Result], points: Floats, workers: int
) -> Iterator[Result]:
    """Yield what a function returns for each point of (n, k), in their order."""
    with joblib.Parallel(n_jobs=workers, return_as='generator') as parallel:
        yield from parallel(joblib.delayed(function)(one) for one in points)


def as_they_end(
    function: Callable[[Floats], Result], points: Floats, workers: int
) -> Iterator[tuple[int, Result]]:
    """
    Yield the place among `points` (n, k) and what a function returns, as soon as it is there.

    Of points that are handed out together none is there before the last; up to 8 workers get one each.
    """
    together = -(-workers // WORKERS_PER_POINT)
    with joblib.Parallel(n_jobs=workers, return_as=AS_THEY_END, batch_size=together) as parallel:
        # In the function, not beside it: Dask keeps large arguments on a worker, and they go with it.
        placed = functools.partial(_placed, function)
        yield from parallel(joblib.delayed(placed)(place, one) for place, one in enumerate(points))


def _placed(function: Callable[[Floats], Result], place: int, point: Floats) -> tuple[int, Result]:
    return place, function(point)
