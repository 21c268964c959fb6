# SPDX-License-Identifier: Apache-2.0
"""Rivals of a cause are weighed by fits to all logs together."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis import rivalry
from waferbot_twin.diagnosis.alike import Weighed
from waferbot_twin.diagnosis.search_state import Rival, Score, Search, preferred
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause

SAMPLES = 10000
PRICE = math.log(SAMPLES)


@pytest.mark.parametrize(
    ('scores', 'place'),
    [
        ([Score(0.0, 50.0, 1), Score(-20.0, 60.0, 1)], 1),
        # as likely, but with a parameter more
        ([Score(0.0, 50.0, 1), Score(9.0, 50.5, 2)], 0),
        # better, but not by strong evidence
        ([Score(0.0, 50.0, 1), Score(-5.0, 57.5, 2)], 0),
        ([Score(0.0, 50.0, 1), Score(-7.0, 58.5, 2)], 1),
        # the simple one is no longer alike
        ([Score(0.0, 50.0, 1), Score(-12.0, 61.0, 2)], 1),
    ],
)
def test_the_simplest_of_those_alike_is_preferred_unless_evidence_is_strong(scores, place):
    assert preferred(scores) == place


@pytest.fixture(scope='module')
def causes():
    nominal = Variant.of(load_model('rigid'))
    return [
        Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
        for name in ('coulomb_friction', 'viscous_friction', 'constant_force')
    ]


class World:
    """Logs of which nobody knows more than how likely each cause makes them."""

    def __init__(self, monkeypatch, in_all, in_judging, feigned=(), told=None):
        self.fitted = []
        self.told = told or {}
        self.in_all, self.in_judging = in_all, in_judging
        monkeypatch.setattr(rivalry, 'Problem', lambda nominal, records: 'all')
        monkeypatch.setattr(rivalry, 'fit_causes', self.fit)
        monkeypatch.setattr(rivalry, 'evaluate', lambda problem, causes: self.judge(causes))
        monkeypatch.setattr(
            rivalry, 'feigned', lambda *logs: logs[-1].found.causes[-1].name in feigned
        )
        monkeypatch.setattr(rivalry, 'weighed_by_evidence', self.by_evidence)

    def fit(self, problem, causes):
        if problem == 'all':
            self.fitted.append(causes[0].name)
        likely = self.in_all[causes[0].name]
        return hypothesis(causes, likely(causes[0]) if callable(likely) else likely)

    def judge(self, causes):
        return hypothesis(causes, self.in_judging[causes[0].name] if causes else 0.0)

    def by_evidence(self, problem, judge, found, place):
        own = found.found.causes[place]

        def weighed(item):
            told, of_own = (self.told.get(one.name, one.free) for one in (item.cause, own))
            return Weighed(item, item.less_likely + (told - of_own) * PRICE, told)

        return [weighed(item) for item in found.rivals[own.name]]

    def search(self, own, *rivals, since=(), trials=None):
        found = Search(hypothesis([own, *since], 0.0), self.judge([own]), None, None)
        found.gains, found.rivals = {own.name: 100.0}, {own.name: list(rivals)}
        found.trials = trials or {}
        logs = SimpleNamespace(nominal=None, records=())
        return rivalry.weighed_in_all_logs(logs, logs, found, lambda *what: None)


def hypothesis(causes, twice_ln_l):
    fits = {'plant': SimpleNamespace(log_likelihood=0.5 * twice_ln_l, samples=SAMPLES)}
    return Hypothesis(tuple(causes), {}, fits)


def test_a_rival_that_only_had_a_bad_value_is_one_again(monkeypatch, causes):
    own, rival, _ = causes
    world = World(
        monkeypatch,
        {own.name: 900.0, rival.name: 897.0},
        {own.name: 500.0, rival.name: 430.0},
    )
    found = world.search(own, Rival(rival, 77.0, 67.0, -3.0))
    assert found.found.causes == (own,)
    (weighed,) = found.rivals[own.name]
    assert weighed.less_likely == pytest.approx(3.0)
    assert weighed.behind == pytest.approx(3.0 + (rival.free - own.free) * PRICE)


def test_a_rival_is_weighed_in_every_way_in_which_it_did_as_well(monkeypatch, causes):
    own, rival, _ = causes
    (name,) = rival.values
    other = rival.with_values({name: 2.0 * rival.values[name]})
    world = World(
        monkeypatch,
        {own.name: 900.0, rival.name: lambda cause: 897.0 if cause == other else 700.0},
        {own.name: 500.0},
    )
    found = world.search(own, Rival(rival, 9.0, 9.0, 4.0), trials={rival.name: [other]})
    (weighed,) = found.rivals[own.name]
    assert weighed.cause == other
    assert weighed.less_likely == pytest.approx(3.0)


@pytest.mark.parametrize('likelier', [True, False])
def test_a_fit_begins_with_the_others_as_they_were_beside_the_rival_if_that_is_likelier(
    monkeypatch, causes, likelier
):
    own, rival, other = causes
    then = other.with_values({name: 2.0 * value for name, value in other.values.items()})
    world = World(monkeypatch, {own.name: 900.0, rival.name: 899.0}, {own.name: 500.0})
    begun = []
    monkeypatch.setattr(
        rivalry, 'fit_causes', lambda logs, some: begun.append(some) or world.fit(logs, some)
    )
    monkeypatch.setattr(
        rivalry,
        'evaluate',
        lambda logs, some: hypothesis(some, 10.0 if (then in some) == likelier else 5.0),
    )
    world.search(own, Rival(rival, 9.0, 9.0, 4.0, beside=(then,)), since=[other])
    assert begun == [(own, other), (rival, then if likelier else other)]


def test_what_is_far_worse_where_it_was_fitted_is_not_fitted_again(monkeypatch, causes):
    own, rival, hopeless = causes
    world = World(
        monkeypatch, {own.name: 900.0, rival.name: 897.0}, dict.fromkeys([own.name], 5.0)
    )
    far_off = Rival(hopeless, 300.0, 300.0, 130.0)
    found = world.search(own, Rival(rival, 9.0, 9.0, 4.0), far_off)
    assert world.fitted == [own.name, rival.name]
    assert far_off in found.rivals[own.name]


def test_a_rival_that_was_behind_while_another_cause_lacked_is_weighed_beside_it(
    monkeypatch, causes
):
    own, rival, later = causes
    likely = {own.name: 900.0, rival.name: 901.0}
    world = World(monkeypatch, likely, {own.name: 500.0, rival.name: 500.0, later.name: 0.0})
    behind = Rival(rival, 25.0, 25.0, 25.0)  # of the 100 that the cause gained then
    assert world.search(own, behind).rivals[own.name] == [behind]
    assert not world.fitted
    found = world.search(own, behind, since=[later])
    assert found.found.causes[-1] == later
    weighed = [item.less_likely for items in found.rivals.values() for item in items]
    assert min(map(abs, weighed)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ('in_judging', 'takes_over'), [(480.0, True), (400.0, True), (300.0, False)]
)
def test_a_better_one_takes_the_place_if_it_judges_not_much_worse(
    monkeypatch, causes, in_judging, takes_over
):
    own, rival, _ = causes
    world = World(
        monkeypatch,
        {own.name: 900.0, rival.name: 930.0},
        {own.name: 500.0, rival.name: in_judging},
    )
    found = world.search(own, Rival(rival, 9.0, 9.0, 4.0))
    if not takes_over:
        assert found.found.causes == (own,)
        assert found.outdone
        return
    assert not found.outdone
    assert found.found.causes[0].name == rival.name
    (before,) = found.rivals[rival.name]
    assert before.cause == own
    assert before.less_likely == pytest.approx(30.0)
    assert found.gains[rival.name] == pytest.approx(130.0)


@pytest.mark.parametrize(('told', 'takes_over'), [(2.0, False), (1.3, True)])
def test_one_with_more_parameters_that_the_logs_tell_in_part_takes_the_place_if_more_plausible(
    monkeypatch, causes, told, takes_over
):
    """It is 15 in 2 ln L more likely; its second parameter costs 9, if the logs tell all of it."""
    own, _, _ = causes
    rival = Cause(find('stribeck_friction'), 'x_rotate', {'breakaway': 1.0, 'speed': 0.1})
    likely = {own.name: 900.0, rival.name: 915.0}
    world = World(
        monkeypatch, likely, {own.name: 500.0, rival.name: 505.0}, told={rival.name: told}
    )
    found = world.search(own, Rival(rival, 9.0, 9.0, 4.0))
    assert found.found.causes[0].name == (rival.name if takes_over else own.name)


def test_what_noise_in_the_current_loop_feigns_takes_no_place_and_is_no_rival(monkeypatch, causes):
    own, rival, other = causes
    likely = {own.name: 900.0, rival.name: 930.0, other.name: 895.0}
    world = World(monkeypatch, likely, dict.fromkeys(likely, 500.0), feigned=[rival.name])
    found = world.search(own, Rival(rival, 9.0, 9.0, 4.0), Rival(other, 9.0, 9.0, 4.0))
    assert found.found.causes == (own,)
    assert [item.cause for item in found.rivals[own.name]] == [other]
