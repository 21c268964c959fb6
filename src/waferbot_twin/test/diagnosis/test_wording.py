# SPDX-License-Identifier: Apache-2.0
"""The first sentence of a report: short, and its probability is said as it is."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.diagnosis.diagnose import Alternative, FoundCause
from waferbot_twin.diagnosis.inference.unexplained import Unexplained
from waferbot_twin.diagnosis.parameters import parameter_texts
from waferbot_twin.diagnosis.wording import LONGEST_SENTENCE, in_words, instead, sentence, size
from waferbot_twin.effects import find, library
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.validation.gain import AxisGain

LEFT_OVER = [
    Unexplained(axis, 'plant', 0.1, 'its speed') for axis in ('y_linear', 'x_rotate', 'y_rotate')
]


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


@pytest.fixture(scope='module')
def every_cause(nominal):
    return [
        Cause(effect, axis, effect.typical(nominal, axis))
        for effect in library().values()
        for axis in effect.axes(nominal)
    ]


def found(nominal, cause, probability=0.87, share=0.42, others=(), unnamed=0.0):
    parameters = cause.effect.parameters(nominal, cause.axis)
    members = (Alternative(cause, probability), *(Alternative(other, 0.1) for other in others))
    return FoundCause(cause, parameters, {}, 1.0, probability, members, 10.0, share, unnamed)


def diagnosis(nominal, causes, unexplained=(), possible=(), corrections=(), gains=()):
    return SimpleNamespace(
        nominal=nominal, causes=causes, unexplained=list(unexplained), possible=list(possible),
        corrections=list(corrections), accelerations=[], gains=list(gains),
    )  # fmt: skip


def gain(axis, before, after):
    errors = [np.full(4, error) for error in (before, after)]
    return AxisGain('log', axis, 'rad', np.arange(4.0), np.zeros(4), *errors, True, 0.0)


def friction(value=1.5):
    return Cause(find('coulomb_friction'), 'x_rotate', {'friction': value})


@pytest.mark.parametrize('number', [1, 2, 12])
@pytest.mark.parametrize('unexplained', [[], LEFT_OVER], ids=['nothing_left', 'three_axes_left'])
def test_is_short_whatever_is_found(nominal, every_cause, number, unexplained):
    for place, cause in enumerate(every_cause):
        others = every_cause[place - 3 : place]
        causes = [found(nominal, cause, 0.7, 0.42, others)] * number
        told = sentence(diagnosis(nominal, causes, unexplained))
        assert len(told.split()) <= LONGEST_SENTENCE, told
        assert told.startswith(cause.effect.title[0].upper() + cause.effect.title[1:])
        assert '42 % of the error' in told
        assert 'probability 0.70' in told
        assert ('unexplained' in told) == bool(unexplained)


@pytest.mark.parametrize('unexplained', [[], LEFT_OVER], ids=['nothing_left', 'three_axes_left'])
def test_what_is_possible_is_said_where_nothing_is_named(nominal, every_cause, unexplained):
    for cause in every_cause:
        told = sentence(diagnosis(nominal, [], unexplained, [found(nominal, cause, 0.76)]))
        assert len(told.split()) <= LONGEST_SENTENCE, told
        assert told.startswith(('The model explains', 'No known cause'))
        assert told.endswith(' is possible (probability 0.76).')


def test_says_what_where_how_large_and_how_sure(nominal):
    told = sentence(diagnosis(nominal, [found(nominal, friction(), 0.87, 0.42)]))
    assert re.fullmatch(
        r'Coulomb friction on X-Rotate \(1\.5 Nm, \d+ % of rated torque\) explains 42 % of the error '
        r'there, likely \(probability 0\.87\)\.',
        told,
    )


@pytest.mark.parametrize(
    ('errors', 'said'),
    [
        ({'x_rotate': (2.0, 0.5)}, 'in validation data 25 % of the RMS error is left.'),
        ({'x_rotate': (2.0, 0.5), 'y_linear': (1.0, 0.8)}, '25 to 80 % of the RMS error is left.'),
        ({'x_rotate': (2.0, 0.008)}, 'less than 1 % of the RMS error is left.'),
        (
            {'x_rotate': (2.0, 0.5), 'y_rotate': (1.0, 1.5)},
            '25 to 150 % of the RMS error is left.',
        ),
    ],
)
def test_says_how_much_of_the_error_is_left(nominal, errors, said):
    """That of the axis with the most, too: an axis with a large gain hides none with a small one."""
    gains = [gain(axis, *both) for axis, both in errors.items()]
    told = sentence(diagnosis(nominal, [found(nominal, friction())], gains=gains))
    assert told.endswith(said)
    several = [found(nominal, friction())] * 3
    told = sentence(diagnosis(nominal, several, LEFT_OVER[:1], gains=gains))
    assert said[:-1] in told
    assert told.endswith('unexplained.')


@pytest.mark.parametrize(
    ('named', 'possible', 'said'),
    [
        (1, 0, ''),
        (2, 0, '; 1 more named'),
        (1, 2, '; 2 more possible'),
        (4, 1, '; 3 more named, 1 possible'),
    ],
)
def test_counts_what_has_a_name_and_what_is_only_possible(nominal, named, possible, said):
    causes, others = ([found(nominal, friction(), 0.97)] * number for number in (named, possible))
    assert sentence(diagnosis(nominal, causes, possible=others)).endswith(
        f'beyond doubt (probability 0.97){said}.'
    )


def test_a_size_above_100_percent_has_no_exponent(nominal):
    told = sentence(diagnosis(nominal, [found(nominal, friction(300.0))]))
    assert re.search(r'\(300 Nm, \d{4,} % of rated torque\)', told)


def test_a_size_on_its_bound_or_not_told_is_not_said(nominal):
    cause = found(nominal, friction())
    told = replace(cause, intervals_95={'friction': (-2.0, 5.0)})
    assert 'X-Rotate (its size is not told by these logs) explains' in sentence(
        diagnosis(nominal, [told])
    )


@pytest.mark.parametrize(
    ('probability', 'said'),
    [
        (1.0, 'beyond doubt (probability above 0.99)'),
        (0.95, 'beyond doubt (probability 0.95)'),
        (0.9, 'likely (probability 0.90)'),
        (0.8, 'likely (probability 0.80)'),
        (0.62, 'perhaps (probability 0.62)'),
        (0.001, 'perhaps (probability below 0.01)'),
    ],
)
def test_a_probability_is_said_as_it_is(nominal, probability, said):
    assert said in sentence(diagnosis(nominal, [found(nominal, friction(), probability)]))


def test_one_that_may_be_another_says_which(nominal):
    other = Cause(find('stribeck_friction'), 'x_rotate', {'breakaway': 1.0, 'speed': 0.01})
    doubtful = sentence(diagnosis(nominal, [found(nominal, friction(), 0.6, 0.4, [other])]))
    assert 'else Stribeck friction on X-Rotate' in doubtful
    sure = sentence(diagnosis(nominal, [found(nominal, friction(), 0.96, 0.4, [other])]))
    assert 'Stribeck' not in sure
    nameless = found(nominal, friction(), 0.5, 0.4, [other], unnamed=0.4)
    assert instead(nominal, nameless)[0] == ('something without a known cause', 0.4)
    assert 'else something without a known cause' in sentence(diagnosis(nominal, [nameless]))


def test_without_causes_the_model_explains_the_logs_or_nothing_does(nominal):
    assert sentence(diagnosis(nominal, [])).startswith('The model explains these logs')
    mass = Correction('mass of carriage', 'bodies.carriage.mass_kg', 'kg', 40.0, 38.0, 37.0, 39.0)
    told = sentence(diagnosis(nominal, [], corrections=[mass]))
    assert told.startswith('With small corrections the model explains these logs')
    told = sentence(diagnosis(nominal, [], corrections=[replace(mass, high=41.0)]))
    assert told.startswith('The model explains these logs')
    told = sentence(diagnosis(nominal, [], LEFT_OVER[:1]))
    assert told.startswith('No known cause explains these logs')
    assert 'Y-Linear' in told


def test_no_unit_is_one_of_the_controllers_own(nominal, every_cause):
    for cause in every_cause:
        rows = parameter_texts(nominal, found(nominal, cause))
        told = ' '.join([size(nominal, cause), *(f'{row.value} {row.interval}' for row in rows)])
        assert not re.search(r'\b(counts?|cycles|bits|interrupts)\b', told), told


@pytest.mark.parametrize(
    ('effect', 'axis', 'values', 'said'),
    [
        ('force_constant', 'y_linear', {'ratio': 0.95}, '5 % below the model'),
        ('cogging', 'y_linear', {'cosine_1': 3.0, 'sine_1': -4.0}, 'amplitude 5 N'),
        ('command_delay', 'y_linear', {'delay': 0.25}, '250 µs'),
        ('wrong_bias', 'y_linear', {'difference': -12.0}, 'Ixx29 -12'),
        ('constant_force', 'y_linear', {'force': -4.4}, '-4.4 N'),
    ],
)
def test_sizes_in_the_users_units(nominal, effect, axis, values, said):
    one = find(effect)
    neutral = {item.name: item.neutral for item in one.parameters(nominal, axis)}
    assert said in in_words(nominal, Cause(one, axis, {**neutral, **values}))
