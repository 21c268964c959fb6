# SPDX-License-Identifier: Apache-2.0
"""Which causes noise feigns, one after the other, and which model without a cause that is asked of."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference import feigned
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds


def effect(name, odds=9.0):
    member = Member(SimpleNamespace(causes=(SimpleNamespace(name=name),)), 0.0, 0.0, 1.0)
    return with_odds(SingleEffect((member,), 0.0), odds)


def names(effects):
    return [one.best.cause.name for one in effects]


def test_the_least_evident_goes_first_and_the_others_are_judged_without_it(monkeypatch):
    # What `play` feigned made `lag` look feigned, too; beside nothing of it, `lag` is plain.
    by_command = {
        ('friction', 'lag', 'play'): [5.0, -1.0, -3.0],
        ('friction', 'lag'): [5.0, 4.0],
    }

    def judged(pool, found, effects):
        odds = by_command[tuple(names(effects))]
        return [with_odds(one, value) for one, value in zip(effects, odds, strict=True)]

    monkeypatch.setattr(feigned, '_judged', judged)
    monkeypatch.setattr(
        feigned, 'without', lambda problem, found, gone, workers: tuple(set(found) - set(gone))
    )
    pool = SimpleNamespace(problem=None, settings=Settings(), workers=1)
    every = [effect('friction'), effect('lag'), effect('play')]
    found, left, gone = feigned.without_feigned(pool, ('friction', 'lag', 'play'), every)
    assert gone == ['play']
    assert set(found) == {'friction', 'lag'}
    # More may be found now, and all are judged again: so they are as sure as before.
    assert [one.log_odds for one in left] == pytest.approx([9.0, 9.0])
    again, left, gone = feigned.without_feigned(pool, found, left)
    assert again is found
    assert gone == []
    assert [one.log_odds for one in left] == pytest.approx([5.0, 4.0])


@pytest.mark.parametrize(
    ('linear', 'fitted', 'odds'),
    [
        (8.0, None, 8.0),  # plain without a fit
        (-2.0, 7.0, 7.0),  # the linear problem was wrong of the others
        (-2.0, -4.0, -4.0),  # it was right
        (UserError('blew up'), 3.0, 3.0),
        (None, None, 6.0),  # the command tells nothing: as by the logs
        (-2.0, UserError('blew up'), 6.0),
    ],
)
def test_a_model_without_a_cause_is_fitted_where_the_linear_problem_would_take_the_name_away(
    monkeypatch, linear, fitted, odds
):
    def given(answer):
        if isinstance(answer, UserError):
            raise answer
        return answer

    asked = []
    more = SimpleNamespace(causes=(SimpleNamespace(name='friction'), SimpleNamespace(name='play')))
    monkeypatch.setattr(feigned, 'with_last', lambda problem, found, name: more)
    monkeypatch.setattr(feigned, 'without_by_linear', lambda problem, more, name: given(linear))

    def without(problem, more, gone, workers, signatures):
        asked.append(sorted(signatures))
        return given(fitted)

    monkeypatch.setattr(feigned, 'without', without)
    monkeypatch.setattr(feigned, 'instrumented_gain', lambda problem, base, more, noise_free: base)
    monkeypatch.setattr(
        feigned, 'log_evidence', lambda problem, more, base, scales, gained: gained
    )
    monkeypatch.setattr(
        feigned, 'log_odds_beside_noise', lambda by_logs, by_command, prior: by_command
    )
    known = SimpleNamespace(
        problem=None,
        settings=Settings(),
        workers=1,
        log_prior=lambda cause: 0.0,
        signatures_of=lambda found: [{}, {}],
    )
    assert feigned._log_odds(known, more, 'play', 6.0, None) == odds
    assert asked == ([] if linear == 8.0 else [['friction', 'play']])
