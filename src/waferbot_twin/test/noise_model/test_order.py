# SPDX-License-Identifier: Apache-2.0
"""The order of an autoregression is how far back it looks: neither less nor more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.noise_model.prediction_error import Noise, autoregression, fit

SEED = 20261125
LAG = 5


def remembers_one_lag(size: int = 40000) -> np.ndarray:
    """x[n] = 0.8 x[n - 5] + e[n]: nothing nearer than five samples tells anything."""
    random = np.random.default_rng(SEED)
    return lfilter([1.0], [1.0, *[0.0] * (LAG - 1), -0.8], random.normal(size=size))


@pytest.mark.parametrize('order', [1, LAG - 1, LAG, LAG + 1, 2 * LAG])
def test_it_has_as_many_taps_and_finds_a_memory_that_is_within_reach(order):
    process = remembers_one_lag()
    taps = autoregression(process, order)
    assert len(taps) == order + 1
    told = 0.8 if order >= LAG else 0.0
    left = np.var(np.convolve(process, taps, 'valid'))
    assert left == pytest.approx(np.var(process) * (1.0 - told**2), rel=0.03)
    expected = np.zeros(order + 1)
    expected[0] = 1.0
    if order >= LAG:
        expected[LAG] = -0.8
    np.testing.assert_allclose(taps, expected, atol=0.03)


@pytest.mark.parametrize('order', [0, LAG - 1, LAG, 3 * LAG])
def test_a_fit_filters_with_that_order_and_loses_as_many_samples(order):
    process = remembers_one_lag(4000)
    shape = np.cos(np.arange(4000) / 7.0)
    result = fit([process], [shape[:, None]], [Noise(1e-9, order)])
    (colour,) = result.colours
    assert colour.error.order == order
    assert len(colour.error([process], 0)) == len(process) - order
    deviation = np.std(process) * (1.0 if order < LAG else 0.6)
    assert colour.deviation == pytest.approx(deviation, rel=0.05)
