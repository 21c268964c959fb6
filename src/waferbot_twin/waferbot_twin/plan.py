# SPDX-License-Identifier: Apache-2.0
"""What to run: a model, an experiment and how long; and the texts that tell of it in the recording."""

from __future__ import annotations

import dataclasses
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

from waferbot_lockstep.timing import Timing
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source
from waferbot_pmac.experiments import Experiment, check_units, load_experiment
from waferbot_twin.models import Model, load_model
from waferbot_twin.recording.writer import as_json
from waferbot_twin.version import git_revision

VERSIONED = ('numpy', 'scipy', 'numba', 'mcap', 'ros-jazzy-rclpy', 'ros-jazzy-rmw-fastrtps-cpp')


@dataclass(frozen=True)
class Plan:
    """
    One run of the twin, before it is run; every engine makes the same of it.

    `foreign_plant` says which FMU is in the place of the plant, if there is one.
    """

    model: Model
    experiment: Experiment
    ticks: int
    timing: Timing
    seed: int = 0
    foreign_plant: Mapping[str, str] | None = None

    def attachments(self, engine: str, without: Sequence[str] = ()) -> dict[str, str]:
        """
        Return the texts that go into the recording: everything that the run was made from.

        `without` names the nodes that somebody else provided.
        """
        run: dict[str, Any] = {
            'engine': engine,
            'model': self.model.name,
            'experiment': self.experiment.name,
            'ticks': self.ticks,
            'seed': self.seed,
            'timing': dataclasses.asdict(self.timing),
            'axes': list(self.model.layout.axes),
            'encoders': list(self.model.layout.encoders),
            'without': list(without),
            'versions': versions(),
        }
        if self.foreign_plant is not None:
            run['plant'] = dict(self.foreign_plant)
        return {
            'run.json': as_json(run),
            'model.yaml': self.model.text,
            'machine.yaml': whole_text(description_source(self.model.description)),
            'experiment.yaml': self.experiment.text,
        }


@dataclass(frozen=True)
class Outcome:
    """
    What came of a run: the recorder's closing line, and how long the loop took.

    `loop_s` is wall time from the first tick to the last, without start-up, compiling and closing.
    `departures` says where the run left the range of its model, see `validity`.
    """

    recorder: str
    loop_s: float
    departures: tuple[str, ...] = ()


def make_plan(model: str, experiment: str, duration_s: float | None = None, seed: int = 0) -> Plan:
    """Return the plan for a model and an experiment, by name or file; raises `UserError`."""
    timing = Timing()
    loaded = load_experiment(experiment)
    seconds = loaded.duration_s if duration_s is None else duration_s
    found = load_model(model)
    check_units(loaded, found.axis_units)
    return Plan(found, loaded, max(1, timing.ticks(seconds)), timing, seed)


def versions() -> dict[str, Any]:
    """Return the versions that a result can depend on; `git` is None outside a checkout."""
    found: dict[str, Any] = {'python': sys.version.split()[0], 'machine': platform.machine()}
    for name in VERSIONED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    found['git'] = git_revision()
    return found
