# SPDX-License-Identifier: Apache-2.0
"""The prior of sizes in a fit, against its density and against a general optimiser."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.special import logsumexp
from scipy.stats import norm

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import standard_errors
from waferbot_twin.estimation.size_prior import (
    information_of_logs,
    log_prior,
    posterior_covariance,
    precision,
)
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import PLANT, Cause

SEED = 20261126
SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)
TYPICAL = (2.0, 0.5, 30.0)
FLOOR = 0.1
"""Standard deviation of the noise of an exact block: known, so that nothing but the prior is in play."""


class Effect:
    """An effect with as many sizes as it has signals, and one shape."""

    def __init__(self, name, signals, typical=TYPICAL):
        self.name, self.signals = name, signals
        self._parameters = (
            *(
                Parameter(f'size_{number}', '', 1.0, 1.0 + own, -1e9, 1e9, '')
                for number, own in enumerate(typical[: len(signals)])
            ),
            Parameter('shape', '', 0.0, 5.0, 0.0, 10.0, '', shape=True),
        )

    def parameters(self, variant, axis):
        return self._parameters

    def apply(self, variant, axis, values):
        return [
            *variant,
            *(values[f'size_{n}'] - 1.0 for n, _ in enumerate(self.signals)),
        ]


class Sum:
    """A problem whose plant is a sum of signals, in noise of a known deviation."""

    def __init__(self, measured, signals, scales=SCALES):
        self.nominal, self.measured, self.signals = [], measured, signals
        self.blocks, self.size_scales = {PLANT: [None]}, scales

    def touched(self, effect, axis):
        return (PLANT,)

    def sized_by_log(self, effect, axis):
        return False

    def between(self, one, other):
        return (PLANT,)

    def residuals(self, variant, block, workers=1):
        return [self.measured - np.array(variant) @ self.signals]

    def noises(self, block):
        return [Noise(FLOOR, 0)]

    def judge(self, residuals):
        return {PLANT: likelihood(residuals[PLANT], self.noises(PLANT))}


def cause(*sizes):
    effect = Effect('some', [None] * len(sizes))
    values = {f'size_{n}': 1.0 + size for n, size in enumerate(sizes)}
    return Cause(effect, 'x', {**values, 'shape': 5.0}, ('shape',))


PROBLEM = SimpleNamespace(
    nominal=None, size_scales=SCALES, sized_by_log=lambda effect, axis: False
)
SIZES = st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=3)


@given(one=SIZES, factor=st.floats(0.01, 10.0), by_log=st.booleans())
def test_the_density_is_a_mixture_of_normal_ones(one, factor, by_log):
    """With wider ones where the typical size follows from currents that may be next to none."""
    scales = (*SCALES, 30.0, 100.0) if by_log else SCALES
    problem = SimpleNamespace(
        nominal=None,
        size_scales=SCALES,
        unrated_scales=(30.0, 100.0),
        sized_by_log=lambda effect, axis: by_log,
    )

    def density(sizes):
        terms = [
            sum(norm(0.0, s * own).logpdf(w) for w, own in zip(sizes, TYPICAL, strict=False))
            for s in scales
        ]
        return logsumexp(terms) - math.log(len(scales))

    other = [factor * size for size in one]
    found = log_prior(problem, [cause(*one)]) - log_prior(problem, [cause(*other)])
    assert found == pytest.approx(density(one) - density(other), abs=1e-9)


@given(sizes=SIZES)
def test_the_precision_is_the_slope_of_the_density_over_the_size(sizes):
    own = precision(PROBLEM, cause(*sizes))
    for place, size in enumerate(sizes):
        step = 1e-5 * (abs(size) + 0.01)
        there, here = (
            log_prior(PROBLEM, [cause(*sizes[:place], size + move, *sizes[place + 1 :])])
            for move in (step, -step)
        )
        slope = -own[place] * size
        assert (there - here) / (2.0 * step) == pytest.approx(slope, rel=1e-3, abs=1e-3)


def test_without_scales_and_of_a_shape_there_is_no_prior():
    nothing = SimpleNamespace(nominal=None, size_scales=())
    assert log_prior(nothing, [cause(3.0)]) == 0.0
    assert not precision(nothing, cause(3.0)).any()
    some = cause(3.0)
    shape_too = Cause(some.effect, 'x', some.values)
    assert precision(PROBLEM, shape_too)[1] == 0.0
    assert precision(PROBLEM, shape_too)[0] > 0.0


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 4))
def test_a_prior_can_be_added_to_what_logs_say_and_taken_out_again(seed, count):
    random = np.random.default_rng(seed)
    units = 10.0 ** random.uniform(-6.0, 6.0, count)
    mix = random.standard_normal((count, count + 2))
    known = mix @ mix.T / np.outer(units, units)
    prior = 10.0 ** random.uniform(-3.0, 3.0, count) / units**2
    both = posterior_covariance(known, prior)
    expected = np.linalg.inv(known * np.outer(units, units) + np.diag(prior * units**2))
    assert both / np.outer(units, units) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    again = information_of_logs(both, prior)
    assert again * np.outer(units, units) == pytest.approx(
        known * np.outer(units, units), rel=1e-3, abs=1e-4
    )


def test_what_logs_do_not_say_has_the_variance_of_its_prior():
    """Logs know the sum of two sizes to a thousandth, and nothing of their difference."""
    known, prior = 1e6 * np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 1.0])
    found = posterior_covariance(known, prior)
    difference = np.array([1.0, -1.0])
    assert difference @ found @ difference == pytest.approx(2.0, rel=1e-6)
    assert np.ones(2) @ found @ np.ones(2) == pytest.approx(1e-6, rel=1e-3)
    assert information_of_logs(found, prior) == pytest.approx(known, rel=1e-3)


def test_what_the_logs_know_only_as_a_sum_is_shared_and_does_not_run_away():
    """The most probable sizes, against a general optimiser of likelihood times prior."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    first, third = random.standard_normal((2, 300))
    signals = np.array([first, first + 1e-3 * random.standard_normal(300), third])
    measured = np.array([1.5, 0.0, 20.0]) @ signals + FLOOR * random.standard_normal(300)
    one, two = Effect('one', signals[:2]), Effect('two', signals[2:], TYPICAL[2:])
    causes = (
        Cause(one, 'x', {'size_0': 1.0, 'size_1': 1.0, 'shape': 5.0}, ('shape',)),
        Cause(two, 'x', {'size_0': 1.0, 'shape': 5.0}, ('shape',)),
    )
    problem = Sum(measured, signals)
    found = fit_causes(problem, causes, rounds=60, enough=1e-9)
    sizes = [found.causes[0].values[f'size_{n}'] - 1.0 for n in range(2)]
    sizes.append(found.causes[1].values['size_0'] - 1.0)

    def cost(w):
        left = measured - w @ signals
        prior = log_prior(problem, [cause(w[0], w[1])])
        alone = Cause(two, 'x', {'size_0': 1.0 + w[2], 'shape': 5.0}, ('shape',))
        return 0.5 * left @ left / FLOOR**2 - prior - log_prior(problem, [alone])

    truth = minimize(
        cost,
        [1.0, 0.2, 20.0],
        method='Nelder-Mead',
        options={'xatol': 1e-9, 'fatol': 1e-9, 'maxiter': 20000, 'maxfev': 20000},
    ).x
    assert sizes == pytest.approx(truth, rel=1e-2, abs=1e-2)
    assert sum(sizes[:2]) == pytest.approx(1.5, abs=0.02)
    free = fit_causes(Sum(measured, signals, ()), causes, rounds=60, enough=1e-9)
    errors, without = standard_errors(found), standard_errors(free)
    assert without[0] > 3.0 * errors[0]
    assert errors[2] == pytest.approx(without[2], rel=0.01)
