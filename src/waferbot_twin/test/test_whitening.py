# SPDX-License-Identifier: Apache-2.0
"""Least squares with coloured residuals, against processes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.diagnosis.whitening import autoregression, fit

SEED = 20261121


def coloured(random: np.random.Generator, size: int, pole: float) -> np.ndarray:
    return lfilter([1.0], [1.0, -pole], random.normal(size=size + 500))[500:]


@pytest.mark.parametrize('coefficients', [(0.9,), (1.6, -0.8), (0.5, 0.2, 0.1)])
def test_autoregression_finds_the_coefficients_of_a_process(coefficients):
    random = np.random.default_rng(SEED)
    process = lfilter([1.0], [1.0, *(-c for c in coefficients)], random.normal(size=60000))
    taps = autoregression(process, len(coefficients))
    assert taps[0] == 1.0
    assert -taps[1:] == pytest.approx(coefficients, abs=0.02)


def test_a_residual_of_zeros_has_a_filter():
    assert autoregression(np.zeros(100), 5).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_order_zero_leaves_the_residual_as_it_is():
    assert autoregression(np.arange(10.0), 0).tolist() == [1.0]


@pytest.mark.parametrize('pole', [0.0, 0.7, 0.97])
def test_interval_covers_the_truth_and_is_as_wide_as_the_scatter(pole):
    """Many noises on one signature: 95 % intervals hold, errors scatter as the covariance says."""
    random = np.random.default_rng(SEED)
    shape = np.sign(np.sin(np.linspace(0.0, 40.0, 4000)))
    truth, errors, inside = 0.3, [], 0
    for _ in range(80):
        residual = coloured(random, 4000, pole) - truth * shape
        result = fit([residual], [shape[:, None]], [1e-9], [4])
        deviation = np.sqrt(result.covariance[0, 0])
        errors.append((result.value[0] - truth) / deviation)
        inside += abs(errors[-1]) < 1.96
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)
    assert inside >= 68  # 95 % of 80 is 76; fewer than 69 has a probability of 1e-3


def test_white_least_squares_would_be_far_too_sure_of_coloured_noise():
    """Why there is whitening at all: the same noise taken as white."""
    random = np.random.default_rng(SEED)
    slow = np.sin(np.linspace(0.0, 12.0, 4000))
    white, coloured_gain = [], []
    for _ in range(40):
        residual = coloured(random, 4000, 0.97)
        for order, gains in ((0, white), (4, coloured_gain)):
            with_it = fit([residual], [slow[:, None]], [1e-9], [order])
            without = fit([residual], [np.zeros((4000, 0))], [1e-9], [order])
            gains.append(2.0 * (with_it.log_likelihood - without.log_likelihood))
    assert np.median(coloured_gain) < 2.0  # chi squared of one degree of freedom: 0.45
    assert np.median(white) > 10.0


def test_floor_bounds_the_likelihood_of_a_perfect_fit():
    shape = np.cos(np.arange(500.0))
    result = fit([-2.0 * shape], [shape[:, None]], [0.01], [0])
    assert result.value[0] == pytest.approx(2.0)
    assert result.log_likelihood == pytest.approx(-500 * (np.log(0.01) - 0.5))
    assert result.deviations == (0.01,)
