# SPDX-License-Identifier: Apache-2.0
"""Two hypotheses are compared with the same noise models, whichever of theirs suits each better."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.estimation.hypothesis import Hypothesis, log_likelihood_ratio
from waferbot_twin.noise_model.prediction_error import Noise, likelihood, log_likelihoods_with

SEED = 20261125
PLANT, CONTROLLER = 'plant', 'controller'


def hypothesis(residual, noise_of=None, order=4, exact=None):
    """Return a hypothesis that leaves `residual`, with the noise model of another one if wanted."""
    residuals = {PLANT: [residual]}
    fits = {PLANT: likelihood([residual if noise_of is None else noise_of], [Noise(1e-9, order)])}
    if exact is not None:
        residuals[CONTROLLER] = [exact]
        fits[CONTROLLER] = likelihood([exact], [Noise(1e-3, 0)])
    return Hypothesis((), residuals, fits)


def coloured(random, pole, count=3000):
    return lfilter([1.0], [1.0, -pole], random.normal(size=count))


def test_another_noise_model_of_the_same_residual_is_no_reason():
    """A model does not win by the spectrum that was found beside it."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    residual = coloured(random, 0.9)
    suited = hypothesis(residual)
    unsuited = hypothesis(residual, noise_of=coloured(random, -0.5))
    right, wrong = (
        sum(log_likelihoods_with(one.fits[PLANT].colours, [residual]))
        for one in (suited, unsuited)
    )
    assert right > wrong + 100.0
    assert log_likelihood_ratio(suited, unsuited) == 0.0


def test_the_ratio_is_antisymmetric():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    one, two = (hypothesis(coloured(random, pole)) for pole in (0.5, 0.8))
    assert log_likelihood_ratio(one, two) == -log_likelihood_ratio(two, one) != 0.0


def test_of_a_residual_that_is_whiter_by_a_known_factor_it_is_n_times_its_logarithm():
    print(f'seed {SEED}')
    residual = coloured(np.random.default_rng(SEED), 0.7)
    half = hypothesis(0.5 * residual)
    found = log_likelihood_ratio(half, hypothesis(residual))
    assert found == pytest.approx(half.samples * np.log(2.0), rel=1e-9)


def test_exact_blocks_count_by_their_own_deviation_and_can_be_asked_alone():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    residual, exact = coloured(random, 0.7), random.normal(size=500)
    one = hypothesis(residual, exact=exact)
    other = hypothesis(residual, exact=3.0 * exact)
    expected = one.fits[CONTROLLER].log_likelihood - other.fits[CONTROLLER].log_likelihood
    assert log_likelihood_ratio(one, other) == pytest.approx(expected, rel=1e-12)
    assert log_likelihood_ratio(one, other, (PLANT,)) == 0.0


def test_each_channel_has_the_noise_that_suits_it():
    """What one channel gains from another noise model does not force that on its neighbour."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    noises = [Noise(1e-9, 4), Noise(1e-9, 4)]
    here, there = coloured(random, 0.9), coloured(random, 0.5)
    other = Hypothesis((), {PLANT: [here, there]}, {PLANT: likelihood([here, there], noises)})
    # It explains nine tenths of the first channel, and nothing of the second one, whose noise it takes
    # for another.
    elsewhere = likelihood([0.1 * here, coloured(random, -0.9)], noises)
    this = Hypothesis((), {PLANT: [0.1 * here, there]}, {PLANT: elsewhere})
    assert log_likelihood_ratio(this, other) == pytest.approx(2996 * np.log(10.0), rel=1e-6)
