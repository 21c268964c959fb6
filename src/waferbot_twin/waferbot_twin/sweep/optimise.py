# SPDX-License-Identifier: Apache-2.0
"""
The best point: the parameters within their ranges for which a measure is smallest, within limits.

    minimise f(x)    with g_j(x) <= limit_j,    low <= x <= high

by differential evolution (scipy) with a fixed seed. A point that breaks limits costs more than any
that keeps them, by the sum of [g_j - limit_j] / |limit_j|; one whose run gives no number, more still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.sweep.evaluation import Task, check_measures, evaluate
from waferbot_twin.sweep.variation import Variation, overlaid

BROKEN, NO_NUMBER = 1e6, 1e9
POPULATION = 8


@dataclass(frozen=True)
class Limit:
    """A measure that may not be above a value."""

    measure: str
    highest: float


@dataclass(frozen=True)
class Best:
    """The best point by path, its measures, those of the model as it is, and whether limits are kept."""

    point: dict[str, float]
    measures: dict[str, float]
    before: dict[str, float]
    kept: bool
    runs: int
    variant: Variant


def parse_limits(texts: Sequence[str], variant: Variant) -> tuple[Limit, ...]:
    """Return limits, `FIGURE.AXIS<VALUE`; raises `UserError`."""
    found = []
    for text in texts:
        measure, sign, value = text.partition('<')
        try:
            highest = float(value)
        except ValueError:
            highest = math.nan
        if not sign or not math.isfinite(highest) or highest == 0.0:
            raise UserError(f'--limit {text}: give FIGURE.AXIS<VALUE, a number that is not 0')
        (measure,) = check_measures([measure.strip()], variant)
        found.append(Limit(measure, highest))
    return tuple(found)


def optimise(
    task: Task,
    variations: Sequence[Variation],
    limits: Sequence[Limit],
    generations: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Best:
    """Return the best point for the task's first measure; raises `UserError` if none can be run."""
    sought = task.measures[0]
    names = tuple(dict.fromkeys((*task.measures, *(limit.measure for limit in limits))))
    task = replace(task, measures=names)
    done, total = 0, POPULATION * len(variations) * (generations + 1)

    def cost(point: np.ndarray) -> float:
        nonlocal done
        done += 1
        progress(min(done, total), total)
        found = dict(zip(names, evaluate(task, _held(variations, point))[0], strict=True))
        over = sum(
            max(0.0, (found[limit.measure] - limit.highest) / abs(limit.highest))
            for limit in limits
        )
        if not all(math.isfinite(value) for value in found.values()):
            return NO_NUMBER
        return BROKEN + over if over > 0.0 else found[sought]

    bounds = [(one.low, one.high) for one in variations]
    result = differential_evolution(
        cost, bounds, seed=2, maxiter=generations, popsize=POPULATION, polish=False, tol=1e-6,
        strategy='currenttobest1bin', mutation=(0.4, 0.9), recombination=0.8,
    )  # fmt: skip
    if result.fun >= NO_NUMBER:
        raise UserError('no point within these ranges could be run to its end; take others')
    point = _held(variations, result.x)
    measures = dict(zip(names, evaluate(task, point)[0], strict=True))
    here = np.array([one.parameter.start for one in variations])
    before = dict(zip(names, evaluate(task, here)[0], strict=True))
    variant = overlaid(task.variant, [one.parameter for one in variations], point)
    at = {one.path: float(value) for one, value in zip(variations, point, strict=True)}
    return Best(at, measures, before, bool(result.fun < BROKEN), done, variant)


def _held(variations: Sequence[Variation], point: np.ndarray) -> np.ndarray:
    """Return a point with whole numbers where the device holds them."""
    whole = [one.parameter.whole for one in variations]
    return np.where(whole, np.rint(point), point)
