# SPDX-License-Identifier: Apache-2.0
"""How much more logs speak for one set of causes than for another, against closed forms."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.evidence import gain, log_occam
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.problem import PLANT, Cause

SEED = 20261212
SCALES = (0.1, 0.3, 1.0, 3.0)


def leaving(*channels, order=8, floor=1e-6):
    """Return a hypothesis that leaves these residuals over."""
    noises = [Noise(floor, order)] * len(channels)
    return Hypothesis((), {PLANT: list(channels)}, {PLANT: likelihood(channels, noises)})


def cause(**values):
    return Cause(SimpleNamespace(name='some'), 'x_rotate', values)


def size(name='size', typical=2.0, neutral=0.0):
    return Parameter(name, '', neutral, typical, -1e9, 1e9, '')


def shape(low, high, name='shape'):
    return Parameter(name, '', 0.0, low, low, high, '', shape=True)


# Gain


def test_an_exact_block_gains_half_of_what_its_squares_fall_by():
    """Where nothing but the floor is: a channel of order zero, here of a floor of 0.5."""
    random = np.random.default_rng(SEED)
    left, before = (scale * random.normal(size=500) for scale in (0.1, 3.0))
    more, fewer = (leaving(one, order=0, floor=0.5) for one in (left, before))
    expected = 0.5 * (before @ before - left @ left) / 0.25
    assert gain(more, fewer) == pytest.approx(expected)
    assert gain(leaving(left, order=0, floor=5.0), leaving(before, order=0, floor=5.0)) < expected


@pytest.mark.parametrize('change', [0.02, 0.2, 2.0])
@pytest.mark.parametrize('colour', [0.0, 0.9])
def test_seen_from_the_other_side_the_gain_is_a_loss(colour, change):
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    shaken = np.convolve(random.normal(size=2400), colour ** np.arange(60.0), 'valid')
    other = shaken + change * np.sin(np.linspace(0.0, 40.0, len(shaken)))
    one, two = leaving(shaken), leaving(other)
    assert gain(one, two) == -gain(two, one)
    assert gain(one, one) == 0.0


def test_causes_on_two_axes_are_ahead_of_one_another_by_what_each_gains_on_its_own():
    """What the one leaves over on the other's axis is no noise for the other one to be hidden in."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    noise = random.normal(size=(2, 2400))
    of_one, of_other = 0.5 * np.sin(np.outer([0.3, 0.2], np.arange(2400.0)))
    neither = leaving(noise[0] + of_one, noise[1] + 3.0 * of_other)
    first = leaving(noise[0], noise[1] + 3.0 * of_other)
    second = leaving(noise[0] + of_one, noise[1])
    apart = gain(second, neither) - gain(first, neither)
    assert apart > 10.0
    assert gain(second, first) == pytest.approx(apart)


