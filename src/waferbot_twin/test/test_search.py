# SPDX-License-Identifier: Apache-2.0
"""Which of the fitted causes is taken."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.confirmation import Fitted
from waferbot_twin.diagnosis.search import Search, _take_best


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
