# SPDX-License-Identifier: Apache-2.0
"""The finite filter, against numpy's."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.noise_model.fir_filter import filtered


@pytest.mark.parametrize('taps', [1, 2, 25])
@pytest.mark.parametrize('samples', [25, 26, 1000])
def test_it_is_the_convolution_column_by_column(taps, samples):
    random = np.random.default_rng(33)
    weights, channel = random.normal(size=taps), random.normal(size=(samples, 3))
    expected = np.column_stack([np.convolve(column, weights, 'valid') for column in channel.T])
    np.testing.assert_allclose(filtered(weights, channel), expected, rtol=0.0, atol=1e-13)
    np.testing.assert_array_equal(
        filtered(weights, channel[:, 1]), filtered(weights, channel)[:, 1]
    )


def test_of_less_than_its_length_nothing_is_left():
    assert filtered(np.ones(5), np.ones(4)).shape == (0,)
    assert filtered(np.ones(5), np.ones((3, 2))).shape == (0, 2)
