# SPDX-License-Identifier: Apache-2.0
"""Counter-based noise: known values, moments, distribution, independence, order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from waferbot_lockstep import noise
from waferbot_lockstep.compiled import compiled

MANY = 200_000
MASK = 2**64 - 1


@compiled
def fill(kind, seed, channel, first, values):
    for place in range(len(values)):
        if kind == 0:
            values[place] = noise.uniform(seed, channel, first + place)
        else:
            values[place] = noise.normal(seed, channel, first + place)


def series(kind: int, seed: int, channel: int, first: int = 0, count: int = MANY) -> np.ndarray:
    values = np.empty(count)
    fill(kind, seed, channel, first, values)
    return values


def split_mix_64(state: int) -> tuple[int, int]:
    """Return (next state, output) of the published generator, in Python's whole numbers."""
    state = (state + 0x9E3779B97F4A7C15) & MASK
    word = state
    word = ((word ^ (word >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    word = ((word ^ (word >> 27)) * 0x94D049BB133111EB) & MASK
    return state, word ^ (word >> 31)


def test_published_values_of_split_mix() -> None:
    """The first outputs of SplitMix64 with seed 1234567, as its reference implementation's."""
    state = 1234567
    found = []
    for _ in range(3):
        state, word = split_mix_64(state)
        found.append(word)
    assert found == [6457827717110365317, 3203168211198807973, 9817491932198370423]


@pytest.mark.parametrize('seed', [0, 1, -1, 2**62, -(2**63)])
@pytest.mark.parametrize('channel', [0, 3, -7])
@pytest.mark.parametrize('counter', [0, 1, 10**12, -5])
def test_hash_is_that_of_whole_number_arithmetic(seed: int, channel: int, counter: int) -> None:
    golden = 0x9E3779B97F4A7C15
    _, seeded = split_mix_64(seed & MASK)
    _, key = split_mix_64((seeded + channel * golden - golden) & MASK)
    _, expected = split_mix_64((key + counter * golden - golden) & MASK)
    assert int(noise.hashed(seed, channel, counter)) == expected
    assert noise.uniform(seed, channel, counter) == (expected >> 11) / 2**53


def test_any_order_gives_the_same_bits() -> None:
    forward = series(1, 5, 2, count=1000)
    assert np.array_equal(series(1, 5, 2, first=400, count=100), forward[400:500])
    assert noise.normal(5, 2, 999) == forward[999]
    assert noise.normal(5, 2, 0) == forward[0]


def test_uniform_moments_and_distribution() -> None:
    values = series(0, 11, 4)
    assert 0.0 <= values.min() < 1e-4 < 1.0 - 1e-4 < values.max() < 1.0
    assert abs(values.mean() - 0.5) < 4.0 * (1 / 12 / MANY) ** 0.5
    assert stats.kstest(values, 'uniform').pvalue > 1e-3


def test_normal_moments() -> None:
    """Mean, deviation, skewness, kurtosis within four of their standard errors."""
    values = series(1, 11, 4)
    assert abs(values.mean()) < 4.0 * MANY**-0.5
    assert abs(values.std() - 1.0) < 4.0 * (2 * MANY) ** -0.5
    assert abs(stats.skew(values)) < 4.0 * (6 / MANY) ** 0.5
    assert stats.kurtosis(values) == pytest.approx(-0.1, abs=4.0 * (24 / MANY) ** 0.5)
    assert np.abs(values).max() <= 6.0


def test_normal_distribution_function_is_within_what_the_docstring_says() -> None:
    values = np.sort(series(1, 12, 0, count=10 * MANY))
    levels = np.linspace(-3.0, 3.0, 61)
    found = np.searchsorted(values, levels) / len(values)
    assert np.abs(found - stats.norm.cdf(levels)).max() < 0.003


@pytest.mark.parametrize('kind', [0, 1])
def test_no_correlation_in_time_between_channels_or_seeds(kind: int) -> None:
    values = series(kind, 3, 7)
    others = {
        'next sample': series(kind, 3, 7, first=1),
        'three samples on': series(kind, 3, 7, first=3),
        'next channel': series(kind, 3, 8),
        'next seed': series(kind, 4, 7),
        'channel and seed swapped': series(kind, 7, 3),
    }
    for name, other in others.items():
        correlation = np.corrcoef(values, other)[0, 1]
        assert abs(correlation) < 4.0 * MANY**-0.5, name


@pytest.mark.parametrize('kind', [0, 1])
def test_spectrum_is_white(kind: int) -> None:
    """Bartlett: power in eight equal bands, each within four standard errors of the mean."""
    values = series(kind, 21, 1, count=2**17)
    power = np.abs(np.fft.rfft(values - values.mean())[1:-1]) ** 2
    bands = np.array([band.mean() for band in np.array_split(power, 8)]) / power.mean()
    assert np.abs(bands - 1.0).max() < 4.0 * (8 / len(power)) ** 0.5


def test_every_bit_of_the_counter_turns_over_half_the_bits() -> None:
    """Avalanche: one bit in, 32 of 64 bits out on average, over 200 counters."""
    for bit in range(0, 62):
        turned = [
            (int(noise.hashed(1, 2, counter)) ^ int(noise.hashed(1, 2, counter ^ (1 << bit))))
            for counter in range(200)
        ]
        mean = np.mean([word.bit_count() for word in turned])
        assert abs(mean - 32.0) < 5.0 * 4.0 / 200**0.5, bit
