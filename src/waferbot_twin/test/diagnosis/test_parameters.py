# SPDX-License-Identifier: Apache-2.0
"""Parameters of causes in the user's units: amplitudes, ways in mm and turns, no names of code."""

from __future__ import annotations

import math
import re

import pytest

from waferbot_twin.diagnosis.diagnose import Alternative, FoundCause
from waferbot_twin.diagnosis.parameters import parameter_texts
from waferbot_twin.diagnosis.wording import way_text
from waferbot_twin.effects import find, library, places
from waferbot_twin.effects.cogging import with_orders
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.problem import Cause


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def found(nominal, effect, axis, values, intervals=None, held=()):
    cause = Cause(effect, axis, {**effect.typical(nominal, axis), **values}, held)
    parameters = effect.parameters(nominal, axis)
    return FoundCause(
        cause, parameters, intervals or {}, 1.0, 0.9, (Alternative(cause, 0.9),), 9.0, 0.5
    )


def rows(nominal, cause):
    return {row.label: row for row in parameter_texts(nominal, cause)}


def test_a_cosine_and_a_sine_are_one_amplitude(nominal):
    cause = found(
        nominal, find('transmission_error'), 'y_rotate', {'cosine': 3e-4, 'sine': -4e-4},
        {'cosine': (2e-4, 4e-4), 'sine': (-5e-4, -3e-4)},
    )  # fmt: skip
    row = rows(nominal, cause)['amplitude']
    assert row.value == '500 µrad'
    assert row.interval == '400 to 600 µrad'


def test_cogging_says_how_often_a_turn(nominal):
    motor = Variant.of(load_model_or_machine('direct_drive_motor'))
    effect = with_orders({'x_rotate': (7, 28)})
    cause = found(motor, effect, 'x_rotate', {'cosine_7': 0.03, 'sine_7': 0.04})
    told = rows(motor, cause)
    assert told['amplitude of order 7'].value == '50 mNm'
    assert told['repeats after'].value == '0.1429 turns (7 a turn)'


def test_cogging_of_a_linear_motor_says_how_many_mm(nominal):
    effect = find('cogging')
    cause = found(nominal, effect, 'y_linear', {'order': 2.0}, held=('order',))
    told = rows(nominal, cause)
    pole_mm = 1e3 * places.electrical_cycle(nominal, 'y_linear') / 2.0
    assert float(told['repeats after'].value.removesuffix(' mm')) == pytest.approx(
        pole_mm, rel=1e-3
    )
    assert told['repeats after'].interval == 'chosen from a few'
    assert 'order' not in told


def test_an_interval_of_an_order_is_one_of_the_way(nominal):
    effect = find('cogging')
    cause = found(nominal, effect, 'y_linear', {'order': 2.0}, {'order': (1.6, 2.5)})
    told = rows(nominal, cause)['repeats after']
    low, high = (float(end.removesuffix(' mm')) for end in told.interval.split(' to '))
    value = float(told.value.removesuffix(' mm'))
    assert (low, high) == pytest.approx((value * 2.0 / 2.5, value * 2.0 / 1.6), rel=1e-3)


@pytest.mark.parametrize(
    ('way', 'unit', 'said'),
    [
        (2.5e-3, 'm', '2.5 mm'),
        (4e-5, 'm', '40 µm'),
        (2.0 * math.pi, 'rad', '1 turn'),
        (2.0 * math.pi / 72.0, 'rad', '0.01389 turns (72 a turn)'),
        (6.0 * math.pi, 'rad', '3 turns'),
    ],
)
def test_ways_are_in_mm_or_turns(way, unit, said):
    assert way_text(way, unit) == said


def test_no_parameter_has_a_name_of_the_code(nominal):
    for effect in library().values():
        for axis in effect.axes(nominal):
            for row in parameter_texts(nominal, found(nominal, effect, axis, {})):
                told = f'{row.label} {row.meaning} {row.value} {row.interval}'
                assert not re.search(r'_|\bcycles?\b|\bcounts?\b(?! )|/cycle', told.replace(
                    'electrical cycle', ''
                )), told  # fmt: skip
