# SPDX-License-Identifier: Apache-2.0
"""What a fit has brought to a bound."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation import hypothesis
from waferbot_twin.estimation.hypothesis import Hypothesis, signature
from waferbot_twin.estimation.intervals import on_a_bound
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause


@pytest.mark.parametrize(
    ('name', 'changed', 'held', 'stands_in'),
    [
        ('velocity_strengthening_friction', {}, (), False),
        # as large as it can be
        ('velocity_strengthening_friction', {'rise': 'high'}, (), True),
        # it rises over next to no speed: Coulomb friction by another name
        ('velocity_strengthening_friction', {'speed': 'low'}, (), True),
        ('velocity_strengthening_friction', {'speed': 'high'}, (), True),
        # what was not fitted is where it was put
        ('velocity_strengthening_friction', {'speed': 'low'}, ('speed',), False),
        # without relaxation, as it is where there is nothing of it
        ('presliding', {'relaxation': 'low'}, (), False),
        ('presliding', {'relaxation': 'high'}, (), True),
        ('coulomb_friction', {}, (), False),
    ],
)
def test_a_size_or_a_shape_on_a_bound_stands_in_for_another_cause(name, changed, held, stands_in):
    nominal, effect = Variant.of(load_model('rigid')), find(name)
    parameters = effect.parameters(nominal, 'x_rotate')
    values = {item.name: item.typical for item in parameters}
    for item in parameters:
        if item.name in changed:
            values[item.name] = getattr(item, changed[item.name])
    cause = Cause(effect, 'x_rotate', values, held)
    found = Hypothesis((cause,), {}, {})
    assert on_a_bound(SimpleNamespace(nominal=nominal), found, 0) == stands_in


@pytest.mark.parametrize(
    ('share', 'moment_z', 'stands_in'), [(0.4, 0.0, True), (0.6, 0.0, False), (0.4, 0.2, False)]
)
def test_a_size_on_a_bound_is_that_of_a_cause_if_the_logs_tell_no_other(
    share, moment_z, stands_in
):
    """Of the many numbers of a load: a standard error of `share` of what is on its bound."""
    nominal, effect = Variant.of(load_model('rigid')), find('load')
    parameters = effect.parameters(nominal, 'x_rotate')
    values = {item.name: item.neutral for item in parameters} | {'moment_z': moment_z}
    values['moment_x'] = next(item.low for item in parameters if item.name == 'moment_x')
    friction = Cause(find('coulomb_friction'), 'x_rotate', {'friction': 1.0})
    errors = [9.0, *(share * abs(values['moment_x']) for _ in parameters)]
    covariance = np.diag(np.square(errors))
    found = Hypothesis((friction, Cause(effect, 'x_rotate', values)), {}, {}, covariance)
    problem = SimpleNamespace(nominal=nominal)
    assert on_a_bound(problem, found, -1) == stands_in
    assert not on_a_bound(problem, found, 0)


@pytest.mark.parametrize('least', [0.0, 1.45])
def test_a_slope_beside_what_a_part_can_carry_is_that_on_the_side_where_it_can(monkeypatch, least):
    """A body of 1.5 kg on a bearing for just that; one that cannot be lighter, either, has no slope."""
    effect, nominal = find('wrong_inertia'), Variant.of(load_model('rigid'))
    (item,) = (one for one in effect.parameters(nominal, 'y_linear') if one.name == 'mass')
    cause = Cause(effect, 'y_linear', {'mass': 1.5 * item.typical})

    def apply_all(nominal, causes):
        mass = causes[0].values['mass']
        if not least * item.typical < mass <= 1.5 * item.typical:
            raise UserError('the load lies beyond the last point')
        return mass

    monkeypatch.setattr(hypothesis, 'apply_all', apply_all)
    problem = SimpleNamespace(
        nominal=nominal,
        between=lambda here, there: ('plant',),
        touched=lambda effect, axis: ('plant',),
        residuals=lambda mass, block: [np.array([3.0 * mass, mass**2])],
    )
    found = Hypothesis((cause,), {'plant': problem.residuals(cause.values['mass'], 'plant')}, {})
    if least:
        with pytest.raises(UserError):
            signature(problem, found, (cause,), 0, np.array([0.2 * item.typical]))
        return
    (slopes,) = signature(problem, found, (cause,), 0).values()
    assert slopes[0, 0] == pytest.approx(3.0)
    assert slopes[1, 0] == pytest.approx(3.0 * item.typical, rel=0.2)
    assert slopes[1, 0] < 3.0 * item.typical
