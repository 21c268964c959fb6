# SPDX-License-Identifier: Apache-2.0
"""How often the search adds and takes away."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import search
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, Posterior, SingleEffect

POOL = SimpleNamespace(
    problem=None,
    settings=Settings(),
    names=['a'],
    workers=1,
    asked_beside={},
    rivals=[],
    begin=lambda base: None,
    note_noise_of=lambda found: None,
)


def hypothesis(*names):
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=name) for name in names))


@pytest.mark.parametrize(
    ('forward', 'left', 'asked'),
    [
        # a delay stood for a belt: when it has gone, the belt is asked for
        (
            [({'delay', 'friction'}, 3), ({'belt', 'friction'}, 2)],
            [('friction',), ('friction', 'belt')],
            [False, True],
        ),
        # nothing that was asked for goes: once is enough
        ([({'friction'}, 2)], [('friction',)], [False]),
        # what comes and goes again does not go on for ever, nor is asked for beside the same causes
        ([({'delay', 'friction'}, 2)] * 2, [('friction',)] * 2, [False, True]),
        ([({'delay', 'friction'}, 2)], [()], [False]),
        # nor further than is allowed
        ([({'delay', 'friction'}, 24)], [('friction',)], [False]),
    ],
)
def test_where_a_cause_has_gone_more_is_asked_for(monkeypatch, forward, left, asked):
    usual_were_there, forward, left, last = [], list(forward), list(left), left[-1]

    def ask_on(pool, found, effects, most, usual, as_a_whole):
        usual_were_there.append(usual)
        pool.asked_beside[frozenset(cause.name for cause in found.causes)] = None
        wanted, times = forward.pop(0)
        return found, effects, [], wanted, times

    monkeypatch.setattr(search, 'evaluate', lambda problem: hypothesis())
    monkeypatch.setattr(search, 'ask_on', ask_on)
    for name in ('or_flexible', 'or_other_loads'):
        monkeypatch.setattr(search, name, lambda pool, *found: found)
    monkeypatch.setattr(
        search, 'evident', lambda pool, found, effects, tentative: (found, effects)
    )
    monkeypatch.setattr(
        search,
        'ask_again',
        lambda pool, found, effects, most: (hypothesis(*left.pop(0)), effects, 0),
    )
    monkeypatch.setattr(
        search, 'beside_rival_models', lambda pool, found, effects, most: (found, effects, 0)
    )
    monkeypatch.setattr(
        search, 'without_feigned', lambda pool, found, effects: (found, effects, [])
    )
    monkeypatch.setattr(search, 'to_the_end', lambda problem, found, workers: found)
    found = search.infer(POOL).found
    assert usual_were_there == asked
    assert not forward
    assert not left
    assert tuple(cause.name for cause in found.causes) == last


def test_what_gives_is_judged_with_what_came_along(monkeypatch):
    """
    The flexible model takes the place of the one that was asked for, that with another load of this one.

    Then all have to be evident.
    """
    effect, along, soft, load = (
        SingleEffect((Member(hypothesis(name), 9.0, -3.0, 0.9),), 0.1)
        for name in ('friction', 'inertia', 'cable', 'load')
    )
    flexible, judged = hypothesis('friction', 'inertia', 'cable'), []
    loaded = hypothesis('friction', 'cable', 'load')

    def or_other_loads(pool, found, effects, tentative):
        assert (found, tentative) == (flexible, [along, soft])
        return loaded, effects, [soft, load]

    def ask_on(pool, found, effects, most, usual, as_a_whole):
        asked = as_a_whole(pool, hypothesis('friction', 'inertia'), [effect], [along])
        return *asked, {'friction'}, 2

    def evident(pool, found, effects, tentative):
        judged.append((found, effects, tentative))
        return hypothesis('friction', 'cable'), [effect, soft]

    for name, value in {
        'evaluate': lambda problem: hypothesis(),
        'ask_on': ask_on,
        'or_flexible': lambda pool, found, effects, tentative: (
            flexible, effects, [*tentative, soft]
        ),
        'or_other_loads': or_other_loads,
        'evident': evident,
        'ask_again': lambda pool, found, effects, most: (found, effects, 0),
        'beside_rival_models': lambda pool, found, effects, most: (found, effects, 0),
        'without_feigned': lambda pool, found, effects: (found, effects, []),
        'to_the_end': lambda problem, found, workers: found,
    }.items():  # fmt: skip
        monkeypatch.setattr(search, name, value)
    found = search.infer(POOL)
    assert judged == [(loaded, [effect], [soft, load])]
    assert found.effects == (effect, soft)


@pytest.mark.parametrize(
    ('stands', 'names', 'inclusions'),
    [(True, ['friction', 'belt'], [0.9, 0.7]), (False, [], [])],
)
def test_a_search_goes_on_from_what_was_found_with_another_observer(
    monkeypatch, stands, names, inclusions
):
    """If the machine stands with that; what is certain by then has to be evident again."""
    before = hypothesis('friction', 'belt')
    effects = (
        SingleEffect((Member(before, 9.0, -3.0, 0.9),), 0.1),
        SingleEffect((Member(before, 5.0, -3.0, 0.7),), 0.3),
    )
    begun, told = Posterior(hypothesis(), before, effects, 2), []
    fitted = hypothesis('friction', 'belt')

    def ask_on(pool, found, effects, most, usual, as_a_whole):
        told.append((found, effects, usual))
        return found, effects, [], set(), 1

    for name, value in {
        'evaluate': lambda problem: hypothesis(),
        'fitted': lambda problem, causes, workers, near: fitted if stands else None,
        'as_fitted': lambda pool, found, cause: SingleEffect(
            (Member(hypothesis(cause.name), 0.0, -3.0, 1.0),), 0.0
        ),
        'ask_on': ask_on,
        'or_flexible': lambda pool, *found: found,
        'or_other_loads': lambda pool, *found: found,
        'evident': lambda pool, found, effects, tentative: (found, effects),
        'ask_again': lambda pool, found, effects, most: (found, effects, 0),
        'beside_rival_models': lambda pool, found, effects, most: (found, effects, 0),
        'without_feigned': lambda pool, found, effects: (found, effects, []),
        'to_the_end': lambda problem, found, workers: found,
    }.items():
        monkeypatch.setattr(search, name, value)
    found = search.infer(POOL, begun)
    ((first, given, usual),) = told
    assert usual  # what everybody fits first has been there
    assert [cause.name for cause in first.causes] == names
    assert [one.best.cause.name for one in given] == names
    assert [one.inclusion for one in given] == pytest.approx(inclusions)
    assert found.found is first
