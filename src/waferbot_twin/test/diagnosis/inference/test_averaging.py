# SPDX-License-Identifier: Apache-2.0
"""Effects averaged over models, against sums of odds by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import averaging
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds


def model(*names, odds):
    causes = tuple(SimpleNamespace(name=name) for name in names)
    return SimpleNamespace(causes=causes, odds=odds)


def effect(name, log_odds):
    found = SimpleNamespace(causes=(SimpleNamespace(name=name),))
    return with_odds(SingleEffect((Member(found, 0.0, 0.0, 1.0),), 0.0), log_odds)


@pytest.fixture
def pool(monkeypatch):
    monkeypatch.setattr(
        averaging, 'log_odds_between', lambda pool, one, other: math.log(one.odds / other.odds)
    )
    monkeypatch.setattr(averaging, 'to_the_end', lambda problem, found, workers: found)
    monkeypatch.setattr(averaging, 'as_fitted', lambda pool, found, one: effect(one.name, 5.0))
    monkeypatch.setattr(
        averaging, 'evident', lambda pool, found, asked, tentative: (found, [*asked, *tentative])
    )
    return SimpleNamespace(problem=None, workers=1)


def inclusions(effects):
    return {one.best.cause.name: one.inclusion for one in effects}


def test_each_needs_the_other(pool):
    """Both are sure beside one another, and together little better than neither."""
    last = model('friction', 'belt', 'delay', odds=3.0)
    before = [model(odds=1e-9), model('friction', odds=2.0)]
    effects = [effect(name, math.log(1e6)) for name in ('friction', 'belt', 'delay')]
    found, averaged = averaging.averaged(pool, last, effects, before)
    assert found is last
    known = inclusions(averaged)
    assert known['belt'] == known['delay'] == pytest.approx(3.0 / 5.0, rel=1e-5)
    assert known['friction'] == pytest.approx(1.0, abs=1e-5)


def test_what_is_far_ahead_stays_as_sure_as_it_was(pool):
    last = model('friction', 'belt', odds=1e30)
    before = [model(odds=1.0), model('friction', odds=10.0)]
    effects = [effect('friction', 4.0), effect('belt', 0.2)]
    _, averaged = averaging.averaged(pool, last, effects, before)
    assert inclusions(averaged) == pytest.approx(inclusions(effects), abs=1e-9)


def test_the_most_probable_model_is_taken(pool):
    """With the causes that it had, also those that have gone since."""
    last = model('friction', 'belt', odds=1.0)
    ahead = model('friction', 'delay', odds=4.0)
    effects = [effect(name, math.log(1e6)) for name in ('friction', 'belt')]
    found, averaged = averaging.averaged(pool, last, effects, [model(odds=1e-9), ahead])
    assert found is ahead
    known = inclusions(averaged)
    assert known['friction'] == pytest.approx(1.0, abs=1e-5)
    assert known['delay'] == pytest.approx(1.0 / (1.0 + math.exp(-5.0) + 1.0 / 4.0), rel=1e-5)
