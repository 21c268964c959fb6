# SPDX-License-Identifier: Apache-2.0
"""What other whole models do to the one that was found: they win, or take certainty away."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from waferbot_twin.diagnosis.inference import rival_models
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect

SETTINGS = Settings()


def hypothesis(*names):
    effect = SimpleNamespace(name='an effect')
    return SimpleNamespace(causes=tuple(SimpleNamespace(name=one, effect=effect) for one in names))


def single(*ranked, beside=()):
    """Return an effect whose members `ranked`, (name, probability), were fitted beside others."""
    members = tuple(
        Member(hypothesis(*beside, name), 9.0, 0.0, probability) for name, probability in ranked
    )
    return SingleEffect(members, 1.0 - sum(one.probability for one in members))


def certain(name, rival, beside):
    return single((name, 0.9999 - 1e-9), (rival, 1e-9), beside=beside)


@pytest.fixture
def searched(monkeypatch):
    """Return a function that weighs rivals; what the search from each leads to is given."""

    def weigh(found, effects, leads_to, most=24, promised=1e3):
        asked_from = []

        def ask_on(pool, there, effects, most, usual):
            name = there.causes[-1].name
            asked_from.append(name)
            names, _ = leads_to[name]
            known = {one.best.cause.name: one for one in effects}
            own = [known.get(one, single((one, 0.999))) for one in names]
            return hypothesis(*names), own, [], set(), 1

        def log_odds_between(pool, one, other):
            own = {cause.name for cause in one.causes}
            return next((odds for names, odds in leads_to.values() if set(names) == own), -200.0)

        monkeypatch.setattr(rival_models, 'ask_on', ask_on)
        monkeypatch.setattr(
            rival_models, 'evident', lambda pool, found, effects, tentative: (found, effects)
        )
        monkeypatch.setattr(rival_models, 'log_odds_between', log_odds_between)
        monkeypatch.setattr(rival_models, 'is_physical', lambda cause: True)
        monkeypatch.setattr(rival_models, 'is_nuisance', lambda cause: False)
        monkeypatch.setattr(
            rival_models, 'ask_again', lambda pool, found, effects, most: (found, effects, 0)
        )
        screened = SimpleNamespace(likelihood=promised, cause=SimpleNamespace(name='friction'))
        pool = SimpleNamespace(
            settings=SETTINGS,
            screen_as_at_first=lambda base: [screened],
            log_prior=lambda cause: 0.0,
            note_noise_of=lambda found: None,
            rivals=[],
        )
        found, effects, asked = rival_models.beside_rival_models(pool, found, effects, most)
        names = [cause.name for cause in found.causes]
        return names, {one.best.cause.name: one for one in effects}, asked, asked_from

    return weigh


FOUND = hypothesis('offset', 'gain')
EFFECTS = [
    single(('offset', 0.99999), beside=('gain',)),
    certain('gain', 'inertia', beside=('offset',)),
]


def test_a_model_that_is_ahead_is_the_one_that_was_found(searched):
    leads_to = {'inertia': (('offset', 'friction', 'inertia'), 3.0)}
    names, effects, asked, asked_from = searched(FOUND, EFFECTS, leads_to)
    assert names == ['offset', 'friction', 'inertia']
    assert asked == 1
    assert asked_from == ['inertia']  # the one before is weighed already
    first, second = effects['inertia'].members
    assert second.cause.name == 'gain'
    assert second.probability / first.probability == pytest.approx(math.exp(-3.0))
    assert effects['friction'].log_odds == pytest.approx(3.0)


def test_a_rival_of_a_model_that_is_behind_is_in_the_set(searched):
    leads_to = {'inertia': (('offset', 'friction', 'inertia'), -2.0)}
    names, effects, _, _ = searched(FOUND, EFFECTS, leads_to)
    assert names == ['offset', 'gain']
    first, second = effects['gain'].members
    assert second.cause.name == 'inertia'
    assert second.probability / first.probability == pytest.approx(math.exp(-2.0))
    assert effects['gain'].inclusion == pytest.approx(EFFECTS[1].inclusion)
    assert effects['offset'] is EFFECTS[0]


@pytest.mark.parametrize(
    ('leads_to', 'only_here'),
    [
        (('friction', 'inertia'), 'offset'),
        # the rival has gone on the way: nothing of its kind is what may be instead
        (('offset', 'friction'), 'gain'),
    ],
)
def test_what_another_model_does_not_have_is_as_probable_as_the_one_that_has_it(
    searched, leads_to, only_here
):
    names, effects, _, _ = searched(FOUND, EFFECTS, {'inertia': (leads_to, -2.0)})
    assert names == ['offset', 'gain']
    assert effects[only_here].log_odds == pytest.approx(2.0)


def test_nothing_is_asked_where_all_that_is_promised_is_too_little(searched):
    *_, asked, asked_from = searched(FOUND, EFFECTS, {}, promised=190.0)
    assert asked == 0
    assert asked_from == []


def test_no_more_is_asked_than_is_allowed(searched):
    leads_to = {'inertia': (('offset', 'friction', 'inertia'), 3.0)}
    assert searched(FOUND, EFFECTS, leads_to, most=0)[2] == 0


def test_a_rival_beside_other_causes_than_these_is_none(searched):
    old = certain('gain', 'inertia', beside=('something else',))
    assert searched(FOUND, [EFFECTS[0], old], {})[3] == []
