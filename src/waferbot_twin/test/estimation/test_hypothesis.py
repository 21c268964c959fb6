# SPDX-License-Identifier: Apache-2.0
"""What a fit has brought to a bound."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import on_a_bound
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
    assert on_a_bound(SimpleNamespace(nominal=nominal), cause) == stands_in
