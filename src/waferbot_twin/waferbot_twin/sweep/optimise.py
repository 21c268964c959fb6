# SPDX-License-Identifier: Apache-2.0
"""
The best point: the parameters within their ranges for which a measure is smallest, within limits.

    minimise f(x)    with g_j(x) <= limit_j,    low <= x <= high

by `differential_evolution`, a population at a time. A point that violates limits costs more than any
that keeps them, by the sum of its violations; one whose run gives no number, more still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.differential_evolution import minimise
from waferbot_twin.effects.variant import Variant
from waferbot_twin.sweep.evaluation import Task
from waferbot_twin.sweep.limits import Limit, excess
from waferbot_twin.sweep.populations import Populations, Progress
from waferbot_twin.sweep.variation import Floats, Variation, held, overlaid

BROKEN, NO_NUMBER = 1e6, 1e9
POPULATION = 8
"""Members of a population for each parameter."""


@dataclass(frozen=True)
class Best:
    """The best point by path, its measures, those of the model as it is, and whether limits are kept."""

    point: dict[str, float]
    measures: dict[str, float]
    before: dict[str, float]
    kept: bool
    runs: int
    variant: Variant


def optimise(
    task: Task,
    variations: Sequence[Variation],
    limits: Sequence[Limit],
    generations: int,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> Best:
    """Return the best point for the task's first measure; raises `UserError` if none can be run."""
    planned = POPULATION * len(variations) * (generations + 1)
    run = Populations(task, variations, limits, workers, planned, progress)

    def costs(points: Floats) -> Floats:
        measures = run(points)
        violation = np.maximum(excess(limits, run.names, measures), 0.0).sum(axis=1)
        cost = np.where(violation > 0.0, BROKEN + violation, measures[:, 0])
        return np.where(np.isfinite(measures).all(axis=1), cost, NO_NUMBER)

    low, high = (np.array([getattr(one, end) for one in variations]) for end in ('low', 'high'))
    found, cost = minimise(costs, low, high, generations, POPULATION, 1e-6)
    if cost >= NO_NUMBER:
        raise UserError('no point within these ranges could be run to its end; take others')
    point = held(variations, found)
    here = np.array([one.parameter.start for one in variations])
    variant = overlaid(task.variant, [one.parameter for one in variations], point)
    at = {one.path: float(value) for one, value in zip(variations, point, strict=True)}
    return Best(at, run.at(point), run.at(here), cost < BROKEN, run.runs, variant)
