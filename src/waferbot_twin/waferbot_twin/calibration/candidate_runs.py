# SPDX-License-Identifier: Apache-2.0
"""
The steps of chapters 4 and 6 on machines that are only in memory, for everything that is asked of runs.

`step_runs.Runs` steps the shipped machines, once and for all. Here each run is made when it is first
asked for, on a candidate's machine of that name, so that rows and statements can be judged before
anything is written, and a question about one axis costs that axis' runs alone.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant.plant import Machine
from waferbot_pmac import servo
from waferbot_twin.calibration.evaluation import nominal_step, pristine_twin, servo_record
from waferbot_twin.calibration.values import Values
from waferbot_twin.engines.inprocess import Runaway
from waferbot_twin.response import simulated_responses
from waferbot_twin.step_runs import Run, Runs


@dataclass(frozen=True)
class Stepped:
    """A machine and what its controller has beyond the shipped settings, by axis."""

    machine: Machine
    variables: Mapping[str, Values]


class CandidateRuns(Runs):
    """
    Runs of machines by the names of `step_runs.CASES`, each made when it is first asked for.

    Models that are not among `machines` are taken from `beside`: the nominal machine's runs stay the
    same for all candidates of the as-built one.
    """

    def __init__(self, machines: Mapping[str, Stepped], beside: Runs | None = None) -> None:
        """Take the machines; nothing is run yet."""
        self._machines = machines
        self._beside = beside
        self._runs = {}

    def __getitem__(self, key: tuple[str, str]) -> Run:
        """Return the run of (model, axis); `KeyError` for a model that is not there."""
        model, axis = key
        if model not in self._machines and self._beside is not None:
            return self._beside[key]
        if key not in self._runs:
            self._runs[key] = step_on(self._machines[model], axis)
        return self._runs[key]


def step_on(stepped: Stepped, axis: str) -> Run:
    """Run the whole step experiment of an axis; a plant that blows up is run as far as it goes."""
    pristine = pristine_twin(axis)
    twin = copy.copy(pristine)
    for name, value in vars(pristine).items():
        if isinstance(value, np.ndarray):
            setattr(twin, name, value.copy())
    twin.machine = stepped.machine
    twin.plant_parameters = stepped.machine.parameters()
    twin.plant_state = stepped.machine.resting_state(twin.plant_parameters)
    twin.servo_parameters = servo_record(stepped.variables)
    twin.servo_state = servo.initial_state(twin.servo_parameters)
    try:
        signals, blew_up = twin.advance(nominal_step(axis).ticks), False
    except Runaway as error:
        signals, blew_up = error.signals, True
    responses = tuple(simulated_responses(twin, signals))
    assert len(responses) == len(AXES)
    return Run(axis, responses, 0.0, blew_up)
