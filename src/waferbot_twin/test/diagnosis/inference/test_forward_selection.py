# SPDX-License-Identifier: Apache-2.0
"""What is added where something without a name is ahead."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import forward_selection
from waferbot_twin.diagnosis.inference.settings import Settings


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
    monkeypatch.setattr(
        forward_selection,
        'posterior_of',
        lambda base, members: effect(members[0].cause.name) if members else None,
    )
    monkeypatch.setattr(forward_selection, 'fitted_together', lambda pool, found, causes: found)
    monkeypatch.setattr(
        forward_selection, 'log_odds_between', lambda pool, one, other: ahead.pop(0)
    )
    monkeypatch.setattr(forward_selection, 'ask', lambda pool, base: then.pop(0) if then else None)
    pool = SimpleNamespace(problem=None, settings=Settings())
    first = effect('force_over_velocity', 'a')
    chosen, _, more = forward_selection._by_names(pool, hypothesis(), first, 3)
    assert [one.best.cause.name for one in chosen] == taken
    assert more == asked
