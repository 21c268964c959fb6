# SPDX-License-Identifier: Apache-2.0
"""Posterior of one effect of a sum: its credible set, and candidates fitted to logs of known cause."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_twin.diagnosis.inference import single_effects
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, posterior_of
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation import evidence
from waferbot_twin.estimation.evidence import log_evidence
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import PLANT, Cause

SEED = 20261213
TIME_S = np.linspace(0.0, 1.0, 3000)
SETTINGS = Settings()
PRIOR = math.log(SETTINGS.expected_causes / 3)


# Credible sets


@pytest.fixture(autouse=True)
def rigid(monkeypatch):
    """No part of a waveform lets go."""
    monkeypatch.setattr(evidence, 'with_next_to_none', lambda problem, found: None)


def effect_of(probabilities):
    members = tuple(Member(SimpleNamespace(), 0.0, 0.0, p) for p in sorted(probabilities)[::-1])
    return SingleEffect(members, 1.0 - sum(probabilities))


@settings(max_examples=200, deadline=None)
@given(
    weights=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=8),
    none=st.floats(1e-3, 1.0),
    level=st.floats(0.05, 0.99),
)
def test_a_credible_set_is_the_smallest_that_holds_its_level(weights, none, level):
    total = sum(weights) + none
    effect = effect_of([weight / total for weight in weights])
    chosen = effect.credible_set(level)
    held = [one.probability for one in chosen]
    assert chosen == effect.members[: len(chosen)]
    assert sum(held) >= level * effect.inclusion - 1e-12
    assert sum(held[:-1]) < level * effect.inclusion
    assert effect.inclusion == pytest.approx(1.0 - none / total)


def test_a_cause_beyond_doubt_is_a_set_of_its_own_and_equal_ones_are_all_in():
    assert len(effect_of([0.99, 0.005]).credible_set(0.95)) == 1
    assert len(effect_of([0.2, 0.2, 0.2, 0.2]).credible_set(0.95)) == 4


# Candidates with the logs of known causes


class Term:
    """An effect that adds a shape of its own to what is measured."""

    def __init__(self, name, signal):
        self.name, self.signal = name, signal

    def parameters(self, variant, axis):
        return (Parameter('size', '', 0.0, 1.0, -100.0, 100.0, ''),)

    def apply(self, variant, axis, values):
        return {**variant, self.name: values['size'] * self.signal}


class Sum:
    """A problem whose plant is a sum of terms in white noise; nobody knows what was commanded."""

    size_scales = SETTINGS.prior_scales

    def __init__(self, measured):
        self.nominal = {}
        self.blocks = {PLANT: [None]}
        self.measured = measured

    def sized_by_log(self, effect, axis):
        return False

    def touched(self, effect, axis):
        return (PLANT,)

    def between(self, one, other):
        return (PLANT,)

    def residuals(self, variant, block, workers=1):
        return [self.measured - sum(variant.values(), np.zeros_like(TIME_S))]

    def noises(self, block):
        return [Noise(1e-6, 4)]

    def judge(self, residuals):
        return {PLANT: likelihood(residuals[PLANT], self.noises(PLANT))}

    def ideal(self, causes):
        return None


SLOW, FAST = np.sin(20.0 * TIME_S), np.sign(np.sin(60.0 * TIME_S))
TERMS = [
    Term('slow', SLOW),
    Term('nearly_slow', SLOW + 0.02 * np.cos(47.0 * TIME_S)),
    Term('fast', FAST),
]


def posterior(true):
    """Return the posterior of one effect, of three candidates, in a log of a machine."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    problem = Sum(true + random.normal(size=len(TIME_S)))
    base = evaluate(problem)
    members = [
        Member(found, log_evidence(problem, found, base, SETTINGS.prior_scales), PRIOR)
        for found in (
            fit_causes(problem, (Cause(term, 'x_rotate', {'size': 0.0}),)) for term in TERMS
        )
    ]
    effect = posterior_of(base, members)
    total = sum(member.probability for member in effect.members) + effect.none
    assert total == pytest.approx(1.0)
    assert list(effect.members) == sorted(effect.members, key=lambda one: -one.probability)
    return effect


def names(members):
    return [member.cause.effect.name for member in members]


def test_what_is_there_is_named_and_what_looks_alike_is_in_its_set():
    effect = posterior(0.4 * SLOW)
    assert effect.inclusion > 0.99
    assert set(names(effect.credible_set(0.95))) == {'slow', 'nearly_slow'}
    assert effect.best.found.causes[0].values['size'] == pytest.approx(0.4, abs=0.1)


def test_what_looks_otherwise_is_named_alone():
    effect = posterior(0.4 * FAST)
    assert effect.inclusion > 0.99
    assert names(effect.credible_set(0.95)) == ['fast']


def test_of_noise_none_is_the_most_probable():
    effect = posterior(np.zeros_like(TIME_S))
    assert effect.none > 0.5
    assert all(member.log_evidence < 0.0 for member in effect.members)


def test_of_no_candidates_there_is_no_posterior():
    assert posterior_of(None, []) is None


def test_none_is_no_more_probable_than_beside_the_plainest_candidate(monkeypatch):
    """The likelier of two has little evidence of its own, the other much: something is there."""
    plain, likelier = (
        Member(
            SimpleNamespace(
                causes=(SimpleNamespace(name=name),), log_likelihood=likelihood, evidence=evidence
            ),
            evidence,
            PRIOR,
        )
        for name, likelihood, evidence in (('plain', 10.0, 25.0), ('likelier', 20.0, 1.0))
    )

    def gain(this, other):
        if other is None:
            return this.evidence
        return 0.0 if this is other else 4.0 if this is likelier.found else -4.0

    monkeypatch.setattr(single_effects, 'gain', gain)
    effect = posterior_of(None, [plain, likelier])
    assert effect.best.cause.name == 'likelier'
    assert effect.inclusion > 0.999
    assert effect.best.probability == pytest.approx(1.0 / (1.0 + math.exp(-4.0)), rel=1e-3)


def test_which_machine_it_is_does_not_depend_on_what_springs_do_alone(monkeypatch):
    """Cables with a mass count against those without it; against other cables they do all they do."""

    def member(name, gained, counted):
        found = SimpleNamespace(
            causes=(SimpleNamespace(name=name),), log_likelihood=gained, gained=gained
        )
        return Member(found, counted - 10.0, PRIOR, gained=counted)

    cables, mode = member('cables', 100.0, 100.0), member('mode', 150.0, 30.0)

    def gain(this, other):
        return this.gained if other is None else this.gained - other.gained

    monkeypatch.setattr(single_effects, 'gain', gain)
    effect = posterior_of(None, [cables, mode])
    assert effect.best.cause.name == 'mode'
    assert effect.best.probability == pytest.approx(1.0)
    # By what each gains against none the cables would be it.
    alone = posterior_of(None, [replace(one, gained=None) for one in (cables, mode)])
    assert alone.best.cause.name == 'cables'
