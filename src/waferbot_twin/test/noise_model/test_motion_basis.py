# SPDX-License-Identifier: Apache-2.0
"""What wrong models leave over goes with the motion, and noise does not."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.noise_model.motion_basis import FEWEST, motion_basis

SEED = 20261211
RATE_HZ, COUNT = 1000.0, 4000
TIME_S = np.arange(COUNT) / RATE_HZ


def motion():
    """Return position, speed and acceleration of an axis, of two sines and a slow drift."""
    sines = ((0.05, 1.3, 0.2), (0.02, 3.1, 1.0), (0.08, 0.4, 2.0))
    phase = [2.0 * np.pi * hertz * TIME_S + angle for _, hertz, angle in sines]
    rates = [2.0 * np.pi * hertz for _, hertz, _ in sines]
    sizes = [size for size, _, _ in sines]
    position = sum(a * np.sin(p) for a, p in zip(sizes, phase, strict=True))
    speed = sum(a * w * np.cos(p) for a, w, p in zip(sizes, rates, phase, strict=True))
    acceleration = sum(-a * w * w * np.sin(p) for a, w, p in zip(sizes, rates, phase, strict=True))
    return position, speed, acceleration


POSITION, SPEED, ACCELERATION = motion()
COUNTS = np.rint(1e6 * POSITION)

SMOOTH, STEPS = 0.005, 0.04
LEFT_OVER = {
    'inertia': (ACCELERATION, SMOOTH),
    'viscous friction': (SPEED, SMOOTH),
    'a spring or gravity by position': (POSITION, SMOOTH),
    'gravity of another mass': (np.ones(COUNT), SMOOTH),
    'drag of the square of the speed': (SPEED * np.abs(SPEED), SMOOTH),
    'Coulomb friction': (np.sign(SPEED), STEPS),
    'another friction each way': (np.where(SPEED > 0.0, 1.3, -0.8), STEPS),
    'a friction that grows along the way': (POSITION * np.sign(SPEED), STEPS),
}
"""What a wrong model leaves over, and the share of its mean square that may not be spanned."""


def without_motion(residual, basis):
    return residual - basis @ (basis.T @ residual)


@pytest.mark.parametrize('name', LEFT_OVER)
def test_what_a_wrong_model_leaves_over_goes_with_the_motion(name):
    """But for 50 ms at both ends, where the smoothed position has nothing to go on with."""
    wrong, most = LEFT_OVER[name]
    left = without_motion(wrong, motion_basis(COUNTS))[50:-50]
    share = np.mean(left**2) / np.mean(wrong**2)
    print(f'{name}: {share:.5f} of its mean square is left')
    assert share < most


def test_noise_of_a_coarse_reading_is_not_in_the_columns():
    """A residual of the very counts that the position was taken from keeps its noise."""
    print(f'seed {SEED}')
    step = 2e-3
    readings = np.rint(POSITION / step + np.random.default_rng(SEED).normal(0.0, 0.3, COUNT))
    noise = readings - POSITION / step
    high = np.abs(np.fft.rfft(noise)) ** 2
    kept = np.abs(np.fft.rfft(without_motion(noise, motion_basis(readings)))) ** 2
    frequency_hz = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)
    for low_hz in (40.0, 80.0, 160.0, 320.0):
        band = (frequency_hz > low_hz) & (frequency_hz < 1.5 * low_hz)
        assert kept[band].sum() > 0.95 * high[band].sum()


def test_it_takes_of_white_noise_its_rank_and_no_more():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    basis = motion_basis(COUNTS)
    rank = basis.shape[1]
    assert 9 <= rank <= 11
    assert basis.T @ basis == pytest.approx(np.eye(rank), abs=1e-9)
    taken = [
        float(np.sum(white**2) - np.sum(without_motion(white, basis) ** 2))
        for white in random.normal(size=(300, COUNT))
    ]
    # chi squared with `rank` degrees of freedom: mean `rank`, variance 2 `rank`
    assert np.mean(taken) == pytest.approx(rank, abs=4.0 * np.sqrt(2.0 * rank / 300))


def test_a_reading_in_any_unit_and_from_any_zero_has_the_same_motion():
    one, other = (motion_basis(p) for p in (1e6 * POSITION, 3.0 - 2.0 * POSITION))
    wrong = np.sign(SPEED)
    assert without_motion(wrong, one) == pytest.approx(without_motion(wrong, other), abs=1e-3)


def test_an_axis_that_stands_or_hardly_a_sample_has_no_basis():
    assert motion_basis(np.full(COUNT, 7.0)).shape == (COUNT, 0)
    few = 11 * FEWEST - 1
    assert motion_basis(COUNTS[:few]).shape == (few, 0)
