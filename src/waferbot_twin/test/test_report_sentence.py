# SPDX-License-Identifier: Apache-2.0
"""The sentence in which a diagnosis ends: what it gains is said as large as it is."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.diagnose import FoundCause
from waferbot_twin.diagnosis.report import sentence
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause


@pytest.fixture(scope='module')
def friction():
    effect = find('coulomb_friction')
    parameters = effect.parameters(Variant.of(load_model('rigid')), 'x_rotate')
    cause = Cause(effect, 'x_rotate', {'friction': 0.5})
    return FoundCause(cause, parameters, {'friction': (0.49, 0.51)}, 100.0, 1.0, ())


@pytest.mark.parametrize(
    ('percent', 'said'),
    [
        ({'y_linear': 0.1, 'x_rotate': 42.0}, 'falls by 42.0 % on X-Rotate'),
        ({'y_linear': 0.1, 'x_rotate': -0.8}, 'hardly shows it (best: +0.1 % on Y-Linear)'),
        ({'x_rotate': -0.8}, 'hardly shows it (best: -0.8 % on X-Rotate)'),
    ],
)
def test_a_gain_that_is_no_argument_is_not_said_as_one(friction, percent, said):
    gains = [SimpleNamespace(axis=axis, improvement_percent=one) for axis, one in percent.items()]
    diagnosis = SimpleNamespace(
        causes=[friction], gains=gains, unexplained_where=[], unexplained=[]
    )
    told = sentence(diagnosis)
    assert told.startswith('The machine has coulomb_friction on X-Rotate (')
    assert said in told
    assert 'Unexplained' not in told


def test_without_causes_and_without_anything_left_nothing_is_wrong():
    diagnosis = SimpleNamespace(causes=[], gains=[], unexplained_where=[], unexplained=[])
    assert sentence(diagnosis).startswith('Nothing significant is wrong')
