# SPDX-License-Identifier: Apache-2.0
"""
Several objectives at once: NSGA-II (pymoo), a population at a time.

    minimise (f_1(x), ..., f_m(x))    with g_j(x) <= 0,    low <= x <= high

A point dominates another one if it is nowhere worse and somewhere better; what nothing dominates is
the Pareto front. Each generation doubles the population by crossover and mutation and keeps the better
half: who violates fewer constraints, by pymoo's sum of violations; among those that keep them, front
after front; within a front, who has the most room to its neighbours.

Source: K. Deb, A. Pratap, S. Agarwal, T. Meyarivan, A Fast and Elitist Multiobjective Genetic
Algorithm: NSGA-II, IEEE Transactions on Evolutionary Computation 6 (2002).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.sweep.variation import Floats

SEED = 2


def nsga2(
    evaluate: Callable[[Floats], tuple[Floats, Floats]],
    objectives: int,
    constraints: int,
    low: Floats,
    high: Floats,
    repair: Callable[[Floats], Floats],
    population: int,
    generations: int,
) -> Floats:
    """
    Return the points (n, k) of the population after so many generations, with a fixed seed.

    `evaluate` takes points (n, k) and returns f (n, objectives) and g (n, constraints), all finite;
    `repair` brings points to where they can be, as to whole numbers. n is at most `population`: no point
    is there twice. Raises `UserError` if pymoo is not installed.
    """
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.problem import Problem
        from pymoo.core.repair import Repair
        from pymoo.operators.sampling.lhs import LHS
        from pymoo.optimize import minimize
    except ImportError as error:
        raise UserError('several --minimise need pymoo: python -m pip install pymoo') from error

    class Evaluated(Problem):
        def _evaluate(self, x: Floats, out: dict[str, Any], *args: Any, **kwargs: Any) -> None:
            out['F'], out['G'] = evaluate(x)

    class Repaired(Repair):
        def _do(self, problem: Any, X: Floats, **kwargs: Any) -> Floats:
            return repair(X)

    found = minimize(
        Evaluated(len(low), objectives, constraints, xl=low, xu=high),
        NSGA2(population, sampling=LHS(), repair=Repaired()),
        ('n_gen', generations + 1),
        seed=SEED,
    )
    return np.asarray(found.pop.get('X'), np.float64)


def nondominated(objectives: Floats, others: Floats) -> np.ndarray:
    """Return which of points with objectives (n, m) none of the others (k, m) dominates, (n,)."""
    return np.array(
        [
            not np.any(np.all(others <= one, axis=1) & np.any(others < one, axis=1))
            for one in objectives
        ],
        bool,
    )
