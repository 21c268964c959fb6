# SPDX-License-Identifier: Apache-2.0
"""
Compensation tables from a model: what current its motions need, by inverse dynamics.

`motion_tables` are over the time of one experiment: everything that the motion needs, with what the
axes do to one another. `machine_tables` are the machine's, for any motion: over the position of each
axis gravity and cogging, with the others at home, and over its speed friction and damping. What the
bias (Ixx29) and tables that are there already give is taken off. Lines that follow from their
neighbours are left out.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_pmac.compensation import TIME, Table, over_position, over_speed, table_text
from waferbot_pmac.experiments import Experiment, commanded_positions
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects.places import length_unit
from waferbot_twin.effects.variant import Overlay, Variant

Floats = NDArray[np.float64]

KINDS = ('tables', 'motion')

AS_GOOD = 5e-4
"""What leaving out a line may change, as a share of the largest current of its table."""

FEWEST_POINTS, PER_PERIOD, MOST_POINTS = 400, 24, 20000
"""Of a table over position, before lines are left out: at least, per period of a force, at most."""

STANDING = 1e-6
"""Speed, m/s or rad/s, from which friction is compensated in full; a commanded stop is exactly zero."""


def commanded_motion(variant: Variant, experiment: Experiment, timing: Timing) -> Floats:
    """Return the commanded positions (cycles, axes) of an experiment, m or rad."""
    parameters = servo_parameters(variant.pmac, variant.name, variant.layout)
    counts = commanded_positions(
        experiment, parameters, timing.servo_hz, variant.description.axis_units
    )
    return np.asarray(counts / parameters['counts_per_unit'][0])


def motion_tables(
    variant: Variant, experiment: Experiment, timing: Timing | None = None
) -> tuple[Table, ...]:
    """
    Return what an experiment needs, by axis, over its time.

    A command is held over a servo cycle, so it is the mean of what its two ends need. Raises
    `UserError` where a motor cannot make it, or the motion jumps.
    """
    timing = timing or Timing()
    position = commanded_motion(variant, experiment, timing)
    velocity = np.gradient(position, axis=0) * timing.servo_hz
    acceleration = np.gradient(velocity, axis=0) * timing.servo_hz
    velocity[np.abs(velocity) < STANDING] = 0.0
    dynamics = InverseDynamics(variant.description, timing)
    columns = [variant.layout.place(axis) for axis in dynamics.axes]
    currents = dynamics.currents(
        position[:, columns], velocity[:, columns], acceleration[:, columns]
    )
    held = 0.5 * (currents + np.vstack([currents[1:], currents[-1:]]))
    time_s = np.arange(len(position)) / timing.servo_hz
    found = []
    for column, axis in enumerate(dynamics.axes):
        _check_within(variant, axis, held[:, column], experiment.name)
        added = held[:, column] - _given(variant, axis)
        found.append(_thinned(axis, f'{TIME}:{experiment.name}', time_s, added))
    return tuple(found)


def machine_tables(
    variant: Variant, travel: dict[str, tuple[float, float]], speed: dict[str, float]
) -> tuple[Table, ...]:
    """
    Return what the machine needs at each position and at each speed of an axis, the others at home.

    `travel` are positions from and to, m or rad, `speed` the highest speed, per axis.
    """
    dynamics = InverseDynamics(variant.description)
    found = []
    for column, axis in enumerate(dynamics.axes):
        if axis not in travel:
            continue
        low, high = travel[axis]
        at = np.linspace(low, high, _points(variant, axis, high - low), dtype=np.float64)
        still = np.zeros((len(at), len(dynamics.axes)))
        position = still.copy()
        position[:, column] = at
        needed = dynamics.currents(position, still, still)[:, column]
        _check_within(variant, axis, needed, 'the machine')
        unit = length_unit(variant, axis)
        found.append(_thinned(axis, over_position(unit), at, needed - _given(variant, axis)))
        found.append(_speed_table(dynamics, axis, unit, column, speed[axis]))
    return tuple(found)


def _speed_table(
    dynamics: InverseDynamics, axis: str, unit: str, column: int, highest: float
) -> Table:
    """Return what friction and damping take, over the speed; zero at rest, with a jump beside it."""
    side = np.concatenate([[STANDING], np.linspace(0.0, highest, 101)[1:]])
    at = np.concatenate([-side[::-1], side])
    velocity = np.zeros((len(at), len(dynamics.axes)))
    velocity[:, column] = at
    rest = np.zeros((1, len(dynamics.axes)))
    needed = dynamics.currents(0.0 * velocity, velocity, 0.0 * velocity)[:, column]
    needed = needed - dynamics.currents(rest, rest, rest)[0, column]
    half = len(side)
    backward = _thinned(axis, '', at[:half], needed[:half])
    forward = _thinned(axis, '', at[half:], needed[half:])
    return Table(
        axis,
        over_speed(unit),
        np.concatenate([backward.at, [0.0], forward.at]),
        np.concatenate([backward.current, [0.0], forward.current]),
    )


def compensated(variant: Variant, tables: tuple[Table, ...]) -> Variant:
    """
    Return the model with tables in place of its own, and with Ixx32 = Ixx31 and no Ixx35, Ixx68.

    The derivative gain brakes by the speed as friction does; equal to it, the velocity feedforward
    takes that back. Acceleration is in tables over time; tables of the machine leave it to Ixx35, which
    is then that of the axis' inertia.
    """
    of_motion = {table.axis for table in tables if table.experiment}
    servo = servo_parameters(variant.pmac, variant.name, variant.layout)[0]
    gains: dict[str, dict[str, float]] = {}
    for axis in {table.axis for table in tables}:
        place = variant.layout.place(axis)
        acceleration = 0 if axis in of_motion else _acceleration_gain(variant, servo, axis)
        gains[axis] = {
            'Ixx32': int(servo['Ixx31'][place]), 'Ixx35': acceleration, 'Ixx68': 0
        }  # fmt: skip
    changed = variant.with_overlay(Overlay(pmac=gains))
    settings = {name: dict(values) for name, values in variant.node_settings.items()}
    settings.setdefault('pmac', {})['compensation'] = table_text(tables)
    return replace(changed, node_settings=settings)


def _acceleration_gain(variant: Variant, servo: np.void, axis: str) -> int:
    """Return Ixx35 for the inertia of an axis at home: what `Ixx30 Ixx08 Ixx35` is multiplied by."""
    dynamics = InverseDynamics(variant.description)
    place, column = variant.layout.place(axis), dynamics.axes.index(axis)
    motion = np.zeros((2, len(dynamics.axes)))
    pushed = motion.copy()
    pushed[1, column] = 1.0
    needed = dynamics.currents(motion, motion, pushed)[:, column]
    per_acceleration = needed[1] - needed[0]  # A per m/s2 or rad/s2
    dac = per_acceleration * 32768.0 / servo['amplifier_peak_current'][place]
    counts_per_cycle2 = servo['counts_per_unit'][place] / Timing().servo_hz ** 2
    scale = 2.0**-26 * servo['Ixx30'][place] * servo['Ixx08'][place] * counts_per_cycle2
    return round(float(dac / scale)) if scale else 0


def _given(variant: Variant, axis: str) -> float:
    """Return what the bias Ixx29 gives already, A."""
    amperes = variant.i_variable(axis, 'amplifier_peak_current') / 32768.0
    return variant.i_variable(axis, 'Ixx29') * amperes


def _check_within(variant: Variant, axis: str, currents: Floats, what: str) -> None:
    limit = variant.i_variable(axis, 'Ixx69') / 32768.0
    limit *= variant.i_variable(axis, 'amplifier_peak_current')
    largest = float(np.max(np.abs(currents)))
    if not math.isfinite(largest) or largest > limit:
        raise UserError(
            f'{what} needs {largest:.3g} A on {axis}; its output limit (Ixx69) is {limit:.3g} A. '
            'A commanded jump needs any current: give a motion without steps, or a slower one'
        )


def _points(variant: Variant, axis: str, travel: float) -> int:
    """Return how many points a table over a travel has: enough for the shortest period in it."""
    description = variant.description
    placing = variant.rigid.placing
    row, to_axis = placing[description.axes[axis]]
    periods = [
        2.0 * math.pi / (force.wave_number * abs(ratio / to_axis))
        for force in description.disturbances.values()
        for place, ratio in [placing[force.coordinate]]
        if place == row and force.wave_number and ratio
    ]
    motor = description.motors[axis]
    ratio = abs(placing[motor.coordinate][1] / to_axis)
    for ripple in motor.ripple:
        periods.append(2.0 * math.pi / (ripple.order * abs(motor.electrical_gain) * ratio))
    shortest = min(periods, default=travel)
    return min(max(FEWEST_POINTS, math.ceil(PER_PERIOD * travel / shortest)), MOST_POINTS)


def _thinned(axis: str, over: str, at: Floats, current: Floats) -> Table:
    """Return a table without the lines that their neighbours give, to `AS_GOOD` (Douglas, Peucker)."""
    tolerance = AS_GOOD * max(float(np.max(np.abs(current))), 1e-9)
    kept = np.zeros(len(at), bool)
    kept[[0, -1]] = True
    open_parts = [(0, len(at) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        line = np.interp(at[inside], at[[first, last]], current[[first, last]])
        away = np.abs(current[inside] - line)
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            place = first + 1 + worst
            kept[place] = True
            open_parts += [(first, place), (place, last)]
    return Table(axis, over, at[kept], current[kept])
