# SPDX-License-Identifier: Apache-2.0
"""Tuning of an axis' gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from waferbot.model import Model
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.tuning import tune as tuning
from waferbot_twin.tuning.report import margin_table
from waferbot_twin.tuning.search import GENERATIONS, Required


@dataclass(frozen=True)
class Tuned:
    """
    New gains of an axis.

    `gains` has the I-variables, columns `before` and `after`. `margins` has a row for each machine, pose
    and set of gains (`gains`: before, after), with the pose (m, rad), `stable`, `gain_db`, `phase_deg`,
    `delay_s`, `crossover_hz`, `sensitivity`, `bandwidth_hz`. `met` tells whether all of them are stable
    and have what was required. `details` is the whole result.
    """

    model: Model
    gains: pd.DataFrame
    margins: pd.DataFrame
    met: bool
    details: tuning.Tuned = field(repr=False)


def tune(
    model: Model,
    axis: str,
    bandwidth_hz: float | None = None,
    experiment: str | Path | None = None,
    measure: str = 'settling_time',
    also: Sequence[Model] = (),
    poses: Mapping[str, Sequence[float]] | None = None,
    gain_margin_db: float = 6.0,
    phase_margin_deg: float = 35.0,
    generations: int = GENERATIONS,
) -> Tuned:
    """
    Find gains of an axis for a bandwidth (Hz), or for the smallest measure of an experiment.

    `also` are machines that the same gains must suit; `poses` are positions by axis (m, rad), of which
    all combinations count. `measure` is `settling_time`, `rms_following_error` or `overshoot_percent`.
    Raises `UserError` if there is nothing to tune for, or the model has no such axis.
    """
    variant = model.variant
    design = tuning.design_of(
        variant,
        axis,
        tuning.poses_of(variant, poses or {}),
        [other.variant for other in also],
        Required(gain_margin_db, phase_margin_deg),
    )
    loaded = None if experiment is None else load_experiment(str(experiment))
    found = tuning.tune(design, loaded, measure, bandwidth_hz, generations)
    gains = pd.DataFrame({'before': found.before, 'after': found.after})
    return Tuned(Model(found.variant), gains, margin_table(found), found.met, found)
