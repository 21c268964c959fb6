# SPDX-License-Identifier: Apache-2.0
"""
What an experiment asks of motors, drives, belts, cables and bearings, against what they bear.

The experiment counts as a duty cycle that is repeated for ever, of the duration T. Of each motor, with i
the part of the current that makes force and k its constant, the force that it needs is (RMS, peak)

    F_rms = k sqrt(1/T int i^2 dt),    F_peak = k max |i|.                                         (1)

Its copper loses, R from lead to lead and cold, i_1 to i_3 the currents of the lines,

    P = 1/T int R/2 (i_1^2 + i_2^2 + i_3^2) dt,                                                    (2)

and warm more. In the steady state the windings are as warm as gives that off, R_th to the air:

    theta = air + R_th P (1 + alpha (theta - theta_R)),
    theta = (air + R_th P (1 - alpha theta_R)) / (1 - alpha R_th P),                               (3)

infinite where the denominator is not above zero: copper that warms faster than it cools. Beside it
stands the drive: RMS current over its continuous one, peak over its peak current, I2T accumulator over
its set point, voltage between two terminals over the bus. What springs and cables bear is that of
`waferbot_plant.validity`, each by its greatest share of a limit. Iron losses are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.description import Heating, Motor
from waferbot_plant.motors import force_constant
from waferbot_plant.validity import Extremes
from waferbot_pmac.experiments import Experiment
from waferbot_twin.effects.places import motor_force_unit, motor_rotary
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import Runaway, Signals, Twin
from waferbot_twin.metrics import rms
from waferbot_twin.noise_model.motion_basis import smooth
from waferbot_twin.response import AxisResponse, simulated_responses
from waferbot_twin.validity import Validity

WINDINGS = 'windings, repeated for ever'
"""What equation (3) is called in a row."""


@dataclass(frozen=True)
class Row:
    """
    One amount that a part has to bear.

    `share` is what part of the limit it is, 1 at the limit; NaN where there is no limit to it.
    """

    part: str
    what: str
    value: float
    unit: str
    limit: str
    share: float


@dataclass(frozen=True)
class Duty:
    """
    Speed of an axis and force of its motor over a duty cycle, (n,) each, in `speed_unit` and `unit`.

    `effective` is the RMS force, `continuous` and `peak` what the drive makes for long and for a while.
    """

    axis: str
    speed: np.ndarray
    force: np.ndarray
    speed_unit: str
    unit: str
    effective: float
    continuous: float
    peak: float


@dataclass(frozen=True)
class Sizing:
    """What the parts of a machine bear, and the duty of each of its motors."""

    rows: list[Row]
    duties: list[Duty]


def size(variant: Variant, experiment: Experiment, timing: Timing) -> Sizing:
    """Return what the parts of a model bear in a run; raises `UserError` if it does not end well."""
    model = variant.model()
    twin = Twin.of(model, timing, experiment)
    validity = Validity(model, timing, twin.machine)
    try:
        signals = twin.advance(timing.ticks(experiment.duration_s))
    except Runaway as error:
        raise UserError(f'{experiment.name} on {variant.name}: {error}') from error
    killed = [
        axis
        for axis, off in zip(twin.layout.axes, twin.servo_state['killed'][0], strict=True)
        if off
    ]
    if killed:
        raise UserError(
            f'{experiment.name} on {variant.name}: the motor of {killed[0]} was killed; what parts bear '
            'in such a run says nothing'
        )
    signals.note_validity(validity)
    rows, duties = _of_motors(variant, twin, signals)
    motors = {f'motor {axis}' for axis in twin.layout.axes} | set(twin.layout.axes)
    for found in validity.extremes():
        if found.check.place not in motors or 'I2T' in found.check.what:
            rows.append(_of_part(found))
    return Sizing(rows, duties)


def largest_shares(rows: list[Row]) -> dict[str, float]:
    """Return the largest share of a limit by part."""
    found: dict[str, float] = {}
    for row in rows:
        if math.isfinite(row.share):
            found[row.part] = max(found.get(row.part, -math.inf), row.share)
    return found


def _of_motors(variant: Variant, twin: Twin, signals: Signals) -> tuple[list[Row], list[Duty]]:
    rows: list[Row] = []
    duties: list[Duty] = []
    for place, (axis, response) in enumerate(
        zip(twin.layout.axes, simulated_responses(twin, signals), strict=True)
    ):
        motor = variant.description.motors.get(axis)
        if motor is None:
            continue
        constant = force_constant(motor)
        unit = motor_force_unit(variant, axis)
        word = 'torque' if motor_rotary(variant, axis) else 'force'
        current = response.current
        peak = variant.amplifier_setting(axis, 'peak_current')
        continuous = variant.amplifier_setting(axis, 'continuous_current')
        bus = variant.amplifier_setting(axis, 'bus_voltage')
        loss = copper_loss(motor, signals.line_current[:, 2 * place : 2 * place + 2])
        terminals = signals.voltage[:, 3 * place : 3 * place + 3]
        across = float(np.max(np.ptp(terminals, axis=1)))
        effective, greatest = rms(current), float(np.max(np.abs(current)))
        rows += [
            Row(
                axis, f'RMS {word}', constant * effective, unit,
                f'{constant * continuous:.4g} {unit}, drive continuous', effective / continuous,
            ),
            Row(
                axis, f'peak {word}', constant * greatest, unit,
                f'{constant * peak:.4g} {unit}, drive peak', greatest / peak,
            ),
            Row(axis, 'voltage between terminals', across, 'V', f'{bus:.4g} V, bus', across / bus),
            Row(axis, 'copper loss, cold', loss, 'W', '', math.nan),
        ]  # fmt: skip
        duties.append(
            Duty(
                axis, _speed(response), constant * current, f'{response.unit}/s', unit,
                constant * effective, constant * continuous, constant * peak,
            )
        )  # fmt: skip
        heating = heating_of(variant, axis)
        if heating is not None:
            rows.append(_of_heating(axis, heating, loss))
    return rows, duties


def _speed(response: AxisResponse) -> np.ndarray:
    """Return the speed of an axis at the times of its current (n,), without the steps of its counts."""
    way = smooth(response.position - response.position.mean())
    speed = np.gradient(way, response.encoder_time)
    return np.interp(response.tick_time, response.encoder_time, speed)


def heating_of(variant: Variant, axis: str) -> Heating | None:
    """Return how a motor warms up, also where the model leaves it cold; None where nobody said."""
    entry = variant.machine.get('motors', {}).get(axis, {})
    if not entry.get('heating'):
        return None
    warming = Overlay({'motors': {axis: {'heating': {'state': 'warming'}}}})
    return variant.with_overlay(warming).description.motors[axis].heating


def copper_loss(motor: Motor, lines: np.ndarray) -> float:
    """Return equation (2), W, of two line currents (n, 2) in A."""
    third = -lines.sum(axis=1)
    squares = np.mean(lines[:, 0] ** 2 + lines[:, 1] ** 2 + third**2)
    return 0.5 * motor.resistance * float(squares)


def steady_temperature(heating: Heating, loss: float) -> float:
    """Return equation (3), degC, of a copper loss (W) in windings that are as warm as R is given for."""
    rise = heating.to_air * loss
    left = 1.0 - heating.coefficient * rise
    if left <= 0.0:
        return math.inf
    return (heating.air + rise * (1.0 - heating.coefficient * heating.resistance_at)) / left


def _of_heating(axis: str, heating: Heating, loss: float) -> Row:
    warm = steady_temperature(heating, loss)
    if heating.limit is None:
        return Row(axis, WINDINGS, warm, 'degC', '', math.nan)
    share = (warm - heating.air) / (heating.limit - heating.air)
    return Row(axis, WINDINGS, warm, 'degC', f'{heating.limit:.4g} degC, insulation', share)


def _of_part(found: Extremes) -> Row:
    """Return the worst amount of a check, with the share of its range that it takes."""
    check = found.check
    value = found.worst[0]
    if math.isfinite(check.least) and math.isfinite(check.most):
        # The secant's range of a stiffness: a question of the model, not of what the part bears.
        share = math.nan
    elif math.isfinite(check.most):
        share = value / check.most
    else:
        # From the most tension that it has, to none that is left.
        whole = found.high - check.least
        share = (found.high - found.low) / whole if whole > 0.0 else math.nan
    return Row(check.place, check.what, value, check.unit, check.limits, share)
