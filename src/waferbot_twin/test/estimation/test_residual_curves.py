# SPDX-License-Identifier: Apache-2.0
"""Binned means with intervals from passes, and lines over position that speed does not move."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_twin.estimation.residual_curves import binned_means, position_spectrum

PERIOD = 2.5e-3


def sweep(random, passes=20, speed=0.1, stroke=0.2, step_s=1e-3):
    """Position, speed and number of the pass of an axis to and fro, each faster or slower."""
    positions, speeds, numbers = [], [], []
    for number in range(passes):
        own = speed * random.uniform(0.5, 1.5)
        way = np.arange(0.0, stroke, own * step_s)
        forward = number % 2 == 0
        positions.append(way if forward else stroke - way)
        speeds.append(np.full(len(way), own if forward else -own))
        numbers.append(np.full(len(way), number))
    return np.concatenate(positions), np.concatenate(speeds), np.concatenate(numbers)


def test_means_and_intervals_of_a_curve() -> None:
    random = np.random.default_rng(1)
    position, _, number = sweep(random, passes=30)
    # Noise that stays what it is for a whole pass: samples in a pass are one sample.
    residual = 5.0 * position + random.standard_normal(30)[number]
    means = binned_means(position, residual, 20)
    truth = 5.0 * means.centre
    assert len(means.centre) == 20
    assert np.mean((means.low95 < truth) & (truth < means.high95)) > 0.8
    assert np.mean(means.high95 - means.low95) > 0.3  # far from the scatter over root samples


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(2, 60))
def test_means_hold_the_whole_and_nothing_is_made_up(seed, bins) -> None:
    random = np.random.default_rng(seed)
    over, residual = random.standard_normal(500), random.standard_normal(500)
    means = binned_means(over, residual, bins)
    assert means.mean.min() >= residual.min()
    assert means.mean.max() <= residual.max()
    known = np.isfinite(means.low95)
    assert (means.low95[known] <= means.mean[known]).all()
    assert (np.diff(means.centre) > 0.0).all()


def test_one_pass_has_no_interval() -> None:
    over = np.linspace(0.0, 1.0, 200)
    means = binned_means(over, over, 10)
    assert np.isnan(means.low95).all()
    assert means.mean == pytest.approx(means.centre, abs=0.01)


def test_a_ripple_over_position_stands_out_at_its_period_and_size() -> None:
    random = np.random.default_rng(2)
    position, speed, _ = sweep(random)
    residual = 1.5 * np.sin(2.0 * np.pi / PERIOD * position + 0.4)
    residual += random.standard_normal(len(position))
    found = position_spectrum(position, residual, speed, 100.0)
    assert found is not None
    strongest = found.lines[0]
    assert 1.0 / found.waves[strongest] == pytest.approx(PERIOD, rel=0.01)
    assert found.amplitude[strongest] == pytest.approx(1.5, rel=0.1)


def test_noise_and_a_ripple_over_time_make_no_line() -> None:
    random = np.random.default_rng(3)
    position, speed, _ = sweep(random)
    time_s = np.arange(len(position)) * 1e-3
    residual = random.standard_normal(len(position)) + np.sin(2.0 * np.pi * 17.0 * time_s)
    found = position_spectrum(position, residual, speed, 100.0)
    assert found is not None
    assert len(found.lines) <= 1


def test_an_axis_that_stands_has_no_spectrum() -> None:
    assert position_spectrum(np.zeros(100), np.ones(100), np.zeros(100), 50.0) is None
