# SPDX-License-Identifier: Apache-2.0
"""A value on a bound, and one that the logs do not tell, is no finding; intervals end at bounds."""

from __future__ import annotations

import math

import pytest

from waferbot_twin.diagnosis.diagnose import Alternative, FoundCause
from waferbot_twin.diagnosis.findings import (
    AT_BOUND,
    NOT_TOLD,
    amplitude,
    no_findings,
    remark_of,
    within_bounds,
)
from waferbot_twin.diagnosis.parameters import parameter_texts
from waferbot_twin.diagnosis.wording import in_words
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def found(nominal, name, values, intervals, held=()):
    effect, axis = find(name.split(':')[0]), name.split(':')[1]
    cause = Cause(effect, axis, {**effect.typical(nominal, axis), **values}, held)
    parameters = effect.parameters(nominal, axis)
    return FoundCause(cause, parameters, intervals, 1.0, 0.9, (Alternative(cause, 0.9),), 9.0, 0.5)


def item(cause, name):
    return next(one for one in cause.parameters if one.name == name)


def test_an_interval_ends_where_what_is_possible_ends(nominal):
    cause = found(
        nominal, 'coulomb_friction:x_rotate', {'friction': 1.0}, {'friction': (-0.5, 2.5)}
    )
    assert within_bounds(cause, item(cause, 'friction')) == (0.0, 2.5)
    (row,) = parameter_texts(nominal, cause)
    assert row.interval == '0 to 2.5 Nm'


@pytest.mark.parametrize(
    ('value', 'interval', 'remark'),
    [
        (1.0, (0.5, 1.5), ''),
        (1.0, (0.1, 1.9), ''),
        (1.0, (-0.5, 2.5), NOT_TOLD),
        (230.4, (230.0, 231.0), AT_BOUND),
        (0.0, (-1.0, 1.0), AT_BOUND),
    ],
)
def test_a_size_counts_from_where_there_is_nothing(nominal, value, interval, remark):
    cause = found(
        nominal, 'coulomb_friction:x_rotate', {'friction': value}, {'friction': interval}
    )
    bound = item(cause, 'friction').high
    if value > 100.0:
        cause.cause.values['friction'] = bound
    assert remark_of(cause, item(cause, 'friction')) == remark
    assert no_findings(cause) == ({'friction'} if remark else frozenset())


def test_a_ratio_counts_from_one(nominal):
    for ratio, interval, remark in ((0.95, (0.94, 0.96), ''), (0.95, (0.85, 1.05), NOT_TOLD)):
        cause = found(nominal, 'force_constant:y_linear', {'ratio': ratio}, {'ratio': interval})
        assert remark_of(cause, item(cause, 'ratio')) == remark


def test_what_is_no_finding_is_not_said_in_the_name_of_the_cause(nominal):
    cause = found(
        nominal, 'gear_efficiency:y_rotate', {'driving': 0.1, 'back_driving': 0.3},
        {'driving': (0.08, 0.12), 'back_driving': (-0.2, 0.8)},
    )  # fmt: skip
    assert no_findings(cause) == {'back_driving'}
    told = in_words(nominal, cause.cause, no_findings(cause))
    assert '10 %' in told
    assert '30 %' not in told
    rows = {row.label: row for row in parameter_texts(nominal, cause)}
    assert rows['back driving'].remark == NOT_TOLD
    assert not rows['driving'].remark


def test_a_cosine_that_happens_to_be_small_is_told_by_its_amplitude(nominal):
    """c = 0.1 +- 0.5 and s = 4 +- 0.5 of a wave: its amplitude is known to an eighth."""
    cause = found(
        nominal, 'encoder_eccentricity:y_rotate', {'cosine': 1e-4, 'sine': 4e-3, 'period': 2 * math.pi},
        {'cosine': (-4e-4, 6e-4), 'sine': (3.5e-3, 4.5e-3)}, ('period',),
    )  # fmt: skip
    assert not no_findings(cause)
    size, reach = amplitude(cause, item(cause, 'cosine'), item(cause, 'sine'))
    assert size == pytest.approx(4.00125e-3)
    assert reach == pytest.approx(5e-4, rel=0.01)


def test_what_was_chosen_from_a_few_lies_on_no_bound(nominal):
    order = next(
        one for one in find('cogging').parameters(nominal, 'y_rotate') if one.name == 'order'
    )
    cause = found(nominal, 'cogging:y_rotate', {'order': order.high}, {}, ('order',))
    assert remark_of(cause, item(cause, 'order')) == ''
