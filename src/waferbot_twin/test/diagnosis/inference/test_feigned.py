# SPDX-License-Identifier: Apache-2.0
"""Which causes noise feigns, one after the other, and which model without a cause that is asked of."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import feigned
from waferbot_twin.diagnosis.inference.instrument import NoiseFree
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

    monkeypatch.setattr(feigned, 'beside_noise', judged)

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
    ('there', 'linear', 'odds', 'asked'),
    [
        # what the command shows, less what the cause costs, and its prior
        (19.0, 30.0, 19.0 - 1.0 - 4.0, ['there']),
        (3.0, 12.0, 12.0 - 1.0 - 4.0, ['there', 'linear']),
        (3.0, -2.0, 3.0 - 1.0 - 4.0, ['there', 'linear']),
        (None, 12.0, 12.0 - 1.0 - 4.0, ['there', 'linear']),
        (None, None, 6.0, ['there', 'linear']),  # the command tells nothing: as by the logs
    ],
)
def test_noise_feigns_what_both_models_without_a_cause_say(
    monkeypatch, there, linear, odds, asked
):
    told = []
    found, ordered = hypothesis('play', 'friction'), hypothesis('friction', 'play')
    monkeypatch.setattr(feigned, 'with_last', lambda problem, found, name: ordered)
    monkeypatch.setattr(feigned, 'replace', lambda more, causes: hypothesis())
    monkeypatch.setattr(feigned, 'others_without', lambda problem, more, names: ())

    def instrumented_gain(problem, more, others, noise_free, giving_way):
        told.append('linear' if giving_way else 'there')
        assert noise_free == ['logs']
        if giving_way:
            assert others == ordered.causes[:1]
            assert giving_way == (ordered.causes[:1], ['of friction'], [['of friction there']])
        return linear if giving_way else there

    monkeypatch.setattr(feigned, 'instrumented_gain', instrumented_gain)
    monkeypatch.setattr(feigned, 'GivingWay', SimpleNamespace(of=lambda problem, *causes: causes))
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
    noise_free = NoiseFree('logs', {'play': 'of play there', 'friction': 'of friction there'})
    assert feigned._log_odds(known, found, 'play', 6.0, [noise_free]) == odds
    assert told == asked