def test_noise_gains_nothing_and_a_cause_as_much_as_its_squares():
    """Of white noise ln L falls by |d|^2 / 2 s^2 without what is there: here by 100."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    change = np.sin(np.linspace(0.0, 80.0, 4000))
    change *= math.sqrt(200.0 / (change @ change))
    white = random.normal(size=(40, 4000))
    gains = [gain(leaving(one, order=2), leaving(one + change, order=2)) for one in white]
    # Student's t of 16 degrees of freedom: 8.5 ln(1 + 200 / 16), with the scatter of its power.
    expected = 8.5 * math.log1p(200.0 / 16.0)
    assert np.mean(gains) == pytest.approx(expected, rel=0.1)


# Occam's factor


@given(
    value=st.floats(-20.0, 20.0),
    error=st.floats(1e-3, 50.0),
    typical=st.floats(0.1, 10.0),
)
def test_of_one_parameter_it_is_the_ratio_of_two_integrals(value, error, typical):
    """Bayes factor of a normal likelihood in a mixture of normal priors, over its largest value."""
    found = log_occam(cause(size=value), [size(typical=typical)], np.array([[error**-2]]), SCALES)
    marginal = [norm(0.0, math.hypot(error, s * typical)).logpdf(value) for s in SCALES]
    expected = logsumexp(marginal) - math.log(len(SCALES)) - norm(value, error).logpdf(value)
    assert found == pytest.approx(expected, abs=1e-6)


def test_of_several_parameters_it_is_that_of_their_joint_distribution():
    spread = np.array([[0.5, 0.3], [0.3, 0.4]])
    own = [size('a', 2.0), size('b', 3.0, neutral=1.0)]
    found = log_occam(cause(a=1.5, b=2.0), own, np.linalg.inv(spread), [1.0])
    prior = spread + np.diag([2.0**2, (3.0 - 1.0) ** 2])
    expected = multivariate_normal([0.0, 1.0], prior).logpdf([1.5, 2.0])
    expected -= multivariate_normal([1.5, 2.0], spread).logpdf([1.5, 2.0])
    assert found == pytest.approx(expected)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=4),
    errors=st.lists(st.floats(1e-6, 1e4), min_size=4, max_size=4),
    seed=st.integers(0, 10**6),
)
def test_a_cause_never_profits_from_having_parameters(values, errors, seed):
    random = np.random.default_rng(seed)
    count = len(values)
    mix = random.normal(size=(count, count)) * np.array(errors[:count])[:, None]
    names = [f'p{number}' for number in range(count)]
    own = [size(name, random.uniform(0.1, 10.0)) for name in names]
    found = log_occam(
        cause(**dict(zip(names, values, strict=True))), own, np.linalg.pinv(mix @ mix.T), SCALES
    )
    assert found <= 1e-6


@settings(max_examples=40, deadline=None)
@given(error=st.floats(1e-4, 1.0), factor=st.floats(2.0, 100.0))
def test_what_the_logs_know_better_is_paid_for_and_so_is_a_size_that_is_not_usual(error, factor):
    def of(value, deviation):
        return log_occam(cause(size=value), [size()], np.array([[deviation**-2]]), SCALES)

    assert of(2.0, error / factor) < of(2.0, error)
    assert of(20.0 * factor, error) < of(2.0, error)
    assert of(20.0, error) == pytest.approx(of(-20.0, error))


@settings(max_examples=40, deadline=None)
@given(error=st.floats(1e-4, 1e-1), range_=st.floats(1.0, 8.0))
def test_a_shape_parameter_pays_for_its_range(error, range_):
    """Uniform over its range: the width is that over the square root of 12."""

    def of(high):
        known = np.array([[error**-2]])
        return log_occam(cause(shape=0.5), [shape(-1.0, high)], known, SCALES)

    expected = -0.5 * math.log1p((1.0 + range_) ** 2 / 12.0 / error**2)
    assert of(range_) == pytest.approx(expected)
    assert of(2.0 * range_) < of(range_)


def test_a_shape_over_decades_pays_for_its_ratio_not_its_difference():
    known = np.array([[0.01**-2]])
    found = log_occam(cause(shape=5.0), [shape(1.0, 1000.0)], known, SCALES)
    width = 5.0 * math.log(1000.0) / math.sqrt(12.0)
    assert found == pytest.approx(-0.5 * math.log1p(width**2 / 0.01**2))


def test_what_logs_do_not_say_costs_nothing():
    """Two sizes of which they know the sum alone cost what one does whose prior is that of the sum."""
    error, wave = 0.02, np.array([[1.0, 1.0], [1.0, 1.0]])
    both = [size('a', 1.0), size('b', 1.0)]
    found = log_occam(cause(a=1.5, b=1.5), both, wave / error**2, SCALES)
    one = log_occam(
        cause(size=3.0), [size(typical=math.sqrt(2.0))], np.array([[error**-2]]), SCALES
    )
    assert found == pytest.approx(one, abs=1e-6)


def test_without_parameters_there_is_nothing_to_pay():
    assert log_occam(cause(), [], np.zeros((0, 0)), SCALES) == 0.0
