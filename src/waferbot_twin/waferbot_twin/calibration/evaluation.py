# SPDX-License-Identifier: Apache-2.0
"""A candidate's steps beside those of the thesis: rows, and what they cost."""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant.assembly import assemble
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine
from waferbot_pmac import servo
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.calibration.demands import charge
from waferbot_twin.calibration.values import Values
from waferbot_twin.engines.inprocess import Runaway, Twin
from waferbot_twin.metrics import FIGURES
from waferbot_twin.plan import Plan, make_plan
from waferbot_twin.response import AxisResponse, simulated_responses
from waferbot_twin.thesis import printed, thesis, tolerance

STEP_S = 0.02
"""When the step experiments step."""

UNREACHED = {
    'y_rotate.flexible.delay_time': 0.02,
    'y_linear.flexible.overshoot_percent': 0.4,
}
"""Weights of rows that cannot be met with the others, so that they do not drag those along."""


@dataclass(frozen=True)
class Residual:
    """A row: what the thesis has, what a candidate has, and what is allowed between them."""

    axis: str
    column: str
    figure: str
    thesis: float
    ours: float

    @property
    def row(self) -> str:
        """The row's name, as in `known_deviations.yaml`."""
        return f'{self.axis}.{self.column}.{self.figure}'

    @property
    def tolerances(self) -> float:
        """Distance in units of the tolerance; infinite for a figure that does not exist."""
        width = tolerance(self.column, self.figure).width(self.thesis)
        distance = abs(self.ours - self.thesis) / width
        return distance if math.isfinite(distance) else math.inf


@dataclass
class Evaluation:
    """
    Residuals of a candidate, penalties by the condition that they are for, and further demands.

    `demands` are those of `calibration.demands`, by name: 0 for one that is met, else its distance.
    """

    residuals: list[Residual] = field(default_factory=list)
    penalties: dict[str, float] = field(default_factory=dict)
    demands: dict[str, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """What is minimised: misfit beyond 0.8 tolerances, a little of all, penalties, demands."""
        total = sum(self.penalties.values()) + charge(self.demands.values())
        for residual in self.residuals:
            if residual.figure == 'peak':  # the same as the overshoot
                continue
            distance = min(residual.tolerances, 12.0)
            weight = UNREACHED.get(residual.row, 1.0)
            total += weight * (max(0.0, distance - 0.8) + 0.03 * min(distance, 3.0) ** 2)
        return total


@functools.cache
def nominal_step(axis: str) -> Plan:
    """Return the plan of an axis' step on the shipped flexible model."""
    return make_plan('flexible', f'step_{axis}')


@functools.cache
def pristine_twin(axis: str) -> Twin:
    """Return a twin whose settings candidates start from; it is never run."""
    plan = nominal_step(axis)
    return Twin.of(plan.model, plan.timing, plan.experiment)


def servo_record(variables: Mapping[str, Values]) -> np.ndarray:
    """Return `SERVO_PARAMETERS` (1,) of the shipped settings with these I-variables in them."""
    plan = nominal_step(AXES[0])
    settings = {
        axis: {**plan.model.of_axes('pmac')[axis], **variables.get(axis, {})} for axis in AXES
    }
    return servo_parameters(settings, 'candidate')


def respond(
    machine: Machine, axis: str, variables: Mapping[str, Values], duration_s: float
) -> AxisResponse:
    """Return an axis' response to its step on a candidate, run for `duration_s`."""
    pristine = pristine_twin(axis)
    twin = copy.copy(pristine)
    for name, value in vars(pristine).items():
        if isinstance(value, np.ndarray):
            setattr(twin, name, value.copy())
    twin.machine = machine
    twin.plant_parameters = machine.parameters()
    twin.plant_state = machine.resting_state(twin.plant_parameters)
    twin.servo_parameters = servo_record(variables)
    twin.servo_state = servo.initial_state(twin.servo_parameters)
    try:
        signals = twin.advance(machine.timing.ticks(duration_s + STEP_S))
    except Runaway as error:
        signals = error.signals
    return simulated_responses(twin, signals)[AXES.index(axis)]


def residuals(response: AxisResponse, column: str) -> list[Residual]:
    """Return the rows of a response against a column of the thesis."""
    axis = response.axis
    metrics = response.metrics(thesis()['steps'][axis]['rise'][column])
    assert metrics is not None  # the step experiments step
    return [
        Residual(axis, column, figure, printed(axis, column, figure), getattr(metrics, figure))
        for figure in FIGURES
    ]


def late_motion(response: AxisResponse, last_s: float) -> float:
    """Return the peak-to-peak motion in the last `last_s` of a response, in steps."""
    step = response.step()
    assert step is not None
    late = response.position[response.encoder_time > response.encoder_time[-1] - last_s]
    return float(np.ptp(late)) / abs(step[1])


def machine_of(description: Description) -> Machine:
    """Return the machine of a description, at the rates of the step experiments."""
    return Machine(description, assemble(description), nominal_step(AXES[0]).timing)
