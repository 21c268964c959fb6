# SPDX-License-Identifier: Apache-2.0
"""
The steps of chapters 4 and 6 of the thesis, run in process: each axis alone, on every model needed.

`as_built` stands for the measured machine; `calculated` is the flexible model with the damping of
chapter 5; `calculated_rigid_drive` is that with gearbox and belt rigid. `mathematical` is the rigid
machine by the equations of Appendix B.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass

import yaml

from waferbot_lockstep.contract import AXES
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source
from waferbot_twin.engines.inprocess import Runaway, Twin
from waferbot_twin.metrics import StepMetrics
from waferbot_twin.plan import Plan, make_plan
from waferbot_twin.response import AxisResponse, rms_difference, simulated_responses
from waferbot_twin.thesis import thesis

MODELS = ('rigid', 'flexible', 'simplified', 'as_built', 'calculated')
"""The models that every axis is stepped on."""

CASES = (
    *((model, axis) for model in MODELS for axis in AXES),
    ('calculated_rigid_drive', 'x_rotate'),
    *(('mathematical', axis) for axis in AXES),
)
"""All runs, as (model, axis)."""

THESIS_COLUMN = {'rigid': 'rigid', 'flexible': 'flexible', 'as_built': 'measured'}

Y_ROTATE_DRIVE = ('gearbox', 'belt')
"""Connections of the Y-Rotate drive."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Run:
    """One step of one axis on a model: what all axes did, and the wall time of its loop."""

    axis: str
    responses: tuple[AxisResponse, ...]
    loop_s: float
    blew_up: bool

    @property
    def response(self) -> AxisResponse:
        """The response of the axis that was stepped."""
        return self.of(self.axis)

    def of(self, axis: str) -> AxisResponse:
        """Return the response of any axis."""
        return self.responses[AXES.index(axis)]


class Runs:
    """All the runs that the tables and statements are made from, each made once."""

    def __init__(self, progress: Progress = lambda done, total: None) -> None:
        """Run everything; `progress` is called with the runs done and to do."""
        self._runs = {}
        for done, (model, axis) in enumerate(CASES):
            self._runs[model, axis] = run_step(model, axis)
            progress(done + 1, len(CASES))

    def __getitem__(self, key: tuple[str, str]) -> Run:
        """Return the run of (model, axis)."""
        return self._runs[key]

    def metrics(self, model: str, axis: str, level_shift: float = 0.0) -> StepMetrics:
        """
        Return the figures of a step, with the rise by the rule that the thesis used there.

        `level_shift` moves the levels: see `metrics.step_metrics`.
        """
        rule = thesis()['steps'][axis]['rise'][THESIS_COLUMN.get(model, 'flexible')]
        found = self[model, axis].response.metrics(rule, level_shift)
        if found is None:
            raise ValueError('the response has no step')
        return found

    def rms_error(self, model: str, axis: str, reference: str = 'as_built') -> float:
        """Return the RMS error (4.2) of a model's response to that of another, m or rad."""
        return rms_difference(self[model, axis].response, self[reference, axis].response)


def step_plan(model: str, axis: str) -> Plan:
    """Return the plan of one axis' step, up and down, on a model of `CASES`."""
    calculated = model.startswith('calculated')
    plan = make_plan('flexible' if calculated else model, f'step_{axis}')
    if calculated:
        plan = copy.deepcopy(plan)
        plant = plan.model.parameters['plant']
        plant['damping'] = 'calculated'
        if model == 'calculated_rigid_drive':
            plant['description'] = _with_rigid_drive(str(plant['description']))
    return plan


def _with_rigid_drive(description: str) -> str:
    """Return the text of a description in which gearbox and belt do not give."""
    machine = yaml.safe_load(whole_text(description_source(description)))
    for name in Y_ROTATE_DRIVE:
        machine['connections'][name]['state'] = 'rigid'
    return yaml.safe_dump(machine, sort_keys=False)


def run_step(model: str, axis: str) -> Run:
    """Run one axis' step on a model, in process; a plant that blows up is run as far as it goes."""
    plan = step_plan(model, axis)
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    begun_s = time.perf_counter()
    try:
        signals, blew_up = twin.advance(plan.ticks), False
    except Runaway as error:
        signals, blew_up = error.signals, True
    loop_s = time.perf_counter() - begun_s
    return Run(axis, tuple(simulated_responses(twin, signals)), loop_s, blew_up)
