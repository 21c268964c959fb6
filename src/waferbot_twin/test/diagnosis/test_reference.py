# SPDX-License-Identifier: Apache-2.0
"""Least squares beside a diagnosis: right on a pendulum of known inertia and weight."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from waferbot_twin.diagnosis.reference import (
    contradictions,
    reference_of,
    reference_remarks,
    reference_rows,
)
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.residual_curves import BinnedMeans
from waferbot_twin.identification import least_squares_report
from waferbot_twin.identification.least_squares import identify_by_least_squares
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.problem import Cause, apply_all

INERTIA, WEIGHT_NM, FRICTION_NM = 0.2, 3.3, 0.3


@pytest.fixture(scope='module')
def pendulum():
    return Variant.of(load_model_or_machine('geared_pendulum'))


def log(name, phase):
    """Return a log of a pendulum that swings in two sines, by its equation of motion."""
    time_s = np.arange(0.0, 10.0, 1e-3)
    wave, size = np.array([2.0, 5.3]), np.array([0.8, 0.3])
    angles = np.outer(time_s, wave) + phase
    position, speed = np.sin(angles) @ size, np.cos(angles) @ (size * wave)
    acceleration = -np.sin(angles) @ (size * wave**2)
    torque = INERTIA * acceleration + WEIGHT_NM * np.sin(position) + FRICTION_NM * np.sign(speed)
    return MeasuredLog(
        name,
        (
            Signal('position', 'y_rotate', 'rad', time_s, position, 1e-6),
            Signal('force', 'y_rotate', 'Nm', time_s, torque),
        ),
    )


def si(text):
    """Return the number of a text with its unit, which may be in thousandths."""
    number, unit = text.split(maxsplit=1)
    return float(number) * (1e-3 if unit.startswith('m') else 1.0)


def test_where_gravity_swings_the_axis_a_sine_stands_for_it(pendulum):
    reference = reference_of([log('one', 0.2)], [log('two', 1.0)], pendulum)
    heavier = apply_all(pendulum, [Cause(find('wrong_inertia'), 'y_rotate', {'inertia': 0.02})])
    rows = {row['what']: row for row in reference_rows(reference, pendulum, heavier)}
    assert si(rows['inertia']['value']) == pytest.approx(INERTIA, rel=0.01)
    assert si(rows['Coulomb friction']['value']) == pytest.approx(FRICTION_NM, rel=0.05)
    assert si(rows['sine, 1 per turn']['value']) == pytest.approx(WEIGHT_NM, rel=0.01)
    rubbing = apply_all(
        pendulum, [Cause(find('coulomb_friction'), 'y_rotate', {'friction': FRICTION_NM})]
    )
    rows_of_it = reference_rows(reference, pendulum, rubbing)
    forces = [row for row in rows_of_it if row['what'].startswith('constant-speed force')]
    for row, way in zip(forces, (1.0, -1.0), strict=True):
        assert si(row['value']) == pytest.approx(way * FRICTION_NM, rel=0.1)
        assert si(row['extended']) == pytest.approx(way * FRICTION_NM, rel=1e-3)
        assert si(row['nominal']) == pytest.approx(0.0, abs=1e-9)
    nominal, extended = (si(rows['inertia'][key]) for key in ('nominal', 'extended'))
    assert nominal == pytest.approx(places.moving_inertia(pendulum, 'y_rotate'), rel=1e-3)
    assert extended == pytest.approx(nominal + 0.02, rel=1e-3)
    assert all(row['axis'] == 'Pendulum' for row in rows.values())


def test_each_of_several_axes_has_its_rows_under_its_own_name():
    arm = Variant.of(load_model_or_machine('planar_two_link_arm'))
    axes = ('x_rotate', 'y_rotate')
    signals = [
        replace(signal, axis=axis, value=factor * signal.value)
        for axis, factor in zip(axes, (1.0, 0.5), strict=True)
        for signal in log('one', 0.2).signals
    ]
    reference = reference_of([MeasuredLog('both', tuple(signals))], [], arm, arm)
    rows = reference_rows(reference, arm, arm)
    assert {row['axis'] for row in rows} == {arm.titles[axis] for axis in axes}
    assert {line.split(' in ')[0] for line in reference_remarks(reference)[:2]} == {
        arm.titles[axis] for axis in axes
    }


def test_where_another_axis_moves_least_squares_say_that_it_is_left_over():
    arm = Variant.of(load_model_or_machine('planar_two_link_arm'))
    both = [
        replace(signal, axis=axis)
        for axis in ('x_rotate', 'y_rotate')
        for signal in log('one', 0.2).signals
    ]
    stands = [
        replace(signal, value=np.zeros_like(signal.value))
        if (signal.axis, signal.kind) == ('y_rotate', 'position')
        else signal
        for signal in both
    ]
    fits = identify_by_least_squares([MeasuredLog('both', tuple(both))], [], arm).fits
    assert all(any('moves as well' in note for note in fit.notes) for fit in fits)
    alone = identify_by_least_squares([MeasuredLog('one', tuple(stands))], [], arm).fits
    assert not any('moves as well' in note for note in alone[0].notes)


def test_the_report_calls_the_axis_as_the_machine_does(pendulum):
    logs, judges = [log('one', 0.2)], [log('two', 1.0)]
    # The model says that gravity swings its axis: a sine and a cosine more.
    for variant, title, count in ((pendulum, 'Pendulum', 6), (None, 'Y-Rotate', 4)):
        found = identify_by_least_squares(logs, judges, variant)
        assert [row[0] for row in least_squares_report.table_rows(found)] == [title] * count
        said = least_squares_report.errors_in_words(found) + least_squares_report.remarks(found)
        assert all(line.startswith(title) for line in said)
        assert f'<h2>{title}: what is left over</h2>' in least_squares_report.page(found)
        assert list(least_squares_report.as_dict(found)['axes']) == ['y_rotate']


def test_it_is_judged_in_logs_that_were_not_fitted(pendulum):
    reference = reference_of([log('one', 0.2)], [log('two', 1.0)], pendulum)
    assert all(one.of_models is None for fit in reference.fits for one in fit.fitted)
    beside_models = reference_of([log('one', 0.2)], [log('two', 1.0)], pendulum, pendulum)
    (fit,) = beside_models.fits
    for one in (*fit.fitted, *fit.validation):
        assert one.of_models is not None
        assert one.of_models[0] == one.of_models[1] > one.relative
    own, other, *_ = reference_remarks(reference)
    assert own.startswith('Pendulum in one: ')
    assert other.startswith('Pendulum in two (not used for the fit): ')


def test_an_extended_model_that_the_forces_speak_against_is_told(pendulum):
    def with_friction(friction_nm):
        cause = Cause(find('coulomb_friction'), 'y_rotate', {'friction': friction_nm})
        extended = apply_all(pendulum, [cause])
        return reference_of([log('one', 0.2)], [log('two', 1.0)], pendulum, extended)

    for friction_nm in (0.0, FRICTION_NM):
        assert contradictions(with_friction(friction_nm), 0.02) == []
    said = contradictions(with_friction(10.0 * FRICTION_NM), 0.02)
    assert [line.startswith('the forces of Pendulum in ') for line in said] == [True, True]
    assert all(' %' in line and 'e+' not in line for line in said)


def test_where_no_speed_came_often_enough_there_is_no_force_at_one(pendulum):
    reference = reference_of([log('one', 0.2)], [], pendulum)
    (fit,) = reference.fits
    empty = replace(fit, measured=BinnedMeans(*(np.zeros(0) for _ in fields(BinnedMeans))))
    rows = reference_rows(replace(reference, fits=(empty,)), pendulum, pendulum)
    told = [row['what'] for row in rows]
    assert 'inertia' in told
    assert not any(what.startswith('constant-speed force') for what in told)


def test_an_axis_about_the_vertical_and_a_slide_need_no_sine():
    rigid = Variant.of(load_model('rigid'))
    time_s = np.arange(0.0, 10.0, 1e-3)
    wave, size = np.array([2.0, 5.3]), np.array([0.1, 0.03])
    angles = np.outer(time_s, wave)
    slide = MeasuredLog(
        'slide',
        (
            Signal('position', 'y_linear', 'm', time_s, np.sin(angles) @ size, 1e-7),
            Signal('force', 'y_linear', 'N', time_s, -50.0 * np.sin(angles) @ (size * wave**2)),
        ),
    )
    reference = reference_of([slide], [], rigid)
    assert not any(
        row['what'].startswith('sine') for row in reference_rows(reference, rigid, rigid)
    )


def test_where_nothing_can_be_fitted_there_is_no_reference(pendulum):
    assert reference_of([MeasuredLog('empty', ())], [], pendulum) is None
