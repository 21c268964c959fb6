# SPDX-License-Identifier: Apache-2.0
"""What is added where something without a name is ahead."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import forward_selection
from waferbot_twin.diagnosis.inference.refit import fitted
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause


def hypothesis(*names):
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=name) for name in names))


@pytest.mark.parametrize(
    ('ahead', 'then', 'taken', 'asked'),
    [
        # the first is ahead of the force without a name already
        ([1.0], [], ['a'], 0),
        # two do together what it does alone
        ([-5.0, 2.0], [['b']], ['a', 'b'], 1),
        # they never are, and no more is there
        ([-5.0], [['force_over_velocity']], [], 1),
        # nor may more be asked for
        ([-5.0, -1.0, -0.5, -0.2], [['b'], ['c'], ['d']], [], 3),
    ],
)
def test_several_causes_may_do_what_a_force_without_a_name_does(
    monkeypatch, ahead, then, taken, asked
):
    def effect(*names):
        members = tuple(
            SimpleNamespace(
                cause=SimpleNamespace(name=name, effect=SimpleNamespace(name=name)),
                found=hypothesis(name),
            )
            for name in names
        )
        return SimpleNamespace(members=members, best=members[0], inclusion=1.0)

    ahead, then = list(ahead), [effect(*names) for names in then]
    monkeypatch.setattr(forward_selection, 'with_last', lambda problem, found, name: found)
    monkeypatch.setattr(forward_selection, 'is_nothing', lambda problem, cause: False)
    monkeypatch.setattr(
        forward_selection,
        'posterior_of',
        lambda base, members: effect(members[0].cause.name) if members else None,
    )
    monkeypatch.setattr(forward_selection, 'fitted_together', lambda pool, found, *_: found)
    monkeypatch.setattr(
        forward_selection, 'log_odds_between', lambda pool, one, other: ahead.pop(0)
    )
    monkeypatch.setattr(forward_selection, 'ask', lambda pool, base: then.pop(0) if then else None)
    pool = SimpleNamespace(problem=None, settings=Settings())
    first = effect('force_over_velocity', 'a')
    chosen, _, more = forward_selection._by_names(pool, hypothesis(), first, 3)
    assert [one.best.cause.name for one in chosen] == taken
    assert more == asked


@pytest.mark.parametrize(
    ('orders', 'log_odds', 'kept'),
    [
        ({7: 0.0, 42: 0.0}, 9.0, {'cosine_7', 'cosine_42'}),
        ({7: 0.0, 42: 0.0}, -1.0, {'cosine_7'}),  # more lines, and not worth them
        ({7: 0.0}, 9.0, {'cosine_7'}),  # the same lines: nothing is fitted
        ({}, 9.0, {'cosine_7'}),
    ],
)
def test_cogging_has_the_orders_that_show_beside_the_other_causes(
    monkeypatch, orders, log_odds, kept
):
    def cause(name, values):
        values = {f'cosine_{order}': size for order, size in values.items()}
        return SimpleNamespace(name=name, effect=SimpleNamespace(name=name), values=values)

    friction, ripple = cause('friction', {}), cause('cogging', {7: 0.1})
    found = SimpleNamespace(causes=(friction, ripple))
    tuned = [SimpleNamespace(cause=cause('cogging', orders))] if orders else []
    fits = lambda base, items, known: [SimpleNamespace(causes=(friction, items[0].cause))]  # noqa: E731
    monkeypatch.setattr(forward_selection, 'measured_by_others', lambda problem: ['a log'])
    monkeypatch.setattr(forward_selection, 'with_last', lambda problem, found, name: found)
    monkeypatch.setattr(forward_selection, 'is_nothing', lambda problem, cause: False)
    monkeypatch.setattr(forward_selection, 'evaluate', lambda problem, causes: None)
    monkeypatch.setattr(forward_selection, 'Refits', lambda problem, progress: fits)
    monkeypatch.setattr(forward_selection, 'log_odds_between', lambda pool, one, other: log_odds)
    monkeypatch.setattr(forward_selection, 'fitted_together', lambda pool, found, *_: found)
    pool = SimpleNamespace(
        problem=None,
        progress=None,
        with_orders=lambda present: tuned,
        signatures_of=lambda present: [{}, {}],
    )
    result = forward_selection._with_their_orders(pool, found)
    assert set(result.causes[-1].values) == kept
    assert result.causes[0] is friction


@pytest.mark.parametrize(
    ('rivals', 'lets_go', 'taken'),
    [
        ({}, (), ['a:y', 'b:z', 'c:x']),  # nobody else does what they do
        ({'a:y': ['d:y']}, (), ['a:y', 'b:z', 'c:x']),  # which it is on its axis is one effect
        ({'a:y': ['d:z']}, (), ['b:z', 'c:x']),  # which axis it is has to be asked
        ({'c:x': ['d:x']}, (), ['a:y', 'b:z']),  # of its axis something was chosen
        ({}, ('first:x', 'c:x'), ['a:y', 'b:z']),
    ],
)
def test_with_the_most_probable_come_those_that_are_plain_beside_it(
    monkeypatch, rivals, lets_go, taken
):
    def member(name, log_odds):
        cause = SimpleNamespace(name=name, axis=name[-1], effect=SimpleNamespace(name=name))
        return Member(SimpleNamespace(causes=(cause,), name=name), log_odds, 0.0)

    members = [
        member(name, 40.0 - place)
        for place, name in enumerate(('first:x', 'a:y', 'd:y', 'b:z', 'c:x'))
    ]
    members[2] = member('d:y', 1.0)  # no more probable than named
    monkeypatch.setattr(forward_selection, '_change', lambda base, one: one.found.name)
    monkeypatch.setattr(forward_selection, '_gain_beside', lambda base, others, own: 30.0)
    monkeypatch.setattr(forward_selection, 'gain', lambda one, base: 30.0)
    monkeypatch.setattr(
        forward_selection, 'lets_go', lambda problem, causes, cause: cause.name in lets_go
    )
    asked = []

    def posterior_of(base, own):
        asked.append([one.cause.name for one in own])
        return SingleEffect(tuple(own), 0.1)

    monkeypatch.setattr(forward_selection, 'posterior_of', posterior_of)
    pool = SimpleNamespace(
        problem=None,
        settings=Settings(),
        could_stand_for=lambda base, found: [
            [SimpleNamespace(name=name, axis=name[-1]) for name in rivals.get(one.name, ())]
            for one in found
        ],
    )
    chosen = forward_selection._apart(pool, SimpleNamespace(causes=()), members)
    assert [one.best.cause.name for one in chosen] == taken
    assert asked == ([['a:y', 'd:y']] if rivals.get('a:y') == ['d:y'] else [])


@pytest.mark.parametrize(
    ('odds', 'feigned', 'come', 'tentative'),
    [
        ([(9.0, 0.0)], '', 0, []),
        ([(9.0, 0.0), (9.0, 0.0)], '', 1, ['usual']),
        ([(9.0, 0.0), (1.0, 0.0)], '', 0, []),  # included, and not sure enough to be named
        ([(9.0, 0.0), (1.0, 0.0), (9.0, 0.0)], '', 1, ['usual']),
        ([(9.0, 0.0), (-9.0, 9.0)], '', 1, ['1', 'usual']),  # were the power of noise known
        ([(9.0, 0.0), (-9.0, 1.0)], '', 0, ['1']),
        ([(9.0, 0.0), (9.0, 0.0)], '1', 0, []),  # noise would do as much
        ([(9.0, 0.0), (9.0, 0.0)], '0', 0, []),
        ([(9.0, 0.0), (9.0, 0.0), (9.0, 0.0)], '0', 1, ['usual']),
    ],
)
def test_what_everybody_fits_first_comes_with_a_second_sure_cause(
    monkeypatch, odds, feigned, come, tentative
):
    """And with it, and in the end, other models as a whole; beside one cause nothing of this."""

    def of(*names):
        causes = tuple(
            SimpleNamespace(name=name, effect=SimpleNamespace(name=name)) for name in names
        )
        return SimpleNamespace(causes=causes)

    def effect(found, log_odds):
        return with_odds(SingleEffect((Member(found, log_odds, 0.0, 1.0),), 0.0), log_odds)

    def ask(pool, found):
        names = [cause.name for cause in found.causes if cause.name != 'usual']
        if len(names) == len(odds):
            return None
        return effect(of(*names, str(len(names))), odds[len(names)][0])

    def whole(pool, found, effects, open_ones):
        weighed.append([cause.name for cause in found.causes])
        return found, effects, open_ones

    weighed: list[list[str]] = []
    for name, value in {
        'ask': ask,
        '_ahead': lambda problem, found, one: (
            one.best, odds[int(one.best.cause.name)][1]
        ),
        '_apart': lambda pool, found, members: [],
        'beside_noise': lambda pool, found, effects: [
            with_odds(one, 1.0) if one.best.cause.name in feigned else one for one in effects
        ],
        'fitted_together': lambda pool, found, causes, beside: SimpleNamespace(causes=causes),
        'as_fitted': lambda pool, found, cause: effect(of(cause.name), 0.0),
        '_with_their_orders': lambda pool, found: found,
        '_begun_elsewhere': lambda pool, found: found,
        'some_of_each': lambda problem, *found: found,
        'is_nothing': lambda problem, cause: False,
    }.items():  # fmt: skip
        monkeypatch.setattr(forward_selection, name, value)
    pool = SimpleNamespace(
        problem=None,
        settings=Settings(),
        asked_beside={},
        usual=lambda: of('usual').causes,
        note_noise_of=lambda found: None,
    )
    found, effects, open_ones, wanted, asked = forward_selection.ask_on(
        pool, of(), [], 24, False, whole
    )
    assert [one.best.cause.name for one in open_ones] == tentative
    assert len(effects) + len([name for name in tentative if name != 'usual']) == len(odds)
    assert asked == len(odds) + 1
    assert len(weighed) == 2 * come
    assert wanted == {str(place) for place in range(len(odds))}
    assert ('usual' in {cause.name for cause in found.causes}) == bool(come)
    # What was asked for before the usual came may be another one now.
    assert (frozenset() in pool.asked_beside) == (not come)
    assert frozenset(cause.name for cause in found.causes) in pool.asked_beside


@pytest.mark.parametrize(
    ('breakaway', 'speed'), [(1.5, 0.09), (2.3, 3e-4), (0.1, 3e-4), (0.5, 0.098)]
)
def test_what_is_in_place_of_a_cause_does_not_suffer_from_where_the_others_went_without_it(
    pool_of, breakaway, speed
):
    """
    Beside a Stribeck curve friction that changes along the way, by next to nothing, is Coulomb friction.

    Without it the curve takes over what it can, with another size and at another speed, from where a fit
    of Coulomb friction does not come back.
    """
    names = ('coulomb_friction', 'stribeck_friction', 'position_dependent_friction')
    nominal = Variant.of(load_model('rigid'))
    coulomb, stribeck = (
        Cause(find(name), 'x_rotate', find(name).typical(nominal, 'x_rotate'))
        for name in names[:2]
    )
    pool = pool_of('random_x_rotate', names, hidden=(coulomb, stribeck))
    pool.begin(evaluate(pool.problem))
    friction = coulomb.values['friction']
    changes = {'mean': friction, 'cosine': 0.01, 'sine': -0.01, 'period': 2.0 * math.pi}
    there = Cause(find(names[2]), 'x_rotate', changes, ('period',))
    present = fitted(pool.problem, (stribeck, there))
    without = stribeck.with_values({'breakaway': breakaway, 'speed': speed})
    base = evaluate(pool.problem, (without,))
    rivals = pool.in_place_of(present)
    effect = forward_selection.posterior_beside(pool, base, rivals, present)
    assert effect.best.cause.effect.name == 'coulomb_friction'
    assert effect.best.cause.values['friction'] == pytest.approx(friction, rel=0.01)
