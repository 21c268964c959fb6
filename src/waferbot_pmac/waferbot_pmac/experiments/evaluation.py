# SPDX-License-Identifier: Apache-2.0
"""From an experiment to the commanded position of every motor in every servo cycle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_pmac import trajectories
from waferbot_pmac.experiments.loading import LENGTH_UNITS, Experiment, Motion
from waferbot_pmac.experiments.units import check_units
from waferbot_pmac.trajectories import Acceleration, Floats, LinearPath
from waferbot_pmac.user_units import Units

VELOCITY_REGISTER_LIMIT = 805306368.0
"""Largest commanded velocity times Ixx08, in counts per second, that the controller can hold."""

MILLISECONDS = 1000.0  # per second; Ixx16 and Ixx22 are per ms, Ixx17 and Ixx19 per ms^2

DEFAULT_ACCELERATION_TIME_S = 0.0
DEFAULT_S_CURVE_TIME_S = 0.05


def commanded_positions(
    experiment: Experiment,
    parameters: np.ndarray,
    servo_rate_hz: float,
    units: Units = USUAL_UNITS,
) -> Floats:
    """
    Return the commanded positions, float64 of shape (cycles, axes), in counts of each position
    encoder.

    Row k belongs to the servo cycle k / `servo_rate_hz` seconds after the start; there are
    duration_s * servo_rate_hz rows, to the nearest whole number. Positions are relative to the
    commanded positions at the start, zero for an axis that is not named. Steps and random
    positions are whole counts, moves and sines have fractions, as on the controller.

    `parameters` are those of the servo: counts per unit, velocity and acceleration limits;
    `units` says of each axis of the machine whether it is measured in m or in rad. Raises `UserError`
    with file, line and key for what cannot be commanded: a length in another unit, a move that is not
    over by the end, a velocity that overflows the controller's register, a frequency above half the
    servo rate.
    """
    check_units(experiment, units)
    times = trajectories.cycle_times(experiment.duration_s, servo_rate_hz)
    if not times.size:
        raise UserError(
            f'{experiment.document.where(("duration_s",))} is shorter than one servo cycle, '
            f'{1.0 / servo_rate_hz:.6g} s'
        )
    motors = [_Motor(parameters, place, axis) for place, axis in enumerate(units)]
    result = np.zeros((times.size, len(motors)))
    for place, motor in enumerate(motors):
        for motion in experiment.motion.get(motor.axis, ()):
            evaluation = _Motion(experiment, motor, motion, servo_rate_hz)
            result[:, place] += evaluation.positions(times)
    if experiment.program:
        _Program(experiment, motors).run(times, result)
    return result


class _Motor:
    """The limits of one motor, in counts and seconds."""

    def __init__(self, parameters: np.ndarray, place: int, axis: str) -> None:
        def setting(name: str) -> float:
            return float(parameters[name][0, place])

        self.axis = axis
        self.counts_per_unit = setting('counts_per_unit')
        self.max_velocity = setting('Ixx16') * MILLISECONDS
        self.max_acceleration = setting('Ixx17') * MILLISECONDS**2
        self.max_jog_acceleration = setting('Ixx19') * MILLISECONDS**2
        self.jog_acceleration_time_s = setting('Ixx20') / MILLISECONDS
        self.jog_s_curve_time_s = setting('Ixx21') / MILLISECONDS
        self.jog_speed = setting('Ixx22') * MILLISECONDS
        self.velocity_register_limit = VELOCITY_REGISTER_LIMIT / setting('Ixx08')

    def counts(self, value: float, unit: str) -> float:
        """Return a position, distance or speed in counts."""
        return float(value) if unit == 'counts' else float(value) * self.counts_per_unit

    def jog_acceleration(self, where: str) -> Acceleration:
        """Return the acceleration times of jog and RAPID moves from Ixx20 and Ixx21."""
        if self.jog_acceleration_time_s == 0.0 and self.jog_s_curve_time_s == 0.0:
            raise UserError(f'{where}: Ixx20 and Ixx21 of {self.axis} must not both be zero')
        return trajectories.acceleration(self.jog_acceleration_time_s, self.jog_s_curve_time_s)


def _whole_milliseconds(seconds: float) -> float:
    """Return TA or TS as the controller holds it."""
    return round(seconds * MILLISECONDS) / MILLISECONDS


def _acceleration(where: str, mapping: Mapping[str, Any]) -> Acceleration:
    """Return TA and TS of a LINEAR move."""
    total_s = _whole_milliseconds(mapping.get('acceleration_time_s', DEFAULT_ACCELERATION_TIME_S))
    s_curve_s = _whole_milliseconds(mapping.get('s_curve_time_s', DEFAULT_S_CURVE_TIME_S))
    if total_s == 0.0 and s_curve_s == 0.0:
        raise UserError(f'{where}: acceleration_time_s and s_curve_time_s must not both be zero')
    return trajectories.acceleration(total_s, s_curve_s)


def _check_velocity(where: str, motor: _Motor, velocity: float) -> None:
    if abs(velocity) > motor.velocity_register_limit:
        raise UserError(
            f'{where}: {abs(velocity):.6g} counts/s overflow the velocity register of '
            f'{motor.axis}; it holds {motor.velocity_register_limit:.6g} counts/s with this Ixx08'
        )


class _Motion:
    """The motion of one axis, of one of the kinds of the schema."""

    def __init__(
        self,
        experiment: Experiment,
        motor: _Motor,
        motion: Motion,
        servo_rate_hz: float,
    ) -> None:
        self.path = motion.path
        self.experiment = experiment
        self.motion = motion.values
        self.motor = motor
        self.servo_rate_hz = servo_rate_hz
        self.start_s = float(motion.values.get('start_s', 0.0))

    def positions(self, times: Floats) -> Floats:
        kinds: dict[str, Callable[[Floats], Floats]] = {
            'constant': self._constant,
            'step': self._step,
            'bidirectional_step': self._bidirectional_step,
            'random': self._random,
            'swept_sine': self._swept_sine,
            'multisine': self._multisine,
            'constant_velocity': self._constant_velocity,
            'jog': self._jog,
            'linear': self._linear,
            'rapid': self._rapid,
        }
        return kinds[self.motion['kind']](times)

    def _where(self, *key: str) -> str:
        return self.experiment.document.where((*self.path, *key))

    def _length(self, quantity: str) -> float | None:
        """Return a quantity given in m, rad or counts, in counts; None if it is not given."""
        for unit in LENGTH_UNITS:
            if f'{quantity}_{unit}' in self.motion:
                return self.motor.counts(self.motion[f'{quantity}_{unit}'], unit)
        return None

    def _required(self, quantity: str) -> float:
        value = self._length(quantity)
        assert value is not None  # checked when the experiment was loaded
        return value

    def _speed(self) -> float | None:
        for unit in LENGTH_UNITS:
            if f'speed_{unit}_per_s' in self.motion:
                return self.motor.counts(self.motion[f'speed_{unit}_per_s'], unit)
        return None

    def _frequency(self, key: str) -> float:
        value = float(self.motion[key])
        if value >= self.servo_rate_hz / 2.0:
            raise UserError(
                f'{self._where(key)} is {value:g} Hz; it must be below half the servo rate, '
                f'{self.servo_rate_hz / 2.0:g} Hz'
            )
        return value

    def _constant(self, times: Floats) -> Floats:
        return trajectories.constant(times, self._length('position') or 0.0)

    def _step(self, times: Floats) -> Floats:
        return trajectories.step(times, self.start_s, round(self._required('amplitude')))

    def _bidirectional_step(self, times: Floats) -> Floats:
        return trajectories.bidirectional_step(
            times, self.start_s, self.motion['return_s'], round(self._required('amplitude'))
        )

    def _random(self, times: Floats) -> Floats:
        return np.rint(
            trajectories.random(
                times,
                self.start_s,
                self._required('amplitude'),
                self.motion['hold_s'],
                int(self.motion['seed']),  # 2.0 is a whole number in YAML, too
            )
        )

    def _swept_sine(self, times: Floats) -> Floats:
        return trajectories.swept_sine(
            times,
            self.start_s,
            float(self.motion.get('end_s', self.experiment.duration_s)),
            self._required('amplitude'),
            self._frequency('first_frequency_hz'),
            self._frequency('last_frequency_hz'),
            float(self.motion.get('corner_frequency_hz', 0.0)),
            float(self.motion.get('fade_s', 0.0)),
        )

    def _multisine(self, times: Floats) -> Floats:
        period_s = float(self.motion['period_s'])
        first, last = self._frequency('first_frequency_hz'), self._frequency('last_frequency_hz')
        seed = self.motion.get('seed')
        if not trajectories.harmonics_between(period_s, first, last).size:
            raise UserError(
                f'{self._where("period_s")}: no harmonic of {1.0 / period_s:g} Hz lies between '
                f'{first:g} and {last:g} Hz'
            )
        return trajectories.multisine(
            times,
            self.start_s,
            self._required('amplitude'),
            period_s,
            first,
            last,
            float(self.motion.get('corner_frequency_hz', 0.0)),
            float(self.motion.get('fade_s', 0.0)),
            None if seed is None else int(seed),
        )

    def _linear_path(self, start: float, end: float) -> LinearPath:
        speed = self._speed()
        if speed is None:
            move_time_s = float(self.motion['move_time_s'])
        else:
            move_time_s = abs(end - start) / speed
        path = trajectories.linear(
            [[start], [end]],
            [move_time_s],
            _acceleration(self._where(), self.motion),
            [self.motor.max_velocity],
            [self.motor.max_acceleration],
        )
        _check_velocity(self._where(), self.motor, float(path.velocities[0, 0]))
        return path

    def _carried_out(self, path: LinearPath, times: Floats, start_s: float) -> Floats:
        _check_end(self._where(), self.experiment, start_s + path.duration_s)
        return path.at(times, start_s)[:, 0]

    def _linear(self, times: Floats) -> Floats:
        path = self._linear_path(0.0, self._required('distance'))
        return self._carried_out(path, times, self.start_s)

    def _constant_velocity(self, times: Floats) -> Floats:
        distance = self._required('distance')
        out = self._linear_path(0.0, distance)
        back = self._linear_path(distance, 0.0)
        return_s = self.start_s + out.duration_s + self.motion.get('dwell_s', 0.0)
        _check_end(self._where(), self.experiment, return_s + back.duration_s)
        there = out.at(times, self.start_s)[:, 0]
        return there + back.at(times, return_s)[:, 0] - distance

    def _jog(self, times: Floats) -> Floats:
        if 'acceleration_time_s' in self.motion or 's_curve_time_s' in self.motion:
            requested = _acceleration(self._where(), self.motion)
        else:
            requested = self.motor.jog_acceleration(self._where())
        path = trajectories.jog(
            0.0,
            self._required('distance'),
            self._speed() or self.motor.jog_speed,
            requested,
            self.motor.max_jog_acceleration,
        )
        _check_velocity(self._where(), self.motor, float(path.velocities[0, 0]))
        return self._carried_out(path, times, self.start_s)

    def _rapid(self, times: Floats) -> Floats:
        path = trajectories.jog(
            0.0,
            self._required('distance'),
            self.motor.max_velocity,
            self.motor.jog_acceleration(self._where()),
            self.motor.max_jog_acceleration,
        )
        _check_velocity(self._where(), self.motor, float(path.velocities[0, 0]))
        return self._carried_out(path, times, self.start_s)


def _check_end(where: str, experiment: Experiment, end_s: float) -> None:
    if end_s > experiment.duration_s + 1e-9:
        raise UserError(
            f'{where}: the motion ends at {end_s:.6g} s, after duration_s = '
            f'{experiment.duration_s:g} s'
        )


class _Program:
    """Statements one after another, as in a motion program: moves of all axes together."""

    def __init__(self, experiment: Experiment, motors: list[_Motor]) -> None:
        self.experiment = experiment
        self.motors = motors
        self.position: Floats = np.zeros(len(motors))
        self.time_s = 0.0

    def run(self, times: Floats, result: Floats) -> None:
        """Fill `result`, shape (cycles, axes), with the commanded positions."""
        statements = list(enumerate(self.experiment.program))
        while statements:
            place, statement = statements[0]
            if 'linear' in statement:
                blended = [statements.pop(0)]
                while statements and self._blends(statements[0][1], blended[0][1]):
                    blended.append(statements.pop(0))
                self._linear(times, result, blended)
                continue
            statements.pop(0)
            if 'rapid' in statement:
                self._rapid(times, result, place, statement)
            else:
                self.time_s += statement['dwell_s']
        _check_end(self._where(len(self.experiment.program) - 1), self.experiment, self.time_s)

    def _where(self, place: int) -> str:
        return self.experiment.document.where(('program', place))

    @staticmethod
    def _blends(statement: Mapping[str, Any], first: Mapping[str, Any]) -> bool:
        """Tell whether a statement blends into the LINEAR moves before it: same TA and TS."""
        times = ('acceleration_time_s', 's_curve_time_s')
        return 'linear' in statement and all(statement.get(t) == first.get(t) for t in times)

    def _target(self, targets: Mapping[str, float], position: Floats) -> Floats:
        """Return the position in counts after a move; axes that are not named stay."""
        target = position.copy()
        for place, motor in enumerate(self.motors):
            for unit in LENGTH_UNITS:
                if f'{motor.axis}_{unit}' in targets:
                    target[place] = motor.counts(targets[f'{motor.axis}_{unit}'], unit)
        return target

    def _linear(
        self, times: Floats, result: Floats, blended: list[tuple[int, Mapping[str, Any]]]
    ) -> None:
        corners = [self.position]
        for _, statement in blended:
            corners.append(self._target(statement['linear'], corners[-1]))
        where = self._where(blended[0][0])
        path = trajectories.linear(
            corners,  # type: ignore[arg-type]
            [statement.get('move_time_s', 0.0) for _, statement in blended],
            _acceleration(where, blended[0][1]),
            [motor.max_velocity for motor in self.motors],
            [motor.max_acceleration for motor in self.motors],
        )
        for place, motor in enumerate(self.motors):
            _check_velocity(where, motor, float(np.max(np.abs(path.velocities[:, place]))))
        self._apply(times, result, path.at(times, self.time_s), slice(None))
        self.position = corners[-1]
        self.time_s += path.duration_s

    def _rapid(
        self, times: Floats, result: Floats, place: int, statement: Mapping[str, Any]
    ) -> None:
        where = self._where(place)
        target = self._target(statement['rapid'], self.position)
        paths = trajectories.rapid(
            self.position,  # type: ignore[arg-type]
            target,  # type: ignore[arg-type]
            [motor.max_velocity for motor in self.motors],
            [motor.jog_acceleration(where) for motor in self.motors],
            [motor.max_jog_acceleration for motor in self.motors],
        )
        for column, (motor, path) in enumerate(zip(self.motors, paths, strict=True)):
            _check_velocity(where, motor, float(path.velocities[0, 0]))
            self._apply(times, result, path.at(times, self.time_s)[:, 0], column)
        self.position = target
        self.time_s += max(path.duration_s for path in paths)

    def _apply(
        self, times: Floats, result: Floats, positions: Floats, columns: int | slice
    ) -> None:
        """Write positions from the present time on; later moves overwrite what follows them."""
        late = times >= self.time_s - 1e-9
        result[late, columns] = positions[late]
