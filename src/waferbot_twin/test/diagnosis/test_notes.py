# SPDX-License-Identifier: Apache-2.0
"""Notes are in plain words: no names of code, of causes or of axes."""

from __future__ import annotations

import pytest

from waferbot_twin.diagnosis import notes
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause

RIGID = Variant.of(load_model('rigid'))
PULL = Cause(find('constant_force'), 'x_rotate', {'force': 1.0})


def test_a_value_that_changed_is_said_in_words():
    said = notes.not_what_it_was('time_constant of amplifier filter on X-Rotate', 'day 1', 4.21)
    assert said.startswith(
        'time constant of amplifier filter on X-Rotate is not what it was (day 1)'
    )
    assert '4.2 standard errors' in said


@pytest.mark.parametrize('said', [notes.refuted(RIGID, PULL), notes.worse_with(RIGID, PULL)])
def test_what_was_withdrawn_is_said_as_an_engineer_says_it(said):
    assert said.startswith('constant force on X-Rotate was withdrawn: ')
    assert ':x_rotate' not in said


def test_what_does_the_same_is_said_by_its_titles():
    said = notes.stands_for(
        RIGID, 'direction_dependent_friction', 'y_linear', ['coulomb_friction', 'constant_force']
    )
    assert said.endswith(
        'on Y-Linear: Coulomb friction and constant force together stand for it, too'
    )
    assert '_' not in said
