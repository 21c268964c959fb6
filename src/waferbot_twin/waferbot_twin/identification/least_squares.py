# SPDX-License-Identifier: Apache-2.0
"""
Inverse-dynamics least squares on logs: inertia and friction of each axis on its own, and its error.

The method is `estimation.inverse_dynamics`; here logs become stretches of position and force. A log's
force is taken as it is. A current, or a command, becomes a force by the force per ampere of a model;
without one everything is in its own unit: an inertia in A/(m/s2) is one over the acceleration that an
ampere makes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_lockstep.errors import UserError
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.inverse_dynamics import (
    LEAST_SAMPLES,
    NOISE_SHARE,
    Array,
    Estimate,
    Filtered,
    Stretch,
    Terms,
    attenuation,
    cut_off,
    estimate,
    filter_all,
    relative_error,
)
from waferbot_twin.estimation.residual_curves import (
    BinnedMeans,
    PositionSpectrum,
    binned_means,
    position_spectrum,
)
from waferbot_twin.identification.coefficient_names import coefficient_name
from waferbot_twin.logs.alignment import common_skew
from waferbot_twin.logs.kinds import axes_in_order
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.pauses import with_short_pauses
from waferbot_twin.logs.timebase import median_step_s
from waferbot_twin.noise_model.motion_basis import MOVES
from waferbot_twin.plain_values import listed
from waferbot_twin.residuals.from_measured_log import amperes_per_unit, drive_of


@dataclass(frozen=True)
class Options:
    """
    What a user may choose: terms, the cut-off in Hz and the dead zone in m/s or rad/s.

    `None` and 0 leave these two to the method; the flags are those of `Terms`. `orders` are sines
    of the position: per turn on an axis that turns, per m on one that slides. `late_s` is how late the
    drive stands against the position, `None` to find it.
    """

    by_direction: bool = False
    rise: bool = False
    orders: tuple[float, ...] = ()
    cut_off_hz: float | None = None
    dead_zone: float = 0.0
    late_s: float | None = None


@dataclass(frozen=True)
class LogError:
    """
    How well the coefficients tell the force of a log: relative, and in its unit (RMS).

    `of_models` is the relative error of the nominal and of the extended model beside a diagnosis
    (`diagnosis.force_error`).
    """

    log: str
    relative: float
    rms: float
    used_s: float
    of_models: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class AxisFit:
    """
    The least squares of one axis.

    `force_unit` is that of the force, `length_unit` that of the position. `over_speed` and
    `over_position` are what the coefficients leave over; `measured` is, over speed, the force
    without that of inertia, and `line` what they make of it there. `late_s` is how late the drive stood
    against the position, which is taken out; `noise_share` how much of what tells the inertia is noise.
    """

    axis: str
    force_unit: str
    length_unit: str
    drive: str
    estimate: Estimate
    terms: Terms
    cut_off_hz: float
    noise_share: float
    fitted: tuple[LogError, ...]
    validation: tuple[LogError, ...]
    over_speed: BinnedMeans
    over_position: BinnedMeans
    measured: BinnedMeans
    spectrum: PositionSpectrum | None
    late_s: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """
    The least squares of all axes of some logs.

    `titles` are what reports call the axes, `notes` why some of them could not be fitted.
    """

    fits: tuple[AxisFit, ...]
    logs: tuple[str, ...]
    validation: tuple[str, ...]
    titles: Mapping[str, str]
    options: Options = field(default_factory=Options)
    notes: tuple[str, ...] = ()


def identify_by_least_squares(
    logs: Sequence[MeasuredLog],
    validation: Sequence[MeasuredLog],
    variant: Variant | None,
    options: Options | None = None,
) -> LeastSquares:
    """
    Return inertia and friction of every axis that the logs have position and drive of.

    All logs are fitted together; `validation` are those that judge. `variant` gives the force per
    ampere where a log has no force, and says where gravity swings an axis: a sine and a cosine of the
    angle stand for it. Raises `UserError` if no axis can be fitted.
    """
    options = options or Options()
    axes = axes_in_order(axis for log in logs for axis in log.usable_axes())
    fits, complaints = [], []
    for axis in axes:
        try:
            fits.append(_fit(axis, logs, validation, variant, options))
        except UserError as error:
            complaints.append(f'{axis}: {error}')
    if not fits:
        raise UserError('; '.join(complaints) or 'the logs have no axis with position and drive')
    if variant is not None:
        fits = [
            replace(fit, notes=(*fit.notes, *coupled(fit.axis, logs, variant))) for fit in fits
        ]
    return LeastSquares(
        tuple(fits),
        tuple(log.name for log in logs),
        tuple(log.name for log in validation),
        {axis: (USUAL_TITLES if variant is None else variant.titles)[axis] for axis in axes},
        options,
        tuple(complaints),
    )


def _fit(
    axis: str,
    logs: Sequence[MeasuredLog],
    validation: Sequence[MeasuredLog],
    variant: Variant | None,
    options: Options,
) -> AxisFit:
    """Fit one axis; raises `UserError`."""
    mine = [log for log in logs if axis in log.usable_axes()]
    judges = [log for log in validation if axis in log.usable_axes()]
    cycle = math.inf if variant is None else places.cycle_of_axis(variant, axis)
    signals = [_signals(log, axis, variant) for log in mine + judges]
    units = {(position.unit, unit) for position, _, unit in signals}
    if len(units) != 1:
        raise UserError(
            f'the logs are in different units: {", ".join(sorted(" and ".join(u) for u in units))}; '
            'give --model, or map the force in all of them'
        )
    ((length_unit, force_unit),) = units
    notes, late_s = [], options.late_s
    if late_s is None:
        found = common_skew([(position, drive) for position, drive, _ in signals], cycle)
        late_s = found.late_s if found is not None and found.significant else 0.0
        if late_s:
            notes.append(
                f'{signals[0][1].name} stands {found} against the position; moved by that '
                '(--late, if not)'
            )
    stretches = [_stretches(position, drive, late_s) for position, drive, _ in signals]
    per_order = 1.0 if length_unit == 'rad' else 2.0 * math.pi
    terms = Terms(
        options.by_direction,
        math.nan if options.rise else None,
        tuple(per_order * order for order in _orders(axis, variant, options)),
    )
    own = [one for part in stretches[: len(mine)] for one in part]
    if not own:
        raise UserError(f'no {LEAST_SAMPLES} samples of position and drive without a gap')
    coefficients, terms, cut_off_hz = estimate(own, terms, options.cut_off_hz, options.dead_zone)
    share = attenuation(own, cut_off_hz, coefficients)
    if share > 2.0 * NOISE_SHARE:
        notes.append(
            f'{100.0 * share:.0f} % of what the acceleration tells of the inertia is noise of the '
            'position: it is too small by about as much; give logs that accelerate more'
        )
    errors, parts = [], []
    for log, part in zip(mine + judges, stretches, strict=True):
        try:
            filtered = filter_all(part, cut_off_hz, terms, options.dead_zone)
        except UserError as error:
            notes.append(f'{log.name}: {error}')
            continue
        errors.append(_error(log.name, filtered, coefficients))
        if log in mine:
            parts += filtered
    fitted_names = {log.name for log in mine}
    residual, speed, position, without_inertia = _left_over(parts, coefficients)
    notes += _doubts(coefficients, length_unit, terms)
    return AxisFit(
        axis, force_unit, length_unit, signals[0][1].kind, coefficients, terms, cut_off_hz, share,
        tuple(one for one in errors if one.log in fitted_names),
        tuple(one for one in errors if one.log not in fitted_names),
        binned_means(speed, residual),
        binned_means(position, residual),
        binned_means(speed, without_inertia),
        _spectrum(own, coefficients, terms, options),
        late_s,
        tuple(notes),
    )  # fmt: skip


def coupled(axis: str, logs: Sequence[MeasuredLog], variant: Variant) -> list[str]:
    """Return that other axes move as well, if the mechanism couples them with an axis."""
    carried = places.carried_axes(variant)
    others = [
        other
        for other in variant.layout.axes
        if other != axis and (axis in carried or other in carried)
        if any(
            (signal := log.get(other, 'position')) is not None
            and float(np.ptp(signal.value)) > MOVES * signal.resolution
            for log in logs
        )
    ]
    if not others:
        return []
    verb = 'moves' if len(others) == 1 else 'move'
    return [
        f'{listed(others)} {verb} as well: what that does here is left over, as each axis is by itself'
    ]


def _orders(axis: str, variant: Variant | None, options: Options) -> tuple[float, ...]:
    """Return the sines of an axis: those asked for, and that of gravity where it swings the axis."""
    of_gravity = () if variant is None or not places.swings(variant, axis) else (1.0,)
    return tuple(dict.fromkeys((*options.orders, *of_gravity)))


def _spectrum(
    stretches: Sequence[Stretch], coefficients: Estimate, terms: Terms, options: Options
) -> PositionSpectrum | None:
    """
    Return the spectrum over position of what is left over, up to the highest cut-off that noise allows.

    What a rigid axis cannot follow, and coefficients are better not asked of, still shows there.
    """
    widest_hz = options.cut_off_hz or cut_off(stretches)
    parts = filter_all(stretches, widest_hz, terms, options.dead_zone)
    residual, speed, position, _ = _left_over(parts, coefficients)
    return position_spectrum(position, residual, speed, widest_hz)


def _signals(log: MeasuredLog, axis: str, variant: Variant | None) -> tuple[Signal, Signal, str]:
    """
    Return position, drive and the unit of the force; the drive is a force where it can be.

    Without long pauses.
    """
    position = log[axis, 'position']
    drive = log.get(axis, 'force') or drive_of(log, axis)
    assert drive is not None
    step_s = max(median_step_s(signal.time_s) for signal in (position, drive))
    (position, drive), _ = with_short_pauses((position, drive), step_s)
    if drive.kind == 'force':
        return position, drive, drive.unit
    if variant is None or axis not in places.motor_axes(variant):
        return position, drive, drive.unit
    factor = amperes_per_unit(variant, drive) * places.force_per_ampere(variant, axis)
    return position, replace(drive, value=drive.value * factor), places.force_unit(variant, axis)


def stretches_of(
    log: MeasuredLog, axis: str, variant: Variant | None, late_s: float
) -> list[Stretch]:
    """Return position and force of an axis of a log; the drive stands in it so late, s."""
    position, drive, _ = _signals(log, axis, variant)
    return _stretches(position, drive, late_s)


def _stretches(position: Signal, drive: Signal, late_s: float) -> list[Stretch]:
    """Return position and drive at even times, where both are known; `late_s` is that of the drive."""
    step_s = max(median_step_s(signal.time_s) for signal in (position, drive))
    begin_s = max(position.time_s[0], drive.time_s[0] - late_s)
    end_s = min(position.time_s[-1], drive.time_s[-1] - late_s)
    # From one of the samples on, so that an even log is not interpolated.
    begin_s = float(position.time_s[np.searchsorted(position.time_s, begin_s)])
    time_s = begin_s + step_s * np.arange(
        max(0, math.floor((end_s - begin_s) / step_s + 1e-6) + 1)
    )
    (where, known), (force, driven) = position.at(time_s), drive.at(time_s + late_s)
    usable = known & driven
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]])))
    return [
        Stretch(step_s, where[first:last], force[first:last], position.resolution)
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if last - first >= LEAST_SAMPLES
    ]


def _error(name: str, parts: Sequence[Filtered], coefficients: Estimate) -> LogError:
    """Return how well coefficients tell the force of a log."""
    residual, force, used_s = [], [], 0.0
    for part in parts:
        left = part.force - coefficients.of(part.columns)
        residual.append(left[part.moving])
        force.append(part.force[part.moving])
        used_s += float(part.moving.sum()) * part.step_s
    left, all_of = np.concatenate(residual), np.concatenate(force)
    rms = float(np.sqrt(np.mean(left**2))) if len(left) else math.nan
    return LogError(name, relative_error(all_of, left), rms, used_s)


def _left_over(
    parts: Sequence[Filtered], coefficients: Estimate
) -> tuple[Array, Array, Array, Array]:
    """Return residual, speed, position and the force without that of inertia, of what moves."""
    mass = coefficients.value[coefficients.names.index('inertia')]
    rows = [
        np.stack(
            [
                part.force - coefficients.of(part.columns),
                part.speed,
                part.position,
                part.force - mass * part.columns['inertia'],
            ]
        )[:, part.moving]
        for part in parts
    ]
    residual, speed, position, force = np.concatenate(rows, axis=1)
    return residual, speed, position, force


def _doubts(coefficients: Estimate, length_unit: str, terms: Terms) -> list[str]:
    """Return what the reader of the values must know."""
    names = {
        name: coefficient_name(name, length_unit, terms.wave_numbers)
        for name in coefficients.names
    }
    left_open = [
        names[name]
        for name, known in zip(coefficients.names, coefficients.determined, strict=True)
        if not known
    ]
    notes = []
    if left_open:
        notes.append(
            f'the motion in these logs does not tell {listed(left_open)} apart: left open; give logs '
            'that move both ways, at several speeds and with acceleration'
        )
    for name in ('inertia', 'viscous', 'coulomb'):
        if name in coefficients.names:
            place = coefficients.names.index(name)
            if coefficients.high95[place] < 0.0:
                notes.append(
                    f'{names[name]} is negative, which it cannot be: the model lacks something, '
                    'or the sign of the drive is wrong'
                )
    return notes
