# SPDX-License-Identifier: Apache-2.0
"""Which causes noise feigns, one after the other, and which model without a cause that is asked of."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import feigned
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds


def hypothesis(*names):
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=name) for name in names))


def effect(name, odds=9.0):
    member = Member(hypothesis(name), 0.0, 0.0, 1.0)
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

    def without(problem, found, gone, workers, known):
        assert sorted(known) == ['friction', 'lag', 'play']
        return hypothesis(*(cause.name for cause in found.causes if cause.name not in gone))

    monkeypatch.setattr(feigned, 'without', without)
    pool = SimpleNamespace(
        problem=None,
        settings=Settings(),
        workers=1,
        signatures_of=lambda found: [{} for _ in found.causes],
    )
    every = [effect('friction'), effect('lag'), effect('play')]
    found, left, gone = feigned.without_feigned(pool, hypothesis('friction', 'lag', 'play'), every)
    assert gone == ['play']
    assert [cause.name for cause in found.causes] == ['friction', 'lag']
    # More may be found now, and all are judged again: so they are as sure as before.
    assert [one.log_odds for one in left] == pytest.approx([9.0, 9.0])
    again, left, gone = feigned.without_feigned(pool, found, left)
    assert again is found
    assert gone == []
    assert [one.log_odds for one in left] == pytest.approx([5.0, 4.0])


@pytest.mark.parametrize(
    ('gained', 'odds'),
    [
        (9.0, 9.0 - 1.0 - 4.0),  # what the command shows, less what the cause costs, and its prior
        (None, 6.0),  # the command tells nothing: as by the logs
    ],
)
def test_a_cause_is_asked_beside_the_others_of_the_hypothesis(monkeypatch, gained, odds):
    asked = []
    play, friction = (SimpleNamespace(name=name) for name in ('play', 'friction'))
    found = Member(SimpleNamespace(causes=(play, friction)), 0.0, 0.0).found
    monkeypatch.setattr(
        feigned,
        'with_last',
        lambda problem, found, name: SimpleNamespace(causes=(friction, play)),
    )
    monkeypatch.setattr(feigned, 'replace', lambda more, causes: SimpleNamespace(causes=causes))

    def instrumented_gain(problem, more, of_others, noise_free, there):
        asked.append((more.causes[-1].name, of_others, there))
        return gained

    monkeypatch.setattr(feigned, 'instrumented_gain', instrumented_gain)
    monkeypatch.setattr(
        feigned, 'log_evidence', lambda problem, more, base, scales, gained: gained - 1.0
    )
    monkeypatch.setattr(
        feigned, 'log_odds_beside_noise', lambda by_logs, by_command, prior: by_command
    )
    known = SimpleNamespace(
        problem=None,
        settings=Settings(),
        log_prior=lambda cause: -4.0,
        signatures_of=lambda found: ['of play', 'of friction'],
    )
    there = ['of play there', 'of friction there']
    assert feigned._log_odds(known, found, 'play', 6.0, None, there) == odds
    assert asked == [('play', ['of friction'], ['of friction there'])]
