# SPDX-License-Identifier: Apache-2.0
"""Least squares with coloured residuals, against processes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_twin.noise_model.prediction_error import Noise, autoregression, fit, likelihood

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
        result = fit([residual], [shape[:, None]], [Noise(1e-9, 4)])
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
            with_it = fit([residual], [slow[:, None]], [Noise(1e-9, order)])
            without = fit([residual], [np.zeros((4000, 0))], [Noise(1e-9, order)])
            gains.append(2.0 * (with_it.log_likelihood - without.log_likelihood))
    assert np.median(coloured_gain) < 2.0  # chi squared of one degree of freedom: 0.45
    assert np.median(white) > 10.0


def test_floor_bounds_the_likelihood_of_a_perfect_fit():
    shape = np.cos(np.arange(500.0))
    result = fit([-2.0 * shape], [shape[:, None]], [Noise(0.01, 0)])
    assert result.value[0] == pytest.approx(2.0)
    assert result.log_likelihood == pytest.approx(-500 * (np.log(0.01) - 0.5))
    assert [one.deviation for one in result.colours] == [0.01]


def pair_of_encoders(random: np.random.Generator, size: int = 20000):
    """Two readings of one position that coloured force shakes, with noise of their own."""
    position = lfilter([1.0], [1.0, -1.5, 0.6], random.normal(size=size))
    return position + random.normal(0.0, 0.5, size), position + random.normal(0.0, 2.0, size)


PAIR = [Noise(1e-9, 24, 1), Noise(1e-9, 24, -1)]
APART = [Noise(1e-9, 24), Noise(1e-9, 24)]


def test_a_pair_is_as_likely_by_whichever_of_the_two_an_observer_follows():
    """Innovations of two observers are filters of each other: the likelihood is that of the readings."""
    random = np.random.default_rng(SEED)
    first, second = pair_of_encoders(random)

    def innovations(gains: tuple[float, float]) -> list[np.ndarray]:
        place, left = 0.0, ([], [])
        for readings in zip(first, second, strict=True):
            errors = [reading - place for reading in readings]
            for channel, error in zip(left, errors, strict=True):
                channel.append(error)
            place = 0.9 * place + sum(
                gain * error for gain, error in zip(gains, errors, strict=True)
            )
        return [np.array(channel) for channel in left]

    followed = [innovations(gains) for gains in ((0.5, 0.0), (0.35, 0.15), (0.0, 0.0))]
    as_pair = [likelihood(left, PAIR).log_likelihood for left in followed]
    apart = [likelihood(left, APART).log_likelihood for left in followed]
    assert np.ptp(as_pair) < 15.0
    assert np.ptp(apart) > 300.0


def test_what_moves_both_of_a_pair_counts_once():
    """A signature in both channels: errors scatter as the covariance of a pair says, not of two."""
    random = np.random.default_rng(SEED)
    shape = np.sin(np.linspace(0.0, 60.0, 3000))
    seen = lfilter([1.0], [1.0, -1.5, 0.6], shape)[:, None]
    errors = {'pair': [], 'apart': []}
    for _ in range(60):
        residuals = [one - 0.1 * seen[:, 0] for one in pair_of_encoders(random, 3000)]
        for name, noises in (('pair', PAIR), ('apart', APART)):
            found = fit(residuals, [seen, seen], noises)
            errors[name].append((found.value[0] - 0.1) / np.sqrt(found.covariance[0, 0]))
    assert np.std(errors['pair']) == pytest.approx(1.0, abs=0.25)
    assert np.std(errors['apart']) > 1.25


def test_the_second_of_a_pair_is_told_by_the_present_of_the_first():
    random = np.random.default_rng(SEED)
    first = random.normal(size=50000)
    second = 0.7 * first + 0.3 * np.roll(first, 1) + 0.1 * random.normal(size=50000)
    found = likelihood([first, second], [Noise(1e-9, 2, 1), Noise(1e-9, 2, -1)])
    assert found.colours[0].error.other == pytest.approx(np.zeros(3), abs=0.1)
    assert found.colours[1].error.own == pytest.approx([1.0, 0.0, 0.0], abs=0.02)
    assert found.colours[1].error.other == pytest.approx([-0.7, -0.3, 0.0], abs=0.02)
    assert [one.deviation for one in found.colours] == pytest.approx([1.0, 0.1], rel=0.02)


def test_a_colour_that_is_known_is_taken_where_it_is_the_more_likely_one():
    """Of low order a process is found badly; another record of it has the right filter."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    here, there = (lfilter([1.0], [1.0, -1.6, 0.8], random.normal(size=4000)) for _ in range(2))
    known = likelihood([there], [Noise(1e-9, 2)]).colours
    noises = [Noise(1e-9, 1)]
    own, with_known = likelihood([here], noises), likelihood([here], noises, known)
    assert with_known.log_likelihood > own.log_likelihood + 1000.0
    assert with_known.colours[0].error is known[0].error
    louder = likelihood([3.0 * here], noises, known)  # the deviation is its own
    assert louder.colours[0].deviation == pytest.approx(3.0 * with_known.colours[0].deviation)
    worse = likelihood([here], [Noise(1e-9, 2)], own.colours)
    assert worse.colours[0].error is not own.colours[0].error
    assert worse.log_likelihood == likelihood([here], [Noise(1e-9, 2)]).log_likelihood


def test_two_of_one_process_take_a_colour_together():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    noises = [Noise(1e-9, 2, beside=1), Noise(1e-9, 2, beside=-1)]
    here, there = (
        [lfilter([1.0], [1.0, -1.6, 0.8], random.normal(size=4000)) for _ in range(2)]
        for _ in range(2)
    )
    known = likelihood(there, noises).colours
    chosen = likelihood(here, noises, known).colours
    assert len({one.error is two.error for one, two in zip(chosen, known, strict=True)}) == 1
