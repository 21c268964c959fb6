# SPDX-License-Identifier: Apache-2.0
"""
Differential evolution (scipy), a whole population at a time, so that its members run side by side.

A trial takes the place of a member x_i of the population if it costs no more. Its numbers are, each with
the probability 0.8, those of

    x_i + F (x_best - x_i) + F (x_a - x_b),    F even in 0.4 to 0.9, anew in each generation,

with two other members a and b, and else those of x_i. All trials of a generation are made from the same
population (`updating='deferred'`), with a fixed seed: what comes out does not depend on the number of
processes that evaluate them.

Source: R. Storn and K. Price, Differential Evolution, Journal of Global Optimization 11 (1997).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

Floats = NDArray[np.float64]

SEED = 2


def minimise(
    costs: Callable[[Floats], Floats],
    low: Floats,
    high: Floats,
    generations: int,
    population: int | Floats,
    tolerance: float,
) -> tuple[Floats, float]:
    """
    Return the point (k,) between `low` and `high` (k,) that costs least, and its cost.

    `costs` takes the points (n, k) of a population and returns their costs (n,). `population` is the
    first one (n, k), or how many members there are for each parameter (then a Latin hypercube). It ends
    after so many generations, or when the spread of the costs is less than `tolerance` of their mean.
    """
    sized = isinstance(population, int)
    found = differential_evolution(
        lambda columns: costs(columns.T),
        list(zip(low, high, strict=True)),
        seed=SEED,
        maxiter=generations,
        popsize=population if sized else 1,
        init='latinhypercube' if sized else population,
        strategy='currenttobest1bin',
        mutation=(0.4, 0.9),
        recombination=0.8,
        polish=False,
        tol=tolerance,
        vectorized=True,
        updating='deferred',
    )
    return np.asarray(found.x, np.float64), float(found.fun)
