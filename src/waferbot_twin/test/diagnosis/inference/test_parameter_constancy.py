# SPDX-License-Identifier: Apache-2.0
"""Causes judged beside how their sizes vary, with gains and evidence by hand."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference import parameter_constancy
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import (
    Member,
    Posterior,
    SingleEffect,
    with_odds,
)

NAMES = ('friction', 'ripple', 'stands_not', 'nuisance_parameters')
GAINS = {'friction': 50.0, 'ripple': 50.0}
BY_PARTS = {'friction': 50.0, 'ripple': 7.0}
OCCAM, PRIOR = -4.0, -5.0


def cause(name):
    return SimpleNamespace(name=f'{name}:x', effect=SimpleNamespace(name=name), axis='x')


def posterior(log_odds):
    causes = tuple(cause(name) for name in NAMES)
    effects = tuple(
        with_odds(
            SingleEffect((Member(SimpleNamespace(causes=(one,)), 0.0, 0.0, 1.0),), 0.0), log_odds
        )
        for one in causes
    )
    return Posterior(SimpleNamespace(), SimpleNamespace(causes=causes), effects, 4)


@pytest.fixture
def pool(monkeypatch):
    refitted = []

    def without_by_linear(problem, found, name):
        if name == 'stands_not:x':
            raise UserError('blows up')
        return name

    def gain(more, base, parts=False):
        return (BY_PARTS if parts else GAINS)[base.split(':')[0]]

    def odds_beside(pool, found, name, parts=False):
        refitted.append(name)
        return (BY_PARTS if parts else GAINS)[name.split(':')[0]] + OCCAM + PRIOR, None

    def last(problem, found, name):
        return SimpleNamespace(causes=(cause(name.split(':')[0]),))

    monkeypatch.setattr(parameter_constancy, 'without_by_linear', without_by_linear)
    monkeypatch.setattr(parameter_constancy, 'gain', gain)
    monkeypatch.setattr(parameter_constancy, 'odds_beside', odds_beside)
    monkeypatch.setattr(parameter_constancy, 'with_last', last)
    told = []
    return SimpleNamespace(
        settings=Settings(),
        workers=1,
        judged=lambda found: SimpleNamespace(problem=None),
        refitted=refitted,
        told=told,
        progress=lambda *done: told.append(done),
    )


def inclusions(found):
    return [effect.inclusion for effect in found.effects]


def test_what_varies_too_much_is_as_likely_as_not(pool):
    before = posterior(9.0)
    after = parameter_constancy.as_sure_as_constant(pool, before)
    sure = before.effects[0].inclusion
    assert inclusions(after) == pytest.approx([sure, 0.5, sure, sure])
    assert pool.refitted == ['ripple:x'], (
        'where they agree in the linear problem nothing is fitted'
    )
    assert pool.told == [('parameter constancy', done, 3) for done in (1, 2, 3)]


@pytest.mark.parametrize(('by_parts', 'odds'), [(11.0, 2.0), (30.0, 9.0)])
def test_odds_are_those_of_the_parts_if_these_are_less(pool, monkeypatch, by_parts, odds):
    monkeypatch.setitem(BY_PARTS, 'ripple', by_parts)
    after = parameter_constancy.as_sure_as_constant(pool, posterior(9.0))
    expected = inclusions(posterior(odds))[0]
    assert inclusions(after)[1] == pytest.approx(expected)
