# SPDX-License-Identifier: Apache-2.0
"""Causes whose names say more than the logs tell."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.diagnosis.left_over import LeftOver
from waferbot_twin.diagnosis.undetermined import undetermined
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause, Problem


@pytest.fixture(scope='module')
def problem():
    return Problem(Variant.of(load_model('rigid')), [])


def cogging(problem, **values):
    effect = find('cogging')
    return Cause(effect, 'x_rotate', effect.complete(problem.nominal, 'x_rotate', values))


def with_errors(causes, errors):
    return Hypothesis(tuple(causes), {}, {}, np.diag(np.square(errors)))


def test_harmonics_that_could_each_be_nothing_are_in_doubt(problem):
    cause = cogging(problem, cosine_1=0.02, sine_1=-0.35, sine_2=0.28, sine_3=-0.07)
    free = cause.free
    (found,) = undetermined(problem, with_errors([cause], [0.3] * free))
    assert found.cause == cause
    assert 'each of its 6 parts by itself could be nothing' in str(found)
    assert 'cogging:x_rotate' in str(found)
    rest = LeftOver(doubts=[found])
    assert rest.axes == ['x_rotate']
    assert rest.in_doubt(cause, problem)
    other = Cause(find('viscous_friction'), 'x_rotate', {'damping': 1.0})
    assert not rest.in_doubt(other, problem)


def test_one_part_that_the_logs_tell_is_enough(problem):
    cause = cogging(problem, sine_1=-0.35, sine_2=0.28)
    errors = np.full(cause.free, 0.3)
    errors[1] = 0.17  # 2.06 standard errors
    assert undetermined(problem, with_errors([cause], errors)) == []
    errors[1] = 0.19  # 1.84
    assert len(undetermined(problem, with_errors([cause], errors))) == 1


def test_what_has_one_part_only_or_no_known_errors_is_not_asked(problem):
    friction = Cause(find('viscous_friction'), 'x_rotate', {'damping': 0.1})
    assert undetermined(problem, with_errors([friction], [1.0])) == []
    cause = cogging(problem, sine_1=0.1)
    assert undetermined(problem, with_errors([cause], [])) == []
    assert undetermined(problem, with_errors([cause], [0.0] * cause.free)) == []


def test_a_drag_is_known_to_fade_where_its_time_constant_is_told(problem):
    effect = find('cold_ferrofluid')
    cause = Cause(effect, 'x_rotate', {'drag': 1.0, 'time_constant': 2.0})
    assert undetermined(problem, with_errors([cause], [0.1, 1.0])) == []
    for error in (1.1, 100.0, 0.0):  # 0: it changes nothing in these logs
        (found,) = undetermined(problem, with_errors([cause], [0.1, error]))
        assert 'not that it fades away (time constant 2 s)' in str(found)
