# SPDX-License-Identifier: Apache-2.0
"""
What the page shows of a recording, as plain values.

Motion: position of every axis as its encoder measured it, at times that a screen can follow. Force:
current times the motor's force constant of the description, F = k_F i, as the mean over the time
between two pictures; it leaves out saturation and cogging. What the parts between motors and payload
bore (tensions of belts and cables, loads of bearings) is that of the plant, see `loads`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import ENCODERS_TOPIC
from waferbot_lockstep.errors import UserError
from waferbot_plant.motors import force_constant
from waferbot_plant.plant import load_machine
from waferbot_plant.urdf import urdf
from waferbot_twin.models import recorded_model
from waferbot_twin.plot import COMMAND_COLOUR, ERROR_COLOUR, MEASURED_COLOUR, scaled_unit
from waferbot_twin.recording.reader import Recording
from waferbot_twin.response import AxisResponse
from waferbot_twin.response_reader import axis_responses
from waferbot_twin.view.decimation import decimated
from waferbot_twin.view.loads import loads_of

PICTURE_S = 1.0 / 200.0
"""Shortest time between two positions of the machine."""

MOST_PICTURES = 20_000
"""Positions of the machine, at most: a longer recording has fewer in a second."""

STRETCHES = 1200
"""Stretches of a curve: more than a plot has columns."""

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """A signal of a plot, in the plot's unit. `held`: it keeps its value until the next sample."""

    label: str
    colour: str
    time_s: Vector
    values: Vector
    held: bool


@dataclass(frozen=True)
class Plot:
    """A plot of one axis: its title with unit, and its curves."""

    axis: str
    title: str
    curves: tuple[Curve, ...]


class ViewContent:
    """A recording, ready to be shown; raises `UserError` if it lacks what is shown."""

    def __init__(self, recording: Recording, told: Sequence[NDArray[np.void]] = ()) -> None:
        """Read axes, plots and machine from the recording; `told` are its messages of `plant_state`."""
        if 'model.yaml' not in recording.attachments:
            raise UserError(
                f'{recording.path} does not hold the model that it was made with, so its machine and '
                'units are not known; recordings of `waferbot run` do'
            )
        if len(recording[ENCODERS_TOPIC]) == 0:
            raise UserError(f'{recording.path}: no encoder counts were recorded')
        responses = axis_responses(recording)
        model = recorded_model(recording)
        machine = load_machine(model.parameters['plant'].get('description', 'rigid'))
        description = machine.description
        lacking = [axis for axis in description.layout.axes if axis not in description.motors]
        if lacking:
            raise UserError(f'{recording.path}: its machine has no motor of {", ".join(lacking)}')
        run = recording.run
        self.duration_s = recording.timing.seconds(recording.ticks)
        self.name = recording.path.resolve().name
        self.subtitle = (
            f'experiment {run.get("experiment", "?")} on model {run.get("model", "?")}, '
            f'{self.duration_s:.6g} s'
        )
        self.urdf = urdf(description)
        self.plots = [plot for response in responses for plot in _plots(response)]
        self._load_ends, self._loads = loads_of(machine, told, recording.timing)
        self._responses = responses
        self._titles = description.titles
        self._motor_turns = {axis: description.motor_turns(axis) for axis in description.motors}
        self._force_constants = {
            axis: force_constant(motor) for axis, motor in description.motors.items()
        }

    def recording(self) -> dict[str, Any]:
        """Return what the page needs once: names, machine, plots without curves, motion, loads."""
        time_s = _picture_times(self.duration_s)
        return {
            'name': self.name,
            'subtitle': self.subtitle,
            'duration': self.duration_s,
            'urdf': self.urdf,
            'axes': [self._axis(response, time_s) for response in self._responses],
            'plots': [
                {
                    'axis': plot.axis,
                    'title': plot.title,
                    'curves': [
                        {'label': curve.label, 'colour': curve.colour, 'held': curve.held}
                        for curve in plot.curves
                    ],
                }
                for plot in self.plots
            ],
            'time': time_s.tolist(),
            'load_ends': self._load_ends,
            'loads': self._loads,
        }

    def curves(self, start_s: float, end_s: float) -> list[list[list[list[float]]]]:
        """Return [times in s, values] of every curve of every plot between two times."""
        return [
            [
                [part.tolist() for part in decimated(
                    curve.time_s, curve.values, start_s, end_s, STRETCHES
                )]
                for curve in plot.curves
            ]
            for plot in self.plots
        ]  # fmt: skip

    def _axis(self, response: AxisResponse, time_s: Vector) -> dict[str, Any]:
        """Return an axis at the times of the pictures: position in m or rad, motor force in N or Nm."""
        turns = self._motor_turns[response.axis]
        constant = self._force_constants[response.axis]
        force = constant * _means(response.tick_time, response.current, time_s)
        return {
            'name': response.axis,
            'title': self._titles[response.axis],
            'unit': response.unit,
            'moves': response.moves(),
            'position': np.interp(time_s, response.encoder_time, response.position).tolist(),
            'force': force.tolist(),
            'force_name': 'motor torque' if turns else 'motor force',
            'force_unit': 'Nm' if turns else 'N',
        }


def _picture_times(duration_s: float) -> Vector:
    pictures = min(max(int(duration_s / PICTURE_S), 1) + 1, MOST_PICTURES)
    return np.linspace(0.0, duration_s, pictures, dtype=np.float64)


def _means(time_s: Vector, values: Vector, at_s: Vector) -> Vector:
    """Return the mean of the samples since the time before, at each of `at_s`; 0 if there are none."""
    ends = np.searchsorted(time_s, at_s, side='right')
    sums = np.concatenate([[0.0], np.cumsum(values)])[ends]
    counts = np.diff(ends, prepend=0)
    means: Vector = np.diff(sums, prepend=0.0) / np.maximum(counts, 1)
    return means


def _plots(response: AxisResponse) -> list[Plot]:
    """Return position, following error and current of an axis, in units that give readable numbers."""
    factor, unit = scaled_unit(
        np.concatenate([response.position, response.commanded]), response.unit
    )
    error_factor, error_unit = scaled_unit(response.following_error, response.unit)
    return [
        Plot(
            response.axis,
            f'position [{unit}]',
            (
                Curve('commanded', COMMAND_COLOUR, response.servo_time,
                      factor * response.commanded, True),
                Curve('measured', MEASURED_COLOUR, response.encoder_time,
                      factor * response.position, False),
            ),
        ),
        Plot(
            response.axis,
            f'following error [{error_unit}]',
            (
                Curve('following error', ERROR_COLOUR, response.following_time,
                      error_factor * response.following_error, False),
            ),
        ),
        Plot(
            response.axis,
            'current [A]',
            (
                Curve('command', COMMAND_COLOUR, response.command_time,
                      response.current_command, True),
                Curve('measured', MEASURED_COLOUR, response.tick_time, response.current, False),
            ),
        ),
    ]  # fmt: skip
