# SPDX-License-Identifier: Apache-2.0
"""
Inverse-dynamics least squares beside a diagnosis: what a colleague gets in ten lines.

Mass or inertia, viscous and Coulomb friction and offset of each axis, without library and simulation
(`identification.least_squares`). A cause has to be better than that, or to say why it differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.identification.least_squares import (
    AxisFit,
    LeastSquares,
    Options,
    identify_by_least_squares,
)
from waferbot_twin.identification.least_squares_report import as_dict, label_of, remarks, unit_of
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.plain_values import significant
from waferbot_twin.plot import TITLES


def reference_of(
    logs: Sequence[MeasuredLog], validation: Sequence[MeasuredLog], nominal: Variant
) -> LeastSquares | None:
    """
    Return the least squares of logs, None where no axis of them can be fitted so.

    Where gravity swings an axis, a sine and a cosine of the angle stand for it.
    """
    found = [
        one
        for axis in AXES
        if (one := _of_axis([_alone(log, axis) for log in logs], validation, nominal, axis))
    ]
    if not found:
        return None
    return replace(found[0], fits=tuple(fit for one in found for fit in one.fits))


def _alone(log: MeasuredLog, axis: str) -> MeasuredLog:
    """Return the signals of one axis."""
    return replace(log, signals=tuple(one for one in log.signals if one.axis == axis))


def _of_axis(
    logs: Sequence[MeasuredLog], validation: Sequence[MeasuredLog], nominal: Variant, axis: str
) -> LeastSquares | None:
    options = Options(orders=(1.0,) if _swings(nominal, axis) else ())
    try:
        return identify_by_least_squares(logs, validation, nominal, options)
    except UserError:
        return None


def _swings(nominal: Variant, axis: str) -> bool:
    """Return whether gravity has a torque on an axis that changes with its angle."""
    if axis not in places.jointed_axes(nominal) or not places.rotary(nominal, axis):
        return False
    joint, direction = places.joint_of(nominal, axis), places.direction_of(nominal, axis)
    assert joint is not None
    bodies = [nominal.description.bodies[name] for name in places.carried_bodies(nominal, axis)]
    moment = sum(body.mass * (body.centre_of_gravity - joint.at) for body in bodies)
    gravity = nominal.description.gravity
    return bool(
        np.linalg.norm(np.cross(direction, moment)) * np.linalg.norm(np.cross(direction, gravity))
        > 0.0
    )


def reference_rows(
    reference: LeastSquares, nominal: Variant, extended: Variant
) -> list[dict[str, str]]:
    """
    Return one row for each coefficient: axis, what, value and interval; of the inertia both models'.

    What a motion does not tell says so.
    """
    return [
        _row(fit, place, nominal, extended)
        for fit in reference.fits
        for place in range(len(fit.estimate.names))
    ]


def _row(fit: AxisFit, place: int, nominal: Variant, extended: Variant) -> dict[str, str]:
    found, name = fit.estimate, fit.estimate.names[place]
    unit = unit_of(name, fit)
    value, interval = f'{significant(float(found.value[place]))} {unit}', ''
    if found.determined[place]:
        ends = (significant(float(end)) for end in (found.low95[place], found.high95[place]))
        interval = f'{" to ".join(ends)} {unit}'
    else:
        value = 'these logs do not tell it'
    known = name == 'inertia' and fit.force_unit == places.force_unit(nominal, fit.axis)
    return {
        'axis': TITLES[fit.axis],
        'what': label_of(name, fit),
        'value': value,
        'interval': interval,
        'nominal': _inertia(nominal, fit, unit) if known else '',
        'extended': _inertia(extended, fit, unit) if known else '',
    }


def _inertia(variant: Variant, fit: AxisFit, unit: str) -> str:
    own = replace(variant, origin=None)  # with all that was laid over it
    return f'{significant(places.moving_inertia(own, fit.axis))} {unit}'


def reference_remarks(reference: LeastSquares) -> list[str]:
    """Return how well the coefficients tell the force of each log, and what to know of them."""
    errors = [
        f'{TITLES[fit.axis]} in {one.log}{"" if one in fit.fitted else " (not used for the fit)"}: '
        f'{100.0 * one.relative:.3g} % of the force is left, RMS {significant(one.rms, 3)} '
        f'{fit.force_unit}'
        for fit in reference.fits
        for one in (*fit.fitted, *fit.validation)
    ]
    return [*errors, *remarks(reference)]


def reference_dict(reference: LeastSquares | None) -> dict[str, Any] | None:
    """Return the reference as plain values, as `identify --method least-squares --json` has them."""
    return None if reference is None else as_dict(reference)
