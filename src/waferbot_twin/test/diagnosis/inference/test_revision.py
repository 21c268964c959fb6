# SPDX-License-Identifier: Apache-2.0
"""How often each effect is asked for anew."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import revision
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect


def hypothesis(*names):
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=name) for name in names))


def test_beside_the_same_others_an_effect_is_asked_for_once(monkeypatch):
    """The second becomes another one: the first is asked for again, the third was asked beside it."""
    told = []

    def effect_of(found):
        return SingleEffect((Member(found, 9.0, 0.0, 1.0),), 1e-3)

    def posterior(pool, base, rivals, present):
        name = present.causes[-1].name
        told.append(name)
        return effect_of(hypothesis('another') if name == 'second' else present)

    monkeypatch.setattr(revision, 'is_discrepancy', lambda cause: False)

    def with_last(problem, found, name):
        names = sorted((cause.name for cause in found.causes), key=lambda one: one == name)
        return hypothesis(*names)

    def fitted_on(pool, found, causes, beside):
        return hypothesis('first', 'third', 'another')

    monkeypatch.setattr(revision, 'with_last', with_last)
    monkeypatch.setattr(revision, 'without_by_linear', lambda problem, present, name: None)
    monkeypatch.setattr(revision, 'posterior_beside', posterior)
    monkeypatch.setattr(revision, 'fitted_together', fitted_on)
    monkeypatch.setattr(revision, 'evident', lambda pool, found, effects: (found, list(effects)))
    pool = SimpleNamespace(
        problem=None, in_place_of=lambda present: ['a rival'], revised=set(), settings=Settings()
    )
    names = ('first', 'second', 'third')
    effects = [effect_of(hypothesis(name)) for name in names]
    found, left, asked = revision.ask_again(pool, hypothesis(*names), effects, 24)
    assert told == ['first', 'second', 'third', 'first']
    assert {one.best.cause.name for one in left} == {'first', 'another', 'third'}
    assert asked == 4
    assert revision.ask_again(pool, found, left, 24) == (found, left, 0)


@pytest.mark.parametrize(('rivals', 'left'), [([], ['friction']), (None, ['friction', 'drag'])])
def test_what_no_other_candidate_can_do_any_more_is_that_cause_alone(monkeypatch, rivals, left):
    """Unless the machine does not stand without it: then nobody knows."""
    monkeypatch.setattr(revision, 'with_last', lambda problem, found, name: found)
    pool = SimpleNamespace(problem=None, in_place_of=lambda present: rivals, revised=set())
    members = [
        Member(hypothesis(name), 1.0, 0.0, p) for name, p in (('friction', 0.5), ('drag', 0.4))
    ]
    both = [
        SingleEffect(tuple(members), 0.1),
        SingleEffect((Member(hypothesis('gain'), 9.0, 0.0, 1.0),), 1e-3),
    ]
    _, effects, asked = revision.ask_again(pool, hypothesis('friction', 'gain'), both, 24)
    assert [one.cause.name for one in effects[0].members] == left
    assert effects[0].inclusion == pytest.approx(0.9)
    assert asked == 0
    assert len(both[0].members) == 2


@pytest.mark.parametrize(
    ('ahead', 'probability', 'best'),
    [
        ('force_over_velocity', 0.39, 'rise'),
        ('force_over_velocity', 0.04, 'force_over_velocity'),
        ('drag', 0.39, 'drag'),
    ],
)
def test_a_force_without_a_name_takes_no_place_of_what_may_be_it(
    monkeypatch, ahead, probability, best
):
    monkeypatch.setattr(
        revision, 'is_discrepancy', lambda cause: cause.name == 'force_over_velocity'
    )
    members = [
        Member(hypothesis(name), 9.0, 0.0, p)
        for name, p in ((ahead, 1.0 - probability), ('rise', probability))
    ]
    effect = SingleEffect(tuple(members), 0.0)
    judged = revision._not_without_a_name(effect, 'rise', Settings())
    assert judged.best.cause.name == best
    assert sorted(map(id, judged.members)) == sorted(map(id, effect.members))
