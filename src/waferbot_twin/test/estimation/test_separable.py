# SPDX-License-Identifier: Apache-2.0
"""Causes without a common block, fitted apart: as fitted together, by fewer simulations."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.gauss_newton import ENOUGH, fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.estimation.separable import (
    Behind,
    components,
    fitted_apart,
    fitted_without,
    refined,
)
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import AMPLIFIER, CONTROLLER, PLANT, Cause

SEED = 35
TIME_S = np.linspace(0.0, 1.0, 200)
READS = {PLANT: ('mass', 'friction'), CONTROLLER: ('gain',), AMPLIFIER: ('gain', 'offset')}
"""What each block reads: mass and friction belong together, and gain and offset."""


class Term:
    """An effect of one parameter."""

    def __init__(self, name):
        self.name = name

    def parameters(self, variant, axis):
        return (Parameter('value', '', 0.0, 1.0, -50.0, 50.0, ''),)

    def apply(self, variant, axis, values):
        return {**variant, self.name: values['value']}


class Blocks:
    """A problem with three blocks, each bent in what it reads; counts how often each is simulated."""

    size_scales = ()

    def __init__(self, measured, blocks=tuple(READS), simulated=None):
        self.nominal, self.measured = {}, measured
        self.blocks = {block: [None] if block in blocks else [] for block in READS}
        self.simulated = Counter() if simulated is None else simulated

    def only(self, blocks):
        own = [block for block in blocks if self.blocks[block]]
        return Blocks(self.measured, own, self.simulated)

    def touched(self, effect, axis):
        return tuple(b for b, names in READS.items() if self.blocks[b] and effect.name in names)

    def between(self, one, other):
        return tuple(block for block in READS if self.blocks[block])

    def residuals(self, variant, block, workers=1):
        self.simulated[block] += 1
        values = [variant.get(name, 0.0) for name in READS[block]]
        return [self.measured[block] - response(values)]

    def noises(self, block):
        return [Noise(1e-6, 0)]

    def judge(self, residuals):
        return {block: likelihood(one, self.noises(block)) for block, one in residuals.items()}


def response(values):
    return sum(np.sin((3 * n + 1) * TIME_S * (1.0 + 0.1 * v)) * v for n, v in enumerate(values))


@pytest.fixture
def problem():
    print(f'seed {SEED}')
    noise = 0.1 * np.random.default_rng(SEED).normal(size=(3, len(TIME_S)))
    true = {'mass': 2.0, 'friction': -1.0, 'gain': 0.5, 'offset': 3.0}
    return Blocks(
        {
            block: response([true[name] for name in names]) + one
            for (block, names), one in zip(READS.items(), noise, strict=True)
        }
    )


def causes(*names):
    return tuple(Cause(Term(name), 'x', {'value': 1.0}) for name in names)


def test_causes_that_share_a_block_belong_together(problem):
    found = components(problem, causes('mass', 'offset', 'friction', 'gain'))
    assert [one.places for one in found] == [(0, 2), (1, 3)]
    assert [one.blocks for one in found] == [{PLANT}, {CONTROLLER, AMPLIFIER}]


@pytest.mark.parametrize(
    'names', [('mass', 'offset', 'friction', 'gain'), ('gain', 'mass'), ('friction',), ()]
)
def test_what_is_fitted_apart_is_what_a_joint_fit_finds(problem, names):
    apart, together = fitted_apart(problem, causes(*names)), fit_causes(problem, causes(*names))
    assert [one.name for one in apart.causes] == [one.name for one in together.causes]
    for one, other in zip(apart.causes, together.causes, strict=True):
        assert one.values['value'] == pytest.approx(other.values['value'], abs=2e-3)
    assert apart.log_likelihood == pytest.approx(together.log_likelihood, abs=0.05)
    assert list(apart.fits) == list(together.fits)
    np.testing.assert_allclose(apart.covariance, together.covariance, rtol=0.05, atol=1e-8)


def test_one_more_cause_leaves_as_it_was_what_has_nothing_to_do_with_it(problem):
    base = fitted_apart(problem, causes('mass', 'offset'))
    (gain,) = causes('gain')
    problem.simulated.clear()
    one = Behind.of(problem, base, gain)
    more = one.whole(fit_causes(one.problem, (*one.beside.causes, gain)))
    assert [cause.name for cause in more.causes] == ['mass:x', 'offset:x', 'gain:x']
    assert not problem.simulated[PLANT]
    assert more.fits[PLANT] is base.fits[PLANT]
    assert more.causes[0] is base.causes[0]
    together = fit_causes(problem, causes('mass', 'offset', 'gain'))
    assert more.log_likelihood == pytest.approx(together.log_likelihood, abs=0.05)
    np.testing.assert_allclose(more.covariance, together.covariance, rtol=0.05, atol=1e-8)


def test_one_cause_less_is_fitted_where_it_was(problem):
    found = fitted_apart(problem, causes('mass', 'offset', 'gain'))
    problem.simulated.clear()
    fewer = fitted_without(problem, found, 1)
    assert [cause.name for cause in fewer.causes] == ['mass:x', 'gain:x']
    assert not problem.simulated[PLANT]
    together = fit_causes(problem, causes('mass', 'gain'))
    assert fewer.log_likelihood == pytest.approx(together.log_likelihood, abs=0.05)
    np.testing.assert_allclose(fewer.covariance, together.covariance, rtol=0.05, atol=1e-8)


def test_a_fit_in_parts_promises_what_they_do_together(problem):
    """What was fitted to its end promises next to nothing, also where a part was left as it was."""
    found = fitted_apart(problem, causes('mass', 'offset', 'gain'))
    assert 0.0 <= found.promised < ENOUGH
    fewer = fitted_without(problem, found, 2)
    assert 0.0 <= fewer.promised < 2.0 * ENOUGH
    assert evaluate(problem, causes('mass')).promised == math.inf


def test_a_rough_fit_is_brought_to_its_end(problem):
    rough = evaluate(problem, causes('offset', 'mass', 'gain'))
    found = refined(problem, rough)
    assert found.fits[PLANT] is rough.fits[PLANT]
    together = fit_causes(problem, causes('offset', 'gain'))
    assert found.causes[2].values['value'] == pytest.approx(
        together.causes[1].values['value'], abs=2e-3
    )


def test_the_whole_is_the_model_with_its_causes(problem):
    found = fitted_apart(problem, causes('offset', 'mass'))
    again = evaluate(problem, found.causes)
    for block, channels in again.residuals.items():
        np.testing.assert_array_equal(channels, found.residuals[block])
