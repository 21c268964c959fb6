# SPDX-License-Identifier: Apache-2.0
"""Which of the fitted causes is taken, and what values a fit may give it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.confirmation import Fitted
from waferbot_twin.diagnosis.fitting import _widths, moved
from waferbot_twin.diagnosis.problem import Cause
from waferbot_twin.diagnosis.search import Search, _take_best
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model


def hypothesis(cause, log_likelihood, parameters):
    return SimpleNamespace(
        causes=(cause,),
        log_likelihood=log_likelihood,
        parameters=parameters,
        information_criterion=7.0 * parameters - 2.0 * log_likelihood,
    )


@pytest.mark.parametrize(('confirms', 'taken'), [(100.0, 'wide'), (55.0, 'simple')])
def test_a_cause_with_more_parameters_is_taken_if_the_other_logs_pay_for_them(confirms, taken):
    nothing = hypothesis(SimpleNamespace(name='nothing'), 0.0, 0)
    state = Search(nothing, nothing, nothing, nothing)
    fitted = [
        Fitted(
            hypothesis(SimpleNamespace(name=name, held=()), 100.0, parameters),
            hypothesis(None, judged, parameters),
            True,
        )
        for name, parameters, judged in (('simple', 1, 50.0), ('wide', 4, confirms))
    ]
    assert _take_best(None, None, state, fitted)
    assert state.found.causes[0].name == taken


@pytest.mark.parametrize(
    ('name', 'shape'),
    [
        ('stribeck_friction', 'speed'),
        ('cold_ferrofluid', 'time_constant'),
        ('presliding', 'distance'),
        ('position_dependent_friction', 'cosine'),
        ('position_dependent_friction', 'sine'),
    ],
)
def test_a_fit_can_move_a_shape_from_where_it_is_typical(name, shape):
    nominal = Variant.of(load_model('rigid'))
    cause = Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
    (item,) = (item for item in cause.effect.parameters(nominal, 'x_rotate') if item.name == shape)
    (width,) = _widths([cause], [(0, item)])
    assert width > 0.05 * (cause.values[shape] or item.high)


def test_settings_that_are_whole_numbers_stay_so():
    nominal = Variant.of(load_model('rigid'))
    causes = (
        Cause(find('wrong_bias'), 'x_rotate', {'difference': 0.0}),
        Cause(find('wrong_derivative_gain'), 'x_rotate', {'ratio': 1.0}),
        Cause(find('coulomb_friction'), 'x_rotate', {'friction': 0.0}),
    )
    names = [
        (place, item)
        for place, cause in enumerate(causes)
        for item in cause.effect.parameters(nominal, cause.axis)
    ]
    bias, derivative, friction = moved(causes, names, np.array([-3199.52, 0.0002, 0.123]))
    assert bias.values == {'difference': -3200.0}
    assert derivative.values == {'ratio': 1.0}
    assert friction.values == {'friction': 0.123}
