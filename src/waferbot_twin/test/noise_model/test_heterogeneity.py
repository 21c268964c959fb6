# SPDX-License-Identifier: Apache-2.0
"""Sizes in parts of logs: what is in some of them only, in noise that is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_twin.noise_model.heterogeneity import power_along, prior_of
from waferbot_twin.noise_model.misfit import InLog, StateFunctions

RATE_HZ = 1000.0
SAMPLES = 6000

SEED = 11


def motions(random, logs=2):
    """Return positions (m) of some logs: sums of sines."""
    time_s = np.arange(SAMPLES) / RATE_HZ
    return [
        0.1 * np.sin(np.outer(time_s, wave) + phase).sum(axis=1)
        for wave, phase in zip(
            2.0 * np.pi * random.uniform(0.2, 1.0, (logs, 3)),
            random.uniform(0.0, 6.0, (logs, 3)),
            strict=True,
        )
    ]


def in_logs(positions):
    functions = StateFunctions(tuple(positions), (RATE_HZ,) * len(positions))
    return [InLog(functions, place) for place in range(len(positions))]


def fitted(residuals, directions):
    """Return what least squares leave over of residuals, and its change."""
    square = sum(float(one @ one) for one in directions)
    size = sum(float(a @ b) for a, b in zip(residuals, directions, strict=True)) / square
    changes = [size * one for one in directions]
    return [a - b for a, b in zip(residuals, changes, strict=True)], changes, size**2 * square


def test_in_white_noise_nothing_disagrees(random) -> None:
    positions = motions(random)
    logs = in_logs(positions)
    ripple = [np.sin(2.0 * np.pi * one / 0.01) for one in positions]
    gained, powers = [], []
    for _ in range(30):
        left, changes, squares = fitted(
            [random.standard_normal(SAMPLES) + 0.2 * one for one in ripple], ripple
        )
        power = power_along(left, changes, logs)
        powers.append(power.value)
        gained.append(2.0 * power.log_likelihood_ratio(squares) / squares)
    assert np.mean(powers) < 1.15
    assert np.mean(gained) > 0.75


def test_what_is_in_one_log_only_is_not_the_size_of_all(random) -> None:
    """Beside a model that lacks something in every part, as real ones do."""
    positions = motions(random)
    logs = in_logs(positions)
    ripple = [np.sin(2.0 * np.pi * one / 0.01) for one in positions]
    slow = [
        np.repeat(random.normal(0.0, 0.5, 8), SAMPLES // 8) * np.sign(np.gradient(one))
        for one in positions
    ]
    noise = [random.standard_normal(SAMPLES) + one for one in slow]
    both = fitted([a + 0.2 * b for a, b in zip(noise, ripple, strict=True)], ripple)
    one = fitted([a + c * b for a, b, c in zip(noise, ripple, (0.4, 0.0), strict=True)], ripple)
    powers = [power_along(left, changes, logs) for left, changes, _ in (both, one)]
    assert powers[1].value > 4.0 * powers[0].value
    gained = [
        power.log_likelihood_ratio(squares)
        for power, (*_, squares) in zip(powers, (both, one), strict=True)
    ]
    assert gained[0] > 2.5 * gained[1]


def test_a_direction_that_one_part_shows_alone_cannot_disagree(random) -> None:
    positions = motions(random)
    change = [np.zeros(SAMPLES), np.zeros(SAMPLES)]
    change[0][:500] = 1.0
    left = [3.0 * random.standard_normal(SAMPLES) for _ in positions]
    power = power_along(left, change, in_logs(positions))
    assert (power.value, power.freedom) == (1.0, math.inf)
    still = in_logs([np.zeros(SAMPLES)] * 2)
    assert power_along(left, [np.ones(SAMPLES)] * 2, still).value == 1.0


@pytest.mark.parametrize(('middle', 'known'), [(1.0, math.inf), (3.0, 4.0), (0.5, 20.0)])
def test_the_prior_of_variances_is_found_again(random, middle, known) -> None:
    freedom = random.integers(3, 12, 4000)
    true = np.full(4000, middle)
    if math.isfinite(known):
        true = middle * known / random.chisquare(known, 4000)
    found, sure = prior_of(true * random.chisquare(freedom) / freedom, freedom)
    assert found == pytest.approx(middle, rel=0.1)
    assert sure > 60.0 if math.isinf(known) else sure == pytest.approx(known, rel=0.35)
    assert prior_of(np.array([4.0]), np.array([3])) == (1.0, math.inf)
