# SPDX-License-Identifier: Apache-2.0
"""Causes that are said to repeat, in logs that go some way or none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_twin.diagnosis.proposals.repetition import can_repeat, repeats_in
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.effects import find, library
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Record

TICKS = 8000
GEAR = 48.0


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log_of(nominal, travel):
    """Return a log in which encoders go there and back again, each as far as `travel` says (m, rad)."""
    timing = Timing()
    rows = np.linspace(0.0, 2.0 * math.pi, TICKS // timing.encoder_divider)
    reading = np.full((len(rows), len(ENCODERS)), np.nan)
    for name, far in travel.items():
        counts = far * nominal.description.encoders[name].counts_per_unit
        reading[:, ENCODERS.index(name)] = np.round(0.5 * counts * (1.0 - np.cos(rows)))
    return Record('log', timing, np.zeros((TICKS, 2 * len(AXES))), reading, None, None)


def problem_of(nominal, *travels):
    return Problem(nominal, [log_of(nominal, travel) for travel in travels])


@pytest.mark.parametrize(
    ('name', 'axis', 'period', 'values'),
    [
        ('encoder_eccentricity', 'x_rotate', math.pi, {'period': math.pi}),
        ('motor_encoder_eccentricity', 'y_rotate', 2.0 * math.pi / GEAR, {}),
        ('transmission_error', 'y_rotate', math.pi / GEAR, {'order': 2.0}),
        ('cogging', 'y_linear', 0.032 / 6.0, {'order': 6.0}),  # 32 mm from magnet pair to pair
        ('cogging', 'x_rotate', 2.0 * math.pi / 22.0, {'order': 2.0}),  # 11 pairs of poles
        ('torque_ripple', 'y_rotate', 2.0 * math.pi / 4.0 / 6.0 / GEAR, {}),  # 4 pairs
        ('position_dependent_friction', 'y_linear', 0.06, {'period': 0.06}),
    ],
)
def test_effects_say_after_which_way_they_repeat(nominal, name, axis, period, values):
    effect = find(name)
    found = effect.repeats_after(nominal, axis, effect.complete(nominal, axis, values))
    assert found == pytest.approx(period)


def test_each_effect_with_a_period_says_so(nominal):
    for effect in library().values():
        for axis in effect.axes(nominal):
            names = {item.name for item in effect.parameters(nominal, axis)}
            if names & {'period', 'order'}:
                assert effect.repeats_after(nominal, axis, effect.typical(nominal, axis)) > 0.0


def test_what_does_not_repeat_is_possible_where_an_axis_stands(nominal):
    standing = problem_of(nominal, {'y_linear': 0.0})
    for name in ('viscous_friction', 'encoder_scale'):
        effect = find(name)
        cause = Cause(effect, 'y_linear', effect.typical(nominal, 'y_linear'))
        assert can_repeat(standing, cause)


def test_an_axis_of_which_only_the_motor_is_measured_goes_as_far_as_that(nominal):
    effect = find('torque_ripple')
    cause = Cause(effect, 'y_rotate', effect.typical(nominal, 'y_rotate'))
    goes, stands = (problem_of(nominal, {'y_rotate_motor': way}) for way in (0.1, 0.0))
    assert can_repeat(goes, cause)
    assert not can_repeat(stands, cause)


def test_no_cause_that_repeats_is_tried_where_an_axis_stands(nominal):
    """It hunts on two counts here; any other cause is tried."""
    effects = [find(name) for name in ('cogging', 'torque_ripple', 'constant_force')]
    per_unit = nominal.description.encoders['y_linear'].counts_per_unit

    def tried(counts):
        problem = problem_of(nominal, {'y_linear': counts / per_unit})
        return {
            item.effect.name for item in candidates(problem, effects) if item.axis == 'y_linear'
        }

    assert tried(1.0) == {'constant_force'}
    assert tried(400.0) == {'cogging', 'torque_ripple', 'constant_force'}


@pytest.mark.parametrize(
    ('name', 'values', 'held', 'longest'),
    [
        ('encoder_eccentricity', {'period': 0.5}, (), 0.5),
        ('encoder_eccentricity', {'period': 0.5}, ('period',), 0.0),
        ('cogging', {'order': 2.0}, (), 2.0 * math.pi / 22.0),
        ('position_dependent_friction', {'period': 0.5}, (), 0.5),
        ('coulomb_friction', {}, (), 0.0),
    ],
)
def test_a_period_that_is_fitted_is_covered_by_a_log(nominal, name, values, held, longest):
    effect = find(name)
    cause = Cause(effect, 'x_rotate', effect.complete(nominal, 'x_rotate', values), held)
    short, long = 0.9 * longest or 0.01, 1.1 * longest or 0.02
    for travels, covered in (((short, short), longest == 0.0), ((short, long), True)):
        problem = problem_of(nominal, *({'x_rotate': travel} for travel in travels))
        assert repeats_in(problem, cause) == covered


@pytest.mark.parametrize(('poles', 'orders'), [({'pole_pairs': 1}, {1.0, 2.0, 6.0}), ({}, set())])
def test_no_order_of_poles_is_tried_that_nobody_described(poles, orders):
    """Nothing says then how many teeth a motor has; what logs show is another candidate."""
    machine = dict(Variant.of(load_model_or_machine('locked_cycloidal_drive')).machine)
    motor = {**machine['motors']['x_rotate'], **poles}
    known = Variant('motor', {**machine, 'motors': {'x_rotate': motor}}, 'improved', {}, {})
    effect = find('cogging')
    tried = {
        one.values['order'] for one in candidates(problem_of(known, {'x_rotate': 20.0}), [effect])
    }
    assert tried == orders


@pytest.mark.parametrize('length', [0.06, 0.2])
def test_a_period_that_others_have_is_covered_by_a_log(nominal, length):
    """Screws of a rail 60 mm apart are usual, and in no description."""
    effect = find('position_dependent_friction')
    values = effect.complete(nominal, 'y_linear', {'period': length})
    cause = Cause(effect, 'y_linear', values, ('period',))
    for travel, told in ((0.9 * length, False), (1.1 * length, True)):
        problem = problem_of(nominal, {'y_linear': travel})
        assert repeats_in(problem, cause) == told
        tried = {
            one.values['period'] for one in candidates(problem, [effect]) if one.axis == 'y_linear'
        }
        assert (length in tried) == told
