# SPDX-License-Identifier: Apache-2.0
"""
The Pareto front of several measures: who wants less of one has to take more of another.

By `nsga2`, with the limits as constraints, and that a run ends with numbers as one more. The front is
what is left in the end of the population, as far as no point that was ever run, and keeps the limits,
dominates it: it has room for as many points as a population, spread over the front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.sweep.evaluation import Task
from waferbot_twin.sweep.limits import Limit, excess
from waferbot_twin.sweep.nsga2 import nondominated, nsga2
from waferbot_twin.sweep.optimise import POPULATION
from waferbot_twin.sweep.populations import Populations, Progress
from waferbot_twin.sweep.variation import Floats, Variation, held, overlaid

LEAST_POPULATION = 40
"""Members of a population at least: a front needs more of them than a single point."""

NO_NUMBER = 1e9
"""Objectives and violations of a point whose run gives no number."""

KEPT, NUMBER = 'limits_kept', 'front'
"""Columns: whether all limits are kept; the place on the front, from 1 on, 0 beside it."""


@dataclass(frozen=True)
class Front:
    """
    A Pareto front, by rising first objective: it is empty if no point keeps the limits.

    `points` are all that were run: parameters, measures, `error`, `limits_kept`, `front`; `variants` the
    models of the front; `before` the measures of the model as it is.
    """

    objectives: tuple[str, ...]
    measures: tuple[str, ...]
    paths: tuple[str, ...]
    points: pd.DataFrame
    before: dict[str, float]
    variants: tuple[Variant, ...]

    @property
    def front(self) -> pd.DataFrame:
        """The rows of the front, in order."""
        return _front_of(self.points)


def pareto_front(
    task: Task,
    variations: Sequence[Variation],
    limits: Sequence[Limit],
    generations: int,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> Front:
    """
    Return the front of all the task's measures.

    Raises `UserError` if no point can be run to its end, or pymoo is not installed.
    """
    size = max(LEAST_POPULATION, POPULATION * len(variations))
    objectives = task.measures
    run = Populations(task, variations, limits, workers, size * (generations + 1), progress)

    def evaluate(points: Floats) -> tuple[Floats, Floats]:
        measures = run(points)
        ended = np.all(np.isfinite(measures), axis=1, keepdims=True)
        constraints = np.column_stack([excess(limits, run.names, measures), 1.0 - ended])
        return (
            np.where(ended, measures[:, : len(objectives)], NO_NUMBER),
            np.where(ended, constraints, NO_NUMBER),
        )

    low, high = (np.array([getattr(one, end) for one in variations]) for end in ('low', 'high'))
    last = nsga2(
        evaluate, len(objectives), len(limits) + 1, low, high,
        lambda points: held(variations, points), size, generations,
    )  # fmt: skip
    points = run.table
    measures = points[list(run.names)].to_numpy(float)
    ended = np.isfinite(measures).all(axis=1)
    if not ended.any():
        raise UserError('no point within these ranges could be run to its end; take others')
    paths = [one.path for one in variations]
    points[KEPT] = ended & (excess(limits, run.names, measures) <= 0.0).all(axis=1)
    points[NUMBER] = _numbers(points, paths, list(objectives), last)
    parameters = [one.parameter for one in variations]
    variants = tuple(
        overlaid(task.variant, parameters, point)
        for point in _front_of(points)[paths].to_numpy(float)
    )
    before = run.at(np.array([one.start for one in parameters]))
    return Front(objectives, run.names, tuple(paths), points, before, variants)


def _front_of(points: pd.DataFrame) -> pd.DataFrame:
    return points[points[NUMBER] > 0].sort_values(NUMBER)


def _numbers(
    points: pd.DataFrame, paths: list[str], objectives: list[str], last: Floats
) -> np.ndarray:
    """Return the place of every point on the front, 0 for one that is not on it."""
    # A point that was given up and came again was run twice: the first run of it counts.
    first: dict[bytes, int] = {}
    for place, point in enumerate(points[paths].to_numpy(float)):
        first.setdefault(point.tobytes(), place)
    kept = points[KEPT].to_numpy(bool)
    values = points[objectives].to_numpy(float)
    candidates = np.array([first[point.tobytes()] for point in last])
    candidates = candidates[kept[candidates]]
    front = candidates[nondominated(values[candidates], values[kept])]
    # By the first objective, then by the next ones.
    order = np.lexsort(values[front].T[::-1])
    numbers = np.zeros(len(points), int)
    numbers[front[order]] = np.arange(1, len(front) + 1)
    return numbers
