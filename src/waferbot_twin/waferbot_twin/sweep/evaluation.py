# SPDX-License-Identifier: Apache-2.0
"""Points of a sweep: the model there, run, and the measures of it; all of them as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.timing import Timing
from waferbot_plant.validity import checks_of
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.named_parameters import at_path
from waferbot_twin.sweep.sizing import WINDINGS, largest_shares, size
from waferbot_twin.sweep.variation import overlaid
from waferbot_twin.tuning.runs import behave

FIGURES = (
    'settling_time', 'overshoot_percent', 'rms_following_error', 'peak_following_error',
    'rms_current_a', 'peak_current_a', 'winding_temperature_degc', 'load_percent',
)  # fmt: skip
"""
What can be measured of an axis.

`winding_temperature_degc` is that of the experiment repeated for ever, `load_percent` the largest share
of a limit that an axis' motor and drive, or another part, has to bear (`sizing`).
"""

OF_PARTS = ('winding_temperature_degc', 'load_percent')

ERROR = 'error'
"""The column that says why a point has no measures."""

Found = tuple[list[float], str]
"""What `evaluate` returns."""


@dataclass(frozen=True)
class Task:
    """What is run at every point: a model, the paths that vary, an experiment, the measures."""

    variant: Variant
    paths: tuple[str, ...]
    experiment: str
    measures: tuple[str, ...]


def check_measures(texts: Sequence[str], variant: Variant) -> tuple[str, ...]:
    """Return measures, `FIGURE.AXIS`; raises `UserError` for what is none."""
    axes = tuple(variant.description.axes)
    checks = [check for check, _ in checks_of(variant.build(Timing()))]
    for text in texts:
        figure, _, axis = text.partition('.')
        if figure not in FIGURES:
            raise UserError(
                f'--measure {text}: no figure {figure!r}{did_you_mean(figure, FIGURES)} '
                f'(there are: {", ".join(FIGURES)})'
            )
        if figure == 'load_percent':
            places = (*axes, *dict.fromkeys(check.place for check in checks))
            if axis not in places:
                raise UserError(
                    f'--measure {text}: give load_percent.PART, with one of {", ".join(places)}'
                    f'{did_you_mean(axis, places)}'
                )
        elif axis not in axes:
            raise UserError(
                f'--measure {text}: give FIGURE.AXIS, with an axis of {", ".join(axes)}'
                f'{did_you_mean(axis, axes)}'
            )
    return tuple(dict.fromkeys(texts))


def evaluate(task: Task, point: np.ndarray) -> Found:
    """
    Return the measures at a point, and '' or why there are none.

    Infinite: a step that does not settle, a run that blew up. NaN: a machine that cannot be.
    """
    try:
        parameters = [at_path(path, task.variant) for path in task.paths]
        variant = overlaid(task.variant, parameters, point)
        experiment = load_experiment(task.experiment)
        found = behave(variant, experiment, Timing())
        alive = all(one.alive for one in found.values())
        asked = alive and any(one.partition('.')[0] in OF_PARTS for one in task.measures)
        rows = size(variant, experiment, Timing()).rows if asked else []
    except UserError as error:
        return [math.nan] * len(task.measures), str(error)
    values = []
    for measure in task.measures:
        figure, _, part = measure.partition('.')
        if figure not in OF_PARTS:
            values.append(float(getattr(found[part], figure)))
        elif not alive:
            values.append(math.inf)
        elif figure == 'load_percent':
            values.append(100.0 * largest_shares(rows).get(part, math.nan))
        else:
            warm = [row.value for row in rows if (row.part, row.what) == (part, WINDINGS)]
            values.append(warm[0] if warm else math.nan)
    return values, '' if alive else 'the run blew up, or a motor was killed'


def as_table(
    task: Task, points: np.ndarray, found: Sequence[Found], places: Sequence[int]
) -> pd.DataFrame:
    """Return a row for each point (n, k): parameters by path, measures, `error`; index `places`."""
    columns: dict[str, object] = {
        path: points[:, column] for column, path in enumerate(task.paths)
    }
    for column, measure in enumerate(task.measures):
        columns[measure] = [values[column] for values, _ in found]
    columns[ERROR] = [error for _, error in found]
    return pd.DataFrame(columns, index=pd.Index(places, name='point'))
