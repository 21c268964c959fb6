# SPDX-License-Identifier: Apache-2.0
"""Runs of a model: the closed loop of machine, controller and amplifiers in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from waferbot.model import Model
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.engines.inprocess import CHUNK_TICKS, Signals, Twin
from waferbot_twin.engines.inprocess import run as run_and_record
from waferbot_twin.plan import Plan
from waferbot_twin.response import simulated_responses
from waferbot_twin.validity import Validity


@dataclass(frozen=True)
class Run:
    """
    A run of a model.

    `signals` has one row for each servo cycle, indexed by the time in s, and for each axis the columns
    `AXIS_commanded_U`, `AXIS_position_U` (what its encoder counted), `AXIS_following_error_U`, U = m or
    rad, `AXIS_current_command_a` and `AXIS_current_a` (the part of the measured current that makes
    force). `departures` says, a line each, where the run left the range in which the model is valid:
    place, amount and times.
    """

    model: Model
    experiment: str
    signals: pd.DataFrame = field(repr=False)
    plan: Plan = field(repr=False)
    departures: tuple[str, ...] = ()

    def to_dataframe(self) -> pd.DataFrame:
        """Return a copy of `signals`."""
        return self.signals.copy()

    def save(self, folder: str | Path, force: bool = False) -> Path:
        """
        Record the run to a new folder, as `waferbot run` does, and return it.

        It is run again: runs of one plan are the same bit by bit. Raises `UserError` if the folder
        exists and `force` is not given.
        """
        run_and_record(self.plan, Path(folder), force, lambda done, total: None)
        return Path(folder)


def simulate(
    model: Model,
    experiment: str | Path = 'step',
    duration_s: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """
    Run an experiment on a model.

    `experiment` is the name of one that comes with the package, or a YAML file; it lasts as long as it
    says, or `duration_s`. `progress` is told the ticks done and to do. Raises `UserError` if the loop is
    unstable, or if nothing is known of the model's controller.
    """
    if model.variant.is_machine_alone:
        raise UserError(
            f'{model.name} has no controller that would move it; simulate a whole model'
        )
    if duration_s is not None and not 0.0 < duration_s < 1e6:
        raise UserError(f'duration_s is {duration_s:g} s; it must be above 0 and below 1e6')
    timing, loaded = Timing(), load_experiment(str(experiment))
    ticks = max(1, timing.ticks(loaded.duration_s if duration_s is None else duration_s))
    plan = Plan(model.variant.model(), loaded, ticks, timing)
    twin = Twin.of(plan.model, timing, loaded)
    validity = Validity(plan.model, timing, twin.machine)
    pieces = []
    while twin.tick < ticks:
        signals = twin.advance(min(CHUNK_TICKS, ticks - twin.tick))
        signals.note_validity(validity)
        pieces.append(_table(model, twin, signals))
        if progress is not None:
            progress(twin.tick, ticks)
    return Run(model, loaded.name, pd.concat(pieces), plan, validity.departures())


def _table(model: Model, twin: Twin, signals: Signals) -> pd.DataFrame:
    """Return signals of a twin at the servo cycles."""
    columns: dict[str, np.ndarray] = {}
    time_s = np.zeros(0)
    for axis in simulated_responses(twin, signals):
        time_s = axis.servo_time
        if axis.axis not in model.axes:
            continue
        position = np.interp(time_s, axis.encoder_time, axis.position)
        current = axis.current[np.searchsorted(axis.tick_time, time_s)]
        columns |= {
            f'{axis.axis}_commanded_{axis.unit}': axis.commanded,
            f'{axis.axis}_position_{axis.unit}': position,
            f'{axis.axis}_following_error_{axis.unit}': axis.following_error,
            f'{axis.axis}_current_command_a': axis.current_command,
            f'{axis.axis}_current_a': current,
        }
    return pd.DataFrame(columns, index=pd.Index(time_s, name='time_s'))
