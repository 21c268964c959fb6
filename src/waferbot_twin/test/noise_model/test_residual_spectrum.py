# SPDX-License-Identifier: Apache-2.0
"""The colour that an autoregression leaves, and how far it moves what is fitted."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.noise_model.prediction_error import Noise, fit, whitened
from waferbot_twin.noise_model.residual_spectrum import covariance, flattened, spectrum

SAMPLES = 3000
ORDER = 8


def test_a_slow_colour_that_an_autoregression_misses_is_taken_out():
    random = np.random.default_rng(7)
    slow = lfilter([0.005], [1.0, -0.995], random.normal(size=40000))
    noise_of_both = random.normal(size=40000) + 3.0 * slow
    power = spectrum(noise_of_both)
    expected = (
        1.0
        + (3.0 * 0.005) ** 2
        / np.abs(1.0 - 0.995 * np.exp(-2j * np.pi * np.fft.rfftfreq(40000))) ** 2
    )
    middle = slice(20, None)
    assert np.median(power[middle] / expected[middle]) == pytest.approx(1.0, abs=0.03)
    flat = np.abs(np.fft.rfft(flattened(noise_of_both, power))) ** 2 / 40000
    assert flat[1:60].mean() == pytest.approx(1.0, abs=0.3)


def log_with(random, slow):
    """Return noise that an autoregression of this order can make white, and one that it does not see."""
    quick = lfilter([1.0], [1.0, -0.7], random.normal(size=SAMPLES))
    unseen = lfilter([slow * 0.005], [1.0, -0.995], random.normal(size=SAMPLES + 5000))
    return quick + unseen[5000:]


def scores(slow, periods, draws):
    """Return by how many standard errors, of the fit and of `covariance`, estimates are off."""
    seed = 20261127
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    time = np.arange(SAMPLES) / SAMPLES
    signatures = np.column_stack(
        [np.cos(2.0 * np.pi * periods * time), random.normal(size=SAMPLES)]
    )
    usual, better = [], []
    for _ in range(draws):
        channels = [log_with(random, slow)]
        found = fit(channels, [signatures], [Noise(1e-9, ORDER)])
        system, _ = whitened(channels, [signatures], found.colours)
        usual.append(found.value / np.sqrt(np.diag(found.covariance)))
        better.append(found.value / np.sqrt(np.diag(covariance(system, found))))
    return np.sqrt(np.mean(np.square(usual), axis=0)), np.sqrt(np.mean(np.square(better), axis=0))


def test_errors_are_as_large_as_estimates_scatter_also_where_noise_is_slow():
    usual, better = scores(slow=20.0, periods=4, draws=300)
    print(usual, better)
    assert usual[0] > 1.4
    assert better[0] == pytest.approx(1.0, abs=0.15)
    assert better[1] == pytest.approx(1.0, abs=0.1)


def test_what_shows_only_in_the_very_lowest_lines_is_still_known_less_well_than_it_seems():
    usual, better = scores(slow=10.0, periods=2, draws=300)
    print(usual, better)
    assert 1.2 < better[0] < 0.75 * usual[0]


def test_errors_are_those_of_the_fit_where_the_noise_is_as_assumed():
    usual, better = scores(slow=0.0, periods=6, draws=300)
    print(usual, better)
    assert usual == pytest.approx([1.0, 1.0], abs=0.12)
    assert better == pytest.approx(usual, rel=0.15)
    assert (better <= usual * (1.0 + 1e-9)).all()
