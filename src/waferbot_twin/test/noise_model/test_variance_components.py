# SPDX-License-Identifier: Apache-2.0
"""Noise with possible spectra only: variances are those of known noise, and its filter whitens it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.noise_model.motion_basis import motion_basis
from waferbot_twin.noise_model.variance_components import (
    COLOURED_HZ,
    Shapes,
    bands,
    lines_of,
    powers_left,
    prediction_filter,
    variances,
)

SEED = 20261210
RATE_HZ, OBSERVER_HZ, DAMPING = 2250.0, 80.0, 0.7
READING, INNOVATION = 0, 1
FORCE = 2 + COLOURED_HZ.index(10.0)
"""Places of the shapes."""


def shapes(motion=None, count=4500):
    basis = np.zeros((count, 0)) if motion is None else motion
    return Shapes(RATE_HZ, OBSERVER_HZ, DAMPING, basis, COLOURED_HZ)


def noise_of(random, weights, count=4500):
    """Return noise with these variances: normal lines of the spectrum, transformed back."""
    power = weights @ shapes().at(np.fft.rfftfreq(count, 1.0 / RATE_HZ))
    lines = random.normal(size=(2, len(power))) @ np.diag(np.sqrt(0.5 * power * count))
    lines[1, [0, -1]] = 0.0
    return np.fft.irfft(lines[0] + 1j * lines[1], count)


def weights_of(**parts):
    found = np.zeros(2 + len(COLOURED_HZ))
    for name, value in parts.items():
        found[{'reading': READING, 'white': INNOVATION, 'force': FORCE}[name]] = value
    return found


def test_every_shape_has_a_mean_of_one_over_the_band():
    """Of a force up to 10 Hz within what a grid of frequencies 1.1 Hz apart tells."""
    each = shapes().at(np.linspace(0.0, 0.5 * RATE_HZ, 40001))
    assert each.mean(axis=1) == pytest.approx(np.ones(len(each)), rel=0.05)


def test_every_line_is_in_a_band_and_bands_grow():
    band = bands(22500)
    sizes = np.bincount(band)
    assert sizes.sum() == 22500
    assert np.all(np.diff(band) >= 0)
    assert sizes[0] == 1
    assert sizes[-2] > sizes[-20] > 1


@pytest.mark.parametrize(
    'parts',
    [
        {'white': 1.0},
        {'reading': 2.0},
        {'white': 0.5, 'force': 3.0},
        {'reading': 1.0, 'force': 40.0},
        {'reading': 0.7, 'white': 0.3, 'force': 5.0},
    ],
)
def test_the_spectrum_that_is_found_is_that_of_the_noise(parts):
    """
    In the mean of 20 logs, within four standard errors of that mean and a share of the truth.

    Shapes overlap, so not their variances are compared but their sum. The steps that raise the
    likelihood end before the last of what is slow: there a fifth may lack, else a twentieth.
    """
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    true = weights_of(**parts)
    frequency_hz = np.geomspace(5.0, 1100.0, 40)
    grid = shapes().at(frequency_hz)
    found = [variances(noise_of(random, true), shapes()) @ grid for _ in range(20)]
    error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    share = np.where(frequency_hz < OBSERVER_HZ, 0.2, 0.05)
    off = np.abs(np.mean(found, axis=0) - true @ grid)
    assert np.all(off < 4.0 * error + share * (true @ grid))


@pytest.mark.parametrize('parts', [{'white': 1.0}, {'reading': 1.0, 'white': 0.001}])
def test_what_the_motion_takes_from_noise_is_not_missed_in_its_power(parts):
    """Eleven slow columns in a second: most of what is below 10 Hz is in their span."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    count, weights = 2250, weights_of(**parts)
    time_s = np.arange(count) / RATE_HZ
    slow = np.column_stack([np.cos(np.pi * order * time_s) for order in range(11)])
    motion = shapes(np.linalg.qr(slow)[0]).motion_lines(count)
    true = weights @ shapes().on_lines(count)
    powers = []
    for _ in range(400):
        lines = lines_of(noise_of(random, weights, count))
        power, kept = powers_left(lines, motion, true)
        powers.append(power)
    band = bands(len(true))
    kept = np.bincount(band, kept)
    share = np.bincount(band, np.mean(powers, axis=0) / true) / kept
    assert kept[0] < 0.5
    assert np.all(np.abs(share - 1.0) < 6.0 / np.sqrt(len(powers) * np.maximum(kept, 0.1)))


def test_strong_noise_of_readings_hides_no_weak_noise_where_the_axis_moves():
    """A column of the motion that has high frequencies, too: unweighted it follows the readings."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    count, weights = 4500, weights_of(reading=1.0, white=1e-4)
    time_s = np.arange(count) / RATE_HZ
    rough = random.normal(size=(count, 3)).cumsum(axis=0)
    columns = np.column_stack(
        [np.cos(2.0 * np.pi * time_s), rough / np.linalg.norm(rough, axis=0)]
    )
    basis, _ = np.linalg.qr(columns)
    frequency_hz = np.geomspace(1.0, 10.0, 10)
    grid = shapes().at(frequency_hz)
    found = np.mean(
        [
            variances(noise_of(random, weights, count) + 5.0 * basis[:, 0], shapes(basis)) @ grid
            for _ in range(20)
        ],
        axis=0,
    )
    assert np.all(found < 2.0 * weights @ grid)
    assert np.all(found > 0.5 * weights @ grid)


def test_of_noise_of_readings_alone_the_variance_is_theirs():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    true = weights_of(reading=2.0)
    found = np.mean([variances(noise_of(random, true), shapes()) for _ in range(20)], axis=0)
    assert found[READING] == pytest.approx(2.0, abs=0.05)
    assert found[1:].max() < 0.01


@pytest.mark.parametrize('parts', [{'white': 1.0}, {'reading': 1.0}, {'white': 0.2, 'force': 9.0}])
def test_the_prediction_filter_makes_the_noise_white(parts):
    """Correlations of what is left, up to the order, are those of white noise."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    count, order = 45000, 24
    noise = noise_of(random, weights_of(**parts), count)
    taps = prediction_filter(noise, order, shapes(count=0))
    assert taps[0] == 1.0
    left = lfilter(taps, 1.0, noise)[order:]
    correlation = [left[lag:] @ left[:-lag] / (left @ left) for lag in range(1, order + 1)]
    assert np.abs(correlation).max() < 5.0 / np.sqrt(count) + 0.02
    assert left.std() < noise.std() * 1.001


def test_what_goes_with_the_motion_is_not_taken_for_noise():
    """A large friction that the model lacks: the filter is about that of the noise alone."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    time_s = np.arange(4500) / RATE_HZ
    position = 1e4 * np.sin(2.0 * np.pi * 1.5 * time_s)
    noise = noise_of(random, weights_of(white=1.0, reading=1.0))
    wrong = noise + 30.0 * np.sign(np.cos(2.0 * np.pi * 1.5 * time_s))
    basis = motion_basis(position)
    alone = prediction_filter(noise, 24, shapes(basis))
    with_it, taken_for_noise = (
        prediction_filter(wrong, 24, one) for one in (shapes(basis), shapes())
    )
    assert np.linalg.norm(with_it - alone) < 0.3 * np.linalg.norm(taken_for_noise - alone)


def test_a_residual_of_zeros_has_a_filter():
    taps = prediction_filter(np.zeros(4500), 24, shapes())
    assert taps[0] == 1.0
    assert np.isfinite(taps).all()
