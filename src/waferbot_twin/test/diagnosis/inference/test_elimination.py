# SPDX-License-Identifier: Apache-2.0
"""Backward elimination in the linear problem, against least squares without what is out."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_twin.diagnosis.inference import elimination
from waferbot_twin.diagnosis.inference.elimination import _eliminated, _linear_odds
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import (
    Member,
    Posterior,
    SingleEffect,
    with_odds,
)
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Cause

NAMES = ('one', 'two', 'three', 'four')
POOL = SimpleNamespace(
    problem=SimpleNamespace(nominal=None, size_scales=(), sized_by_log=lambda effect, axis: False),
    settings=Settings(),
    log_prior=lambda cause: -3.0,
    progress=lambda stage, done, total: None,
)


class Term:
    """An effect of one parameter."""

    def __init__(self, name):
        self.name = name

    def parameters(self, variant, axis):
        return (Parameter('value', '', 0.0, 1.0, -100.0, 100.0, ''),)

    def repeats_after(self, variant, axis, values):
        return 0.0


def least_squares(columns, wanted, names, noise=1.0):
    """Return the hypothesis of least squares in noise of such variance (n,), taken for 1."""
    inverse = np.linalg.inv(columns.T @ columns)
    values = inverse @ columns.T @ wanted
    products = columns.T @ (np.broadcast_to(noise, len(columns))[:, None] * columns)
    causes = tuple(
        Cause(Term(name), 'x', {'value': float(value)})
        for name, value in zip(names, values, strict=True)
    )
    return Hypothesis(causes, {}, {}, inverse @ products @ inverse, columns.T @ columns)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), out=st.sets(st.sampled_from(NAMES), max_size=3))
def test_what_is_out_leaves_the_others_as_least_squares_without_it_do(seed, out):
    random = np.random.default_rng(seed)
    columns = random.standard_normal((50, 4)) @ random.standard_normal((4, 4))
    wanted = columns @ random.normal(0.0, 0.3, 4) + random.standard_normal(50)
    noise = random.choice([1.0, 400.0], 50)  # there may be more of it than anybody assumes
    inside = [place for place, name in enumerate(NAMES) if name not in out]
    names = [NAMES[place] for place in inside]
    found = _linear_odds(
        POOL, least_squares(columns, wanted, NAMES, noise), {f'{name}:x' for name in out}
    )
    truth = _linear_odds(POOL, least_squares(columns[:, inside], wanted, names, noise))
    assert found.keys() == truth.keys()
    assert found == pytest.approx(truth, rel=1e-6, abs=1e-6)


def test_one_of_two_that_do_the_same_stays():
    """Each alone is not evident beside the other, but together they are what is there."""
    seed = 20261126
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    first, third = random.standard_normal((2, 400))
    columns = np.column_stack([first, first + 0.01 * random.standard_normal(400), third])
    wanted = 2.0 * first + random.standard_normal(400)
    found = least_squares(columns, wanted, NAMES[:3])
    names = [cause.name for cause in found.causes]
    assert all(odds < 0.0 for odds in _linear_odds(POOL, found).values())
    out = _eliminated(POOL, found, names)
    assert 'three:x' in out
    assert len(out) == 2


def test_without_a_covariance_nothing_is_out():
    found = least_squares(np.eye(4), np.zeros(4), NAMES)
    nothing_known = Hypothesis(found.causes, {}, {})
    assert _eliminated(POOL, nothing_known, [cause.name for cause in found.causes]) == []


def effect_of(cause):
    found = SimpleNamespace(causes=(cause,))
    return SingleEffect((Member(found, 0.0, -3.0, 1.0),), 0.0)


@pytest.fixture
def judged(monkeypatch):
    """Return a function that eliminates causes by hand-made odds; and what it gave, what was asked."""

    def eliminated(causes, by_linear, by_logs, effects, tentative=(), each_once=None):
        asked = []

        def odds_beside(pool, found, name):
            asked.append(name)
            kept = tuple(cause for cause in found.causes if cause.name != name)
            return by_logs[name], Hypothesis(kept, {}, {})

        monkeypatch.setattr(elimination, '_without_some', lambda pool, found, names: None)
        monkeypatch.setattr(elimination, '_linear_odds', lambda pool, found, out=(): by_linear)
        monkeypatch.setattr(elimination, 'odds_beside', odds_beside)
        monkeypatch.setattr(elimination, 'to_the_end', lambda problem, found, workers: found)
        monkeypatch.setattr(
            elimination, 'each_once', each_once or (lambda problem, causes: tuple(causes))
        )
        monkeypatch.setattr(
            elimination,
            'fitted',
            lambda problem, causes, workers, enough, near: Hypothesis(causes, {}, {}),
        )
        pool = SimpleNamespace(**vars(POOL), workers=1)
        found, left = elimination.evident(pool, Hypothesis(causes, {}, {}), effects, tentative)
        return [cause.name for cause in found.causes], left, asked

    return eliminated


def names_of(effects):
    return [effect.best.cause.name for effect in effects]


def test_what_is_not_evident_is_asked_though_the_linear_problem_was_wrong_of_another(judged):
    """What it takes for the least evident gains 73 in ln odds; that says nothing of the next one."""
    every = tuple(Cause(Term(name), 'x', {'value': 1.0}) for name in NAMES[:3])
    by_linear = {'one:x': -9.0, 'two:x': -4.0, 'three:x': 40.0}
    by_logs = {'one:x': 73.0, 'two:x': -2.0}
    found, left, _ = judged(every, by_linear, by_logs, [effect_of(cause) for cause in every])
    assert found == names_of(left) == ['one:x', 'three:x']


def test_what_stands_for_a_dense_parameter_is_asked_however_evident(judged):
    """The linear problem has not that parameter, which without the cause does the same."""
    dense = Cause(Term('dense'), 'x', {'value': 0.0}, held=('value',))
    causes = (dense, *(Cause(Term(name), 'x', {'value': 1.0}) for name in NAMES[:3]))
    by_linear = {'one:x': 5.0, 'two:x': 900.0, 'three:x': 40.0}
    by_logs = {'one:x': 6.0, 'two:x': -1.0, 'three:x': 40.0}

    def each_once(problem, some):
        held = ('value',) if any(cause.name == 'two:x' for cause in some) else ()
        return tuple(replace(one, held=held) if one.name == 'dense:x' else one for one in some)

    effects = [effect_of(cause) for cause in causes[1:]]
    _, left, asked = judged(causes, by_linear, by_logs, effects, (), each_once)
    assert asked == ['one:x', 'two:x']
    assert names_of(left) == ['one:x', 'three:x']


def test_what_a_fit_has_brought_to_a_bound_goes(judged):
    """However much it gains: it is as large as it can be, so it stands in for something else."""
    values = {'one': 1.0, 'two': 100.0, 'three': 1.0}
    causes = tuple(Cause(Term(name), 'x', {'value': value}) for name, value in values.items())
    by_linear = {'one:x': 20.0, 'two:x': 90.0, 'three:x': 30.0}
    by_logs = dict.fromkeys(by_linear, 50.0)
    found, left, asked = judged(causes, by_linear, by_logs, [effect_of(cause) for cause in causes])
    assert found == names_of(left) == ['one:x', 'three:x']
    assert asked == ['two:x', 'one:x']


def test_the_next_member_takes_the_place_of_one_that_a_fit_has_brought_to_a_bound(judged):
    """What stood in for it did its work: without either, what is left over hides the others."""
    values = {'one': 1.0, 'two': 100.0, 'three': -100.0, 'four': 1.0}
    one, two, three, four = (
        Cause(Term(name), 'x', {'value': value}) for name, value in values.items()
    )
    members = [
        Member(Hypothesis((cause,), {}, {}), 0.0, -3.0, probability)
        for cause, probability in ((two, 0.6), (three, 0.3), (four, 0.1))
    ]
    effects = [effect_of(one), SingleEffect(tuple(members), 0.0)]
    by_linear = {'one:x': 20.0, 'two:x': 90.0, 'four:x': 30.0}
    found, left, asked = judged((one, two), by_linear, dict.fromkeys(by_linear, 50.0), effects)
    assert found == names_of(left) == ['one:x', 'four:x']  # three is on a bound itself
    assert asked == ['one:x']
    assert left[1].best.probability == pytest.approx(left[1].inclusion)


def test_what_came_along_stays_only_if_the_logs_want_it_back_itself(judged):
    """The linear problem is wrong of what was asked for, so it is not relied on for the others."""
    every = tuple(Cause(Term(name), 'x', {'value': 1.0}) for name in NAMES)
    by_linear = {'one:x': -9.0, 'two:x': 50.0, 'three:x': 60.0, 'four:x': 40.0}
    by_logs = {'one:x': 12.0, 'two:x': 17.0, 'three:x': -8.0, 'four:x': 96.0}
    one, two, three, four = (effect_of(cause) for cause in every)
    four = replace(four, none=0.3)
    found, left, asked = judged(every, by_linear, by_logs, [one, four], [two, three])
    assert names_of(left) == ['one:x', 'four:x', 'two:x']
    assert found == ['one:x', 'two:x', 'four:x']
    assert asked == ['one:x', 'two:x', 'three:x']  # least evident first, four was asked for before
    assert left[0].inclusion == pytest.approx(1.0 / (1.0 + np.exp(-12.0)))
    assert left[1].inclusion == pytest.approx(left[0].inclusion)  # more evident than the first
    # What was judged itself has that evidence, what was asked for before its own.
    assert [one.best.log_odds for one in left] == [12.0, four.best.log_odds, 17.0]


@pytest.mark.parametrize(
    ('gained', 'evidence', 'odds'),
    [
        ([4.0], [20.0], 17.0),  # plain even if another fit gained as much again
        (
            [18.0, 18.0],
            [20.0, 2.0],
            -1.0,
        ),  # not plain: a rough fit with its own signatures, too low
        (
            [18.0, 1.0],
            [20.0, 19.0],
            16.0,
        ),  # not plain: a rough fit says that there is little to gain
        ([18.0, 9.0], [20.0, 11.0, 10.0], 7.0),  # nor that: it is fitted to the end
        ([0.0], [2.0], -1.0),  # not evident, and another fit makes it less so
    ],
)
def test_another_fit_is_made_where_it_may_change_the_answer(monkeypatch, gained, evidence, odds):
    """With the signatures as they are with a cause, a fit without it is quick, and not the best."""
    found = least_squares(np.eye(4), np.ones(4), NAMES)
    made, gained = [], list(gained)

    def without(problem, found, names, workers=1, known=None, start=(), begun=None, roughly=0.0):
        assert start == (made[-1].causes if made else ())
        assert (known or begun).keys() == {cause.name for cause in found.causes}
        assert bool(known) == (not made)
        assert bool(roughly) == (len(made) == 1)
        promised = gained.pop(0) if made and gained else 100.0
        own = {'evidence': evidence[len(made)], 'promised': promised}
        made.append(SimpleNamespace(causes=(f'fit {len(made)}',), **own))
        return made[-1]

    monkeypatch.setattr(elimination, 'without', without)
    monkeypatch.setattr(elimination, 'without_by_linear', lambda problem, found, name: 'begun')
    monkeypatch.setattr(elimination, 'gain', lambda one, other: gained.pop(0))
    monkeypatch.setattr(elimination, 'log_evidence', lambda p, more, fewer, *_: fewer.evidence)
    pool = SimpleNamespace(
        **vars(POOL), workers=1, signatures_of=lambda found: [{'plant': np.eye(4)}] * 4
    )
    value, base = elimination.odds_beside(pool, found, 'one:x')
    assert value == odds
    assert len(made) == len(evidence)
    assert base is made[-1]


def test_the_odds_by_parts_of_the_logs_have_the_gain_of_the_parts(monkeypatch):
    found = least_squares(np.eye(4), np.ones(4), NAMES)
    monkeypatch.setattr(elimination, 'without', lambda *arguments: 'base')
    monkeypatch.setattr(elimination, 'without_by_linear', lambda problem, found, name: 'base')
    monkeypatch.setattr(
        elimination, 'gain', lambda one, other, parts=False: 0.0 if one == other else 9.0 - parts
    )
    monkeypatch.setattr(
        elimination,
        'log_evidence',
        lambda p, more, fewer, s, gained: 20.0 if gained is None else gained,
    )
    pool = SimpleNamespace(
        **vars(POOL), workers=1, signatures_of=lambda found: [{'plant': np.eye(4)}] * 4
    )
    assert elimination.odds_beside(pool, found, 'one:x')[0] == 17.0
    assert elimination.odds_beside(pool, found, 'one:x', parts=True)[0] == 5.0


@pytest.mark.parametrize(
    ('whole', 'of_orders', 'odds', 'asked'),
    [
        (-20.0, [3.0, 1.5, 9.0], 3.0, 1),  # as sure as its strongest order
        (-20.0, [-8.0, 1.5, 0.5], 1.5, 3),  # as sure as the surest, though none has a name
        (-20.0, [None, None, None], -20.0, 3),  # the machine does not stand with fewer
        (1.0, [-8.0, -2.0, -3.0], 1.0, 3),  # no less sure than as a whole
        (5.0, [], 5.0, 0),  # sure enough as it is
    ],
)
def test_a_cause_is_as_sure_as_the_surest_of_its_orders(
    monkeypatch, whole, of_orders, odds, asked
):
    found = least_squares(np.eye(4), np.ones(4), NAMES)
    pool = SimpleNamespace(
        **vars(POOL), workers=1, signatures_of=lambda found: [{'plant': np.eye(4)}] * 4
    )
    made = []

    def with_in_its_place(problem, more, fewer, begun):
        assert more.causes[-1].name == 'one:x'
        made.append(fewer)
        return fewer

    monkeypatch.setattr(elimination, '_odds_as_a_whole', lambda *_: (whole, 'base'))
    monkeypatch.setattr(elimination, 'with_an_order_less', lambda cause: of_orders)
    monkeypatch.setattr(elimination, 'with_in_its_place', with_in_its_place)
    monkeypatch.setattr(elimination, 'log_odds_between', lambda pool, one, other, parts: other)
    assert elimination.odds_beside(pool, found, 'one:x', parts=True) == (odds, 'base')
    assert len(made) == asked


def test_many_causes_do_not_take_one_along_that_is_evident(monkeypatch):
    """One gains 12 in ln L, five nothing: together they are not evident, and still one is needed."""
    seed = 20261126
    print(f'seed {seed}')
    columns = np.linalg.qr(np.random.default_rng(seed).standard_normal((200, 4)))[0]
    found = least_squares(columns, 5.0 * columns[:, 0], NAMES)
    fewer = least_squares(columns[:, 1:], np.zeros(200), NAMES[1:])
    monkeypatch.setattr(elimination, 'gain', lambda more, fewer: 12.5)
    monkeypatch.setattr(elimination, 'without', lambda *arguments: fewer)
    monkeypatch.setattr(
        elimination,
        '_eliminated',
        lambda pool, found, names: [cause.name for cause in found.causes],
    )
    pool = SimpleNamespace(**vars(POOL), workers=1, signatures_of=lambda found: found.causes)
    assert elimination._without_some(pool, found, NAMES) is None


def test_a_member_that_comes_in_the_place_of_another_is_no_surer_than_that_was(monkeypatch):
    """What a fit takes to a bound gives way to the next of its set: a name that was no effect's best."""
    one, other = (effect_of(Cause(Term(name), 'x', {'value': 1.0})) for name in NAMES[:2])
    before = with_odds(SingleEffect((one.best, other.best), 0.0), 4.0)
    after = with_odds(other, 90.0)
    monkeypatch.setattr(elimination, 'evident', lambda pool, found, effects: ('found', [after]))
    judged = elimination.as_evident(POOL, Posterior('nothing', 'found', (before,), 7))
    assert names_of(judged.effects) == ['two:x']
    assert judged.effects[0].log_odds == pytest.approx(4.0)


def test_what_is_judged_once_more_goes_or_is_no_surer_than_before(monkeypatch):
    every = [effect_of(Cause(Term(name), 'x', {'value': 1.0})) for name in NAMES[:3]]
    odds = [(4.0, 90.0), (5.0, None), (9.0, 2.0)]  # before and after; None: it goes
    before = [with_odds(one, was) for one, (was, _) in zip(every, odds, strict=True)]
    after = [
        with_odds(one, now) for one, (_, now) in zip(every, odds, strict=True) if now is not None
    ]
    monkeypatch.setattr(elimination, 'evident', lambda pool, found, effects: ('fewer', after))
    judged = elimination.as_evident(POOL, Posterior('nothing', 'found', tuple(before), 7))
    assert names_of(judged.effects) == ['one:x', 'three:x']
    assert [one.log_odds for one in judged.effects] == pytest.approx([4.0, 2.0])
    assert (judged.nothing, judged.found, judged.tried) == ('nothing', 'fewer', 7)
