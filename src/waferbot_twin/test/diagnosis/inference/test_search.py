# SPDX-License-Identifier: Apache-2.0
"""How often the search adds and takes away."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import search
from waferbot_twin.diagnosis.inference.settings import Settings


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
        # what comes and goes again does not go on for ever
        ([({'delay', 'friction'}, 2)] * 2, [('friction',)] * 2, [False, True]),
        # nor further than is allowed
        ([({'delay', 'friction'}, 24)], [('friction',)], [False]),
    ],
)
def test_where_a_cause_has_gone_more_is_asked_for(monkeypatch, forward, left, asked):
    usual_were_there, forward, left = [], list(forward), list(left)

    def ask_on(pool, found, effects, most, usual):
        usual_were_there.append(usual)
        wanted, times = forward.pop(0)
        return found, effects, wanted, times

    monkeypatch.setattr(search, 'evaluate', lambda problem: hypothesis())
    monkeypatch.setattr(search, 'ask_on', ask_on)
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
    pool = SimpleNamespace(
        problem=None,
        settings=Settings(),
        names=['a'],
        workers=1,
        begin=lambda nothing: None,
        note_noise_of=lambda found: None,
    )
    found = search.infer(pool).found
    assert usual_were_there == asked
    assert not forward
    assert not left
    assert {cause.name for cause in found.causes} >= {'friction'}
