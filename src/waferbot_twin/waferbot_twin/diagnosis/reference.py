# SPDX-License-Identifier: Apache-2.0
"""
Inverse-dynamics least squares beside a diagnosis: what a colleague gets in ten lines.

Mass or inertia, viscous and Coulomb friction and offset of each axis, without library and simulation
(`identification.least_squares`). A cause has to be better than that, or to say why it differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_twin.diagnosis import notes as said
from waferbot_twin.diagnosis.force_error import force_error
from waferbot_twin.diagnosis.wording import UserUnit
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.least_squares import (
    AxisFit,
    LeastSquares,
    LogError,
    coupled,
    identify_by_least_squares,
)
from waferbot_twin.identification.least_squares_report import as_dict, label_of, remarks, unit_of
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.plain_values import significant, with_prefix

UNTOLD = 'these logs do not tell it'

ROUNDING = 1e-9
"""Of a number that is shown beside others of about 1."""


def reference_of(
    logs: Sequence[MeasuredLog],
    validation: Sequence[MeasuredLog],
    nominal: Variant,
    extended: Variant | None = None,
) -> LeastSquares | None:
    """
    Return the least squares of logs, None where no axis of them can be fitted so.

    With an extended model the errors of both models stand beside those of the coefficients
    (`force_error`).
    """
    found = [
        one
        for axis in nominal.layout.axes
        if (one := _of_axis([_alone(log, axis) for log in logs], validation, nominal, axis))
    ]
    if not found:
        return None
    fits = tuple(
        replace(fit, notes=(*fit.notes, *coupled(fit.axis, logs, nominal)))
        for one in found
        for fit in one.fits
    )
    if extended is not None:
        every = {log.name: log for log in (*logs, *validation)}
        fits = tuple(_beside_models(fit, every, (nominal, extended)) for fit in fits)
    titles = {axis: title for one in found for axis, title in one.titles.items()}
    notes = tuple(dict.fromkeys(note for one in found for note in one.notes))
    return replace(found[0], fits=fits, titles=titles, notes=notes)


def _beside_models(
    fit: AxisFit, logs: Mapping[str, MeasuredLog], models: tuple[Variant, Variant]
) -> AxisFit:
    """Return the least squares of an axis with the errors of the nominal and the extended model."""

    def beside(one: LogError) -> LogError:
        nominal, extended = (force_error(logs[one.log], fit, models[0], two) for two in models)
        if nominal is None or extended is None:
            return one
        return replace(one, of_models=(nominal, extended))

    return replace(
        fit,
        fitted=tuple(beside(one) for one in fit.fitted),
        validation=tuple(beside(one) for one in fit.validation),
    )


def _alone(log: MeasuredLog, axis: str) -> MeasuredLog:
    """Return the signals of one axis."""
    return replace(log, signals=tuple(one for one in log.signals if one.axis == axis))


def _of_axis(
    logs: Sequence[MeasuredLog], validation: Sequence[MeasuredLog], nominal: Variant, axis: str
) -> LeastSquares | None:
    try:
        return identify_by_least_squares(logs, validation, nominal)
    except UserError:
        return None


def reference_rows(
    reference: LeastSquares, nominal: Variant, extended: Variant
) -> list[dict[str, str]]:
    """
    Return one row for each coefficient and for the force at a constant speed: what, value, interval.

    Of the inertia and of that force, which are the same whatever friction is made of, both models' too.
    What a motion does not tell says so.
    """
    rows = []
    for fit in reference.fits:
        axis = {'axis': reference.titles[fit.axis]}
        models = [_of_model(variant, nominal, fit) for variant in (nominal, extended)]
        for place, name in enumerate(fit.estimate.names):
            inertias = [one.inertia for one in models] if name == 'inertia' else [None, None]
            rows.append(axis | _row(fit, place, inertias))
        rows += [
            axis | _at_speed(fit, way, [one.at_speed(way) for one in models])
            for way in (1.0, -1.0)
            if _speed_of(fit) > 0.0
        ]
    return rows


@dataclass(frozen=True)
class _OfModel:
    """Inertia of an axis in a model, and its force at the speed at which it is asked, both ways."""

    inertia: float | None = None
    forwards: float | None = None
    backwards: float | None = None

    def at_speed(self, way: float) -> float | None:
        return self.forwards if way > 0.0 else self.backwards


def _of_model(variant: Variant, nominal: Variant, fit: AxisFit) -> _OfModel:
    """
    Return what a model makes of the axis at home, by inverse dynamics.

    In forces that the nominal model's motor makes of the currents: it is these that were fitted.
    """
    if fit.force_unit != places.force_unit(nominal, fit.axis):
        return _OfModel()
    try:
        dynamics = InverseDynamics(variant.description)
    except UserError:
        return _OfModel()
    column = dynamics.axes.index(fit.axis)
    motion = np.zeros((2, 4, len(dynamics.axes)))
    motion[0, 1:3, column] = _speed_of(fit), -_speed_of(fit)
    motion[1, 3, column] = 1.0
    currents = dynamics.currents(np.zeros_like(motion[0]), motion[0], motion[1])[:, column]
    rest, forwards, backwards, pushed = places.force_per_ampere(nominal, fit.axis) * currents
    return _OfModel(float(pushed - rest), float(forwards), float(backwards))


def _speed_of(fit: AxisFit) -> float:
    """Return half of the highest speed that the logs show a force at, m/s or rad/s; 0 if at none."""
    return 0.5 * float(np.max(np.abs(fit.measured.centre), initial=0.0))


def _at_speed(fit: AxisFit, way: float, models: Sequence[float | None]) -> dict[str, str]:
    """Return the row of the force at a constant speed, forwards (1) or backwards (-1), at zero."""
    found = dict(zip(fit.estimate.names, fit.estimate.value, strict=True))
    speed = way * _speed_of(fit)
    force = found['viscous'] * speed + way * found['coulomb'] + found['offset']
    force += sum(value for name, value in found.items() if name.startswith('cosine'))
    factor, unit = with_prefix(speed, f'{fit.length_unit}/s')
    known = bool(fit.estimate.determined.all())
    shown = _shown_in(float(force), fit.force_unit)
    return {
        'what': f'constant-speed force, {significant(factor * speed, 2)} {unit}',
        'value': _text(float(force), shown) if known else UNTOLD,
        'interval': '',
        'nominal': _text(models[0], shown),
        'extended': _text(models[1], shown),
    }


def _row(fit: AxisFit, place: int, models: Sequence[float | None]) -> dict[str, str]:
    found, name = fit.estimate, fit.estimate.names[place]
    unit = unit_of(name, fit)
    known = bool(found.determined[place])
    value = float(found.value[place])
    shown = _shown_in(value, unit)
    low, high = (significant(shown.of(float(end[place]))) for end in (found.low95, found.high95))
    return {
        'what': label_of(name, fit),
        'value': _text(value, shown) if known else UNTOLD,
        'interval': f'{low} to {high} {shown.unit}' if known else '',
        'nominal': _text(models[0], shown),
        'extended': _text(models[1], shown),
    }


def _shown_in(value: float, unit: str) -> UserUnit:
    """Return the unit of a row: that in which its own value is above 1."""
    return UserUnit(*with_prefix(value, unit))


def _text(value: float | None, shown: UserUnit) -> str:
    """Return a value of a row; what is nothing but rounding beside 1 in its unit is 0."""
    if value is None:
        return ''
    return shown.text(value if abs(shown.of(value)) > ROUNDING else 0.0, 4)


def reference_remarks(reference: LeastSquares) -> list[str]:
    """Return how well the coefficients tell the force of each log, and what to know of them."""
    errors = [
        f'{reference.titles[fit.axis]} in {one.log}'
        f'{"" if one in fit.fitted else " (not used for the fit)"}: '
        f'{significant(100.0 * one.relative, 3)} % of the force is left, RMS {significant(one.rms, 3)} '
        f'{fit.force_unit}{_of_models(one)}'
        for fit in reference.fits
        for one in (*fit.fitted, *fit.validation)
    ]
    return [*errors, *remarks(reference)]


def _of_models(error: LogError) -> str:
    """Return what the nominal and the extended model leave of the force of a log, in words."""
    if error.of_models is None:
        return ''
    nominal, extended = (f'{significant(100.0 * one, 3)} %' for one in error.of_models)
    return f'; the nominal model leaves {nominal}, the extended model {extended}'


def contradictions(reference: LeastSquares, tolerated: float) -> list[str]:
    """
    Return where the extended model tells the forces of a log worse than the nominal one, in words.

    By inverse dynamics, which asks no simulation: a mean square that rises by more than is `tolerated`
    in closed loop, too.
    """
    return [
        said.against_the_forces(reference.titles[fit.axis], one.log, *one.of_models)
        for fit in reference.fits
        for one in (*fit.fitted, *fit.validation)
        if one.of_models and one.of_models[1] ** 2 > (1.0 + tolerated) * one.of_models[0] ** 2
    ]


def reference_dict(reference: LeastSquares | None) -> dict[str, Any] | None:
    """Return the reference as plain values, as `identify --method least-squares --json` has them."""
    return None if reference is None else as_dict(reference)
