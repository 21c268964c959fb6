# SPDX-License-Identifier: Apache-2.0
"""A search goes on as long as what it found asks for a slower observer."""

from __future__ import annotations

from types import SimpleNamespace

from waferbot_twin.diagnosis import diagnose


def test_a_search_goes_on_with_the_observer_that_what_was_found_asks_for(monkeypatch):
    best_hz = {'nominal': 80.0, ('friction',): 20.0, ('friction', 'cogging'): 20.0}
    searches = []

    def infer(pool, begun):
        searches.append((pool, begun))
        names = ('friction', 'cogging')[: len(searches)]
        return SimpleNamespace(found=SimpleNamespace(causes=names))

    def with_observers(records, nominal, variant):
        return [SimpleNamespace(observer_hz=(best_hz[variant],)) for _ in records]

    monkeypatch.setattr(diagnose, 'infer', infer)
    monkeypatch.setattr(diagnose, 'with_observers', with_observers)
    monkeypatch.setattr(diagnose, 'apply_all', lambda nominal, causes: causes)
    pool, posterior = diagnose._searched(
        'nominal', ['log', 'other'], lambda records: [one.observer_hz for one in records]
    )
    assert [pool for pool, _ in searches] == [[(80.0,)] * 2, [(20.0,)] * 2]
    assert searches[0][1] is None
    assert searches[1][1].found.causes == ('friction',)  # it begins with what was found
    assert pool == [(20.0,)] * 2
    assert posterior.found.causes == ('friction', 'cogging')
