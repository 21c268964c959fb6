# SPDX-License-Identifier: Apache-2.0
"""The points that an optimisation asks for, a population at a time, run side by side and all kept."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from waferbot_twin.evaluations import in_order
from waferbot_twin.sweep.evaluation import Found, Task, as_table, evaluate
from waferbot_twin.sweep.limits import Limit
from waferbot_twin.sweep.variation import Floats, Variation, held

Progress = Callable[[int, int], None]


class Populations:
    """
    Measures of points, by calling it with (n, k); `table` has every point that was run.

    Measured are those of the task, then those of the limits: `names`. `progress` is told how many
    points of the `planned` ones are done; there may be fewer.
    """

    def __init__(
        self,
        task: Task,
        variations: Sequence[Variation],
        limits: Sequence[Limit],
        workers: int,
        planned: int,
        progress: Progress,
    ) -> None:
        """Run nothing yet."""
        self.names = tuple(dict.fromkeys((*task.measures, *(one.measure for one in limits))))
        self.task = replace(task, measures=self.names)
        self._variations, self._workers = tuple(variations), workers
        self._planned, self._progress = planned, progress
        self._points: list[Floats] = []
        self._found: list[Found] = []

    def __call__(self, points: Floats) -> Floats:
        """Return the measures (n, names) of points (n, k), as the devices hold them."""
        points = held(self._variations, points)
        first = len(self._found)
        for found in in_order(functools.partial(evaluate, self.task), points, self._workers):
            self._found.append(found)
            self._progress(min(len(self._found), self._planned), self._planned)
        self._points.append(points)
        return np.array([values for values, _ in self._found[first:]])

    @property
    def runs(self) -> int:
        """How many points were run."""
        return len(self._found)

    @property
    def table(self) -> pd.DataFrame:
        """A row for each point, in the order in which they were run."""
        return as_table(self.task, np.vstack(self._points), self._found, range(self.runs))

    def at(self, point: Floats) -> dict[str, float]:
        """Return the measures of one more point (k,), which is not kept."""
        return dict(zip(self.names, evaluate(self.task, point)[0], strict=True))
