# SPDX-License-Identifier: Apache-2.0
"""Which models have a say in what a value may be."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import model_average
from waferbot_twin.diagnosis.inference.model_average import open_models, rivals_of
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect


def model(*names):
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=name) for name in names))


def single(*members):
    """Return an effect: each member with its probability, and the names of the causes beside it."""
    found = [Member(model(*others, name), 0.0, 0.0, p) for name, p, others in members]
    return SingleEffect(tuple(found), 0.0)


def names_of(models):
    return [[cause.name for cause in one.causes] for one in models]


def pool(**values):
    own = {'asked_beside': {}, 'rivals': [], 'problem': None, **values}
    return SimpleNamespace(settings=Settings(), **own)


@pytest.fixture(autouse=True)
def as_fitted(monkeypatch):
    monkeypatch.setattr(model_average, 'with_usual_spread', lambda problem, found: found)


def test_members_of_a_set_have_a_say_where_they_were_fitted_beside_the_same_causes():
    found = model('friction', 'gain')
    effects = [
        single(('friction', 0.6, ['gain']), ('drag', 0.38, ['gain']), ('rare', 0.02, ['gain'])),
        single(('gain', 0.6, ['friction']), ('inertia', 0.4, ['offset'])),
    ]
    assert names_of(open_models(pool(), found, effects)) == [['gain', 'drag']]


def test_what_was_not_more_probable_than_not_has_a_say():
    found, there = model('friction', 'gain'), frozenset({'friction', 'gain'})
    more = single(('offset', 0.3, ['friction', 'gain']))
    also = single(('offset', 0.3, ['friction', 'gain', 'gone']))
    fewer = single(('offset', 0.3, ['friction']))
    for asked, said in (
        ({there: more}, [['friction', 'gain', 'offset']]),
        ({there | {'gone'}: also}, [['friction', 'gain', 'gone', 'offset']]),
        ({frozenset({'friction'}): fewer, there: None}, []),
    ):
        assert names_of(open_models(pool(asked_beside=asked), found, [])) == said
    other = model('inertia')
    assert open_models(pool(rivals=[other]), found, []) == (other,)


@pytest.mark.parametrize(('log_odds', 'has'), [(2.0, True), (-2.9, True), (-3.0, False)])
def test_what_is_less_probable_than_one_in_twenty_has_no_say(monkeypatch, log_odds, has):
    monkeypatch.setattr(model_average, 'log_odds_between', lambda pool, one, found: log_odds)
    found, other = model('gain'), model('inertia')
    rivals = rivals_of(pool(), found, [other, model('gain')])
    assert [one.log_odds for one in rivals] == [log_odds] * has
    assert not rivals_of(pool(), found, [other], refuted=['inertia'])


def test_of_the_same_causes_the_more_probable_values_have_a_say(monkeypatch):
    monkeypatch.setattr(model_average, 'log_odds_between', lambda pool, one, found: one.odds)
    two = [model('inertia'), model('inertia')]
    for one, odds in zip(two, (-2.0, -1.0), strict=True):
        one.odds = odds
    for order in (two, two[::-1]):
        (rival,) = rivals_of(pool(), model('gain'), order)
        assert rival.log_odds == -1.0
