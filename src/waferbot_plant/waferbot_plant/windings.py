# SPDX-License-Identifier: Apache-2.0
"""
The windings of the motors alone, moved as somebody measured.

What the windings do follows from the voltages at their terminals and from the motion of the motor,
whatever it is that moves it: no mechanism is needed. The equations are those of `motors`, the step is
that of the plant; a winding forgets what it began with in its time constant L/R, some milliseconds.

    parameters = winding_parameters(description)
    state = initial_state(parameters, line_current)
    advance(state, parameters, before, after, voltage, step_s, substeps)
    show(state, parameters, line_current)

`motor_positions` finds the motion behind the counts of the motors' encoders. The coordinate of a motor
is its place among the axes here, so parameters and state look alike for all machines.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.timing import Timing
from waferbot_plant import current_sensors, encoders, motors
from waferbot_plant.description import Description
from waferbot_plant.plant import fill_place


@functools.cache
def parameter_dtype(axes: int, encoder_places: int) -> np.dtype:
    """Return the dtype of the parameters of so many windings and encoders."""
    return np.dtype(
        [
            *motors.parameter_fields(axes),
            *encoders.parameter_fields(encoder_places),
            *current_sensors.parameter_fields(axes),
        ],
        align=True,
    )


@functools.cache
def state_dtype(axes: int, encoder_places: int) -> np.dtype:
    """Return the dtype of their state."""
    return np.dtype(
        [
            *motors.state_fields(axes),
            *encoders.state_fields(encoder_places),
            ('position', 'f8', (axes,)),
            ('middle_position', 'f8', (axes,)),
            ('middle_velocity', 'f8', (axes,)),
        ],
        align=True,
    )


def blank_state(parameters: np.ndarray) -> np.ndarray:
    """Return a state (1,) of zeros, with the places that parameters have."""
    axes, encoder_places = (
        parameters.dtype[name].shape[0] for name in ('winding', 'encoder_delay')
    )
    return np.zeros(1, state_dtype(axes, encoder_places))


def motor_encoder(description: Description, axis: str) -> int | None:
    """Return the place of the encoder that sits on an axis' motor, None if there is none."""
    if axis not in description.motors:
        return None
    wanted = description.motors[axis].coordinate
    return next(
        (
            place
            for place, name in enumerate(description.layout.encoders)
            if name in description.encoders and description.encoders[name].coordinate == wanted
        ),
        None,
    )


def winding_parameters(
    description: Description, encoder_hz: float = Timing().encoder_hz
) -> np.ndarray:
    """
    Return the parameters (`parameter_dtype`, shape (1,)) of windings, their sensors and encoders.

    `encoder_hz` is the rate of the readings, in whose cycles delays come out.
    Without noise: what is computed here is what a measurement is compared with.
    """
    layout = description.layout
    parameters = np.zeros(1, parameter_dtype(len(layout.axes), len(layout.encoders)))
    p = parameters[0]
    p['motor_coordinate'] = range(len(layout.axes))
    p['motor_ratio'] = 1.0
    for place, axis in enumerate(layout.axes):
        if axis in description.motors:
            fill_place(p, place, motors.motor_data(description.motors[axis]))
        if axis in description.current_sensors:
            sensors = description.current_sensors[axis]
            fill_place(p, place, current_sensors.sensor_data(sensors))
        encoder = motor_encoder(description, axis)
        if encoder is not None:
            p['encoder_coordinate'][encoder] = place
            own = description.encoders[layout.encoders[encoder]]
            late = description.encoder_delay
            fill_place(p, encoder, encoders.encoder_data(own, 1.0, late, encoder_hz))
    p['current_noise'] = 0.0
    p['encoder_noise'] = 0.0
    return parameters


def initial_state(parameters: np.ndarray, line_current: np.ndarray) -> np.ndarray:
    """Return the state (`state_dtype`, shape (1,)) with line currents (2 axes,) as measured, A."""
    state = blank_state(parameters)
    state['winding_temperature'] = parameters['start_temperature']
    for motor in range(len(parameters[0]['winding'])):
        first, second = (
            current_sensors.true_current(
                parameters[0], motor, line, line_current[current_sensors.LINES * motor + line]
            )
            for line in range(current_sensors.LINES)
        )
        motors.set_line_currents(state, parameters, motor, (first, second))
    return state


def motor_positions(parameters: np.ndarray, counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Return the position (rows, axes) of each motor, m or rad, whose encoders see `counts` (rows,
    encoders).

    Scale, cyclic errors and lost counts of the model's encoders are taken out; delays are not, they
    are the caller's. Zero for a motor without an encoder.
    """
    exact = parameters.copy()
    exact['delay_fraction'] = 0.0
    position = np.zeros((len(counts), len(parameters[0]['winding'])))
    encoders.find_positions(blank_state(exact), exact, counts, position)
    return position


@compiled
def advance(state, parameters, before, after, voltage, step_s, substeps):
    """
    Advance the windings by `substeps` steps of `step_s` seconds with the voltages (3 axes,) held, V.

    `before` and `after` (axes,) are the positions of the motors where it begins and ends, m or rad; they
    move evenly in between.
    """
    s = state[0]
    p = parameters[0]
    middle = s['middle_position']
    speed = s['middle_velocity']
    for substep in range(substeps):
        for motor in range(len(p['winding'])):
            way = after[motor] - before[motor]
            middle[motor] = before[motor] + way * (substep + 0.5) / substeps
            speed[motor] = way / (substeps * step_s)
        motors.begin_step(s, p, middle, voltage, step_s)
        motors.finish_step(s, p, speed, voltage, step_s)


@compiled
def show(state, parameters, line_current):
    """Fill `line_current` (2 axes,) with lines 1 and 2 of each motor as its sensors show them, A."""
    current_sensors.measure_currents(state[0], parameters[0], 0, line_current)
