# SPDX-License-Identifier: Apache-2.0
"""
What noise that is not as assumed does to what is fitted, against many draws of it.

Intervals are those of Student's t with the degrees of freedom of the estimated power.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import binom, norm
from scipy.stats import t as student

from waferbot_twin.noise_model.noise_beside_fit import leverages_of
from waferbot_twin.noise_model.power import WholePower
from waferbot_twin.noise_model.prediction_error import (
    FEWEST_FREEDOM,
    Colour,
    Noise,
    PredictionError,
    fit,
    freedom_of,
    in_deviations,
    likelihood,
    whitened,
)
from waferbot_twin.noise_model.residual_spectrum import (
    Power,
    _by_spectrum,
    _larger,
    _where_it_moves,
    flattened,
    information,
    log_likelihood_ratios_in,
    on_cosines,
    power_along,
    powers_along,
    spectrum,
)

SEED = 20261127
SAMPLES, ORDER, DRAWS = 3000, 8, 200
MOVES = np.abs(np.sin(np.linspace(0.0, 9.0, SAMPLES)))
"""How fast an axis moves."""

NOISE = {
    'white': lambda random: random.normal(size=SAMPLES),
    'of an autoregression': lambda random: lfilter(
        [1.0], [1.0, -0.9], random.normal(size=SAMPLES + 500)
    )[500:],
    'louder while moving': lambda random: (0.3 + 2.0 * MOVES) * random.normal(size=SAMPLES),
    'slow, unseen by the autoregression': lambda random: (
        random.normal(size=SAMPLES)
        + lfilter([0.1], [1.0, -0.98], random.normal(size=SAMPLES + 2000))[2000:]
    ),
}
DIRECTIONS = {
    'friction': np.sign(np.sin(np.linspace(0.0, 25.0, SAMPLES))),
    'speed': np.sin(np.linspace(0.0, 9.0, SAMPLES)),
    'a fast one': np.cos(np.linspace(0.0, 900.0, SAMPLES)),
    'a short move': np.exp(-0.5 * ((np.arange(SAMPLES) - 600.0) / 100.0) ** 2),
}
FEWEST, MOST = binom(DRAWS, 0.95).ppf([0.001, 0.999])


@pytest.mark.parametrize('direction', DIRECTIONS)
@pytest.mark.parametrize('noise', NOISE)
def test_intervals_by_the_power_along_a_direction_hold_the_truth(noise, direction):
    random = np.random.default_rng(SEED)
    inside = 0
    for _ in range(DRAWS):
        channel = NOISE[noise](random)
        colours = likelihood([channel], [Noise(1e-9, ORDER)]).colours
        (white,), (change,) = (
            in_deviations(colours, [one]) for one in (channel, DIRECTIONS[direction])
        )
        square = float(change @ change)
        size = float(change @ white) / square
        left = white - size * change
        power = power_along([left], [change], colours)
        assert 5.0 < power.freedom <= FEWEST_FREEDOM
        error = math.sqrt(power.value / square)
        inside += abs(size) < student(power.freedom).ppf(0.975) * error
    print(f'seed {SEED}: {inside} of {DRAWS} hold the truth, {FEWEST:.0f} to {MOST:.0f} expected')
    assert FEWEST <= inside <= MOST


@pytest.mark.parametrize('noise', NOISE)
def test_intervals_by_the_covariance_of_a_fit_hold_the_truth(noise):
    """And they are hardly wider than need be, though of three powers the largest is taken."""
    inside, width = of_intervals(noise, np.column_stack(list(DIRECTIONS.values())))
    print(f'seed {SEED}: {inside} of {DRAWS} hold the truth, {FEWEST:.0f} at least expected')
    assert np.all(inside >= FEWEST)
    assert np.all(width < 1.3)


@pytest.mark.parametrize('noise', NOISE)
def test_intervals_hold_the_truth_where_much_is_fitted(noise):
    """Sixteen numbers of an axis that moves once: they take most of the slow noise in that time."""
    place = (np.arange(SAMPLES) - 1500.0) / 500.0
    waves = np.cos(np.outer(place, np.arange(16)) * 1.5)
    inside, width = of_intervals(noise, waves * np.exp(-0.5 * place**2)[:, None])
    print(f'seed {SEED}: {inside} of {DRAWS} hold the truth, {FEWEST:.0f} at least expected')
    assert np.all(inside >= FEWEST)
    assert np.all(width < 1.6)


def of_intervals(noise, signatures):
    """Return how many of the intervals hold the truth, and their widths over what would be enough."""
    random, count = np.random.default_rng(SEED), signatures.shape[1]
    values, reaches = [], []
    for _ in range(DRAWS):
        channels = [NOISE[noise](random)]
        found = fit(channels, [signatures], [Noise(1e-9, ORDER)])
        system, _ = whitened(channels, [signatures], found.colours)
        leverages = leverages_of(
            [system], found.whitened, found.noises, found.colours, np.zeros(count)
        )
        error = np.sqrt(np.diag(np.linalg.inv(information([system], found, leverages))))
        values.append(found.value)
        reaches.append(student(FEWEST_FREEDOM).ppf(0.975) * error)
    inside = np.sum(np.abs(values) < reaches, axis=0)
    return inside, np.mean(reaches, axis=0) / (norm.ppf(0.975) * np.std(values, axis=0))


def test_no_direction_of_many_is_known_better_than_in_noise_as_assumed():
    """Of more directions than noise has degrees of freedom some show none of it."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    signatures = random.normal(size=(SAMPLES, 2 * FEWEST_FREEDOM))
    found = fit([random.normal(size=SAMPLES)], [signatures], [Noise(1e-9, ORDER)])
    system, _ = whitened([random.normal(size=SAMPLES)], [signatures], found.colours)
    as_assumed = np.linalg.cholesky(system.T @ system)
    nothing_known = np.zeros(signatures.shape[1])
    leverages = leverages_of([system], found.whitened, found.noises, found.colours, nothing_known)
    half = np.linalg.solve(as_assumed, information([system], found, leverages))
    shares = np.linalg.eigvalsh(np.linalg.solve(as_assumed, half.T))
    assert shares.max() < 1.0 + 1e-9
    assert shares.min() > 0.05  # noise has no more than its own power either, but by chance


@pytest.mark.parametrize('width', [60.0, 300.0, 3000.0])
@pytest.mark.parametrize('block', [1, 12])
@pytest.mark.parametrize(
    'estimate',
    [_where_it_moves, _by_spectrum],
    ids=['where it moves', 'by the spectrum'],
)
def test_white_noise_has_a_power_of_one_known_as_well_as_said(estimate, block, width):
    """Without what lies along a direction, as a fit leaves it, however short a motion is."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    change = np.exp(-0.5 * ((np.arange(SAMPLES) - 900.0) / width) ** 2)
    change -= change.mean() if width > SAMPLES / 2 else 0.0
    change /= np.linalg.norm(change)
    colour = Colour(PredictionError(np.zeros(2 * block + 1), np.zeros(0), 0), 1.0)
    found = []
    for _ in range(DRAWS):
        white = random.normal(size=SAMPLES)
        rest = white - float(change @ white) * change
        found.append(estimate(rest, change, colour, None))
    values, freedom = np.array([one.value for one in found]), found[0].freedom
    assert freedom >= 1.0
    spread = math.sqrt(2.0 / freedom)
    assert np.mean(values) == pytest.approx(1.0, abs=4.0 * spread / math.sqrt(DRAWS))
    assert np.std(values) == pytest.approx(spread, rel=0.25)


@pytest.mark.parametrize('prior', [0.0, 30.0])
@pytest.mark.parametrize('width', [300.0, 3000.0])
@pytest.mark.parametrize(
    'estimate', [_where_it_moves, _by_spectrum], ids=['where it moves', 'by the spectrum']
)
def test_white_noise_has_a_power_of_one_beside_much_that_was_fitted(estimate, width, prior):
    """Where an axis moves, eight slow columns have taken most of the slow noise; with a prior, some."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    place = (np.arange(SAMPLES) - 900.0) / width
    waves = np.cos(np.outer(place, np.arange(8)) * 1.5) * np.exp(-0.5 * place**2)[:, None]
    system = waves / np.linalg.norm(waves, axis=0) * 5.0
    precision = np.full(8, prior)
    colour = Colour(PredictionError(np.zeros(25), np.zeros(0), 0), 1.0)
    noises = [Noise(1e-9, 24)]
    (leverage,) = leverages_of([system], [np.zeros(SAMPLES)], noises, [colour], precision)
    products = system.T @ system + np.diag(precision)
    change = system[:, 2]
    beside, alone = [], []
    for _ in range(2 * DRAWS):
        usual = random.normal(size=8) / math.sqrt(prior) if prior else np.zeros(8)
        channel = random.normal(size=SAMPLES) + system @ usual
        left = channel - system @ np.linalg.solve(products, system.T @ channel)
        left -= float(change @ left) / float(change @ change) * change
        beside.append(estimate(left, change, colour, leverage))
        alone.append(estimate(left, change, colour, None))
    values = np.array([one.value for one in beside])
    error = np.std(values) / math.sqrt(len(values))
    assert np.mean(values) == pytest.approx(1.0, abs=4.0 * error)
    assert np.std(values) == pytest.approx(math.sqrt(2.0 / beside[0].freedom), rel=0.3)
    if not prior:
        assert np.mean([one.value for one in alone]) < 0.85


@pytest.mark.parametrize('shape', ['one sample', 'a few samples', 'every other sample', 'a step'])
def test_noise_has_a_power_along_whatever_changes(shape):
    """Along a count that was lost, a blow, the fastest there is: white noise has 1 there, too."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    change = {
        'one sample': np.eye(1, SAMPLES, 1001)[0],
        'a few samples': (np.arange(SAMPLES) // 3 == 333) * 1.0,
        'every other sample': (-1.0) ** np.arange(SAMPLES),
        'a step': (np.arange(SAMPLES) > 2990) * 1.0,
    }[shape]
    colour = Colour(PredictionError(np.zeros(25), np.zeros(0), 0), 1.0)
    powers = [
        powers_along([random.normal(size=SAMPLES)], [change], [colour])[0] for _ in range(DRAWS)
    ]
    assert all(one.value >= 1.0 and 1.0 <= one.freedom <= FEWEST_FREEDOM for one in powers)
    assert np.median([one.value for one in powers]) < 1.5


@pytest.mark.parametrize('rank', [1, 3, 5])
def test_the_larger_covariance_is_no_smaller_than_either_along_any_direction(rank):
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    for _ in range(20):
        one = np.cov(random.normal(size=(5, 50)))
        roots = random.normal(size=(5, rank))
        other = roots @ roots.T
        found = _larger(one, other)
        assert np.linalg.eigvalsh(found - one).min() > -1e-9
        assert np.linalg.eigvalsh(found - other).min() > -1e-9
        np.testing.assert_allclose(found, _larger(other, one), atol=1e-9)
    np.testing.assert_allclose(_larger(one, one), one, atol=1e-9)
    np.testing.assert_allclose(_larger(one, np.zeros((5, 5))), one, atol=1e-9)
    apart = _larger(np.diag([3.0, 1.0, 0.0]), np.diag([2.0, 5.0, 0.0]))
    np.testing.assert_allclose(apart, np.diag([3.0, 5.0, 0.0]), atol=1e-9)


def test_taken_as_white_noise_louder_while_moving_would_be_known_too_well():
    """Why there is a power along a direction: the usual intervals of the speed's share."""
    random = np.random.default_rng(SEED)
    speed = DIRECTIONS['speed'][:, None]
    inside = 0
    for _ in range(DRAWS):
        found = fit([NOISE['louder while moving'](random)], [speed], [Noise(1e-9, ORDER)])
        inside += abs(found.value[0]) < 1.96 * math.sqrt(found.covariance[0, 0])
    assert inside < FEWEST


def test_logs_add_their_degrees_of_freedom():
    random = np.random.default_rng(SEED)
    logs = [random.normal(size=SAMPLES) for _ in range(3)]
    colours = likelihood(logs, [Noise(1e-9, ORDER)] * 3).colours
    left = in_deviations(colours, logs)
    same = in_deviations(colours, [DIRECTIONS['a fast one']] * 3)
    power = power_along(left, same, colours)
    assert FEWEST_FREEDOM < power.freedom <= 3 * FEWEST_FREEDOM
    one_only = [same[0], np.zeros_like(same[1]), np.zeros_like(same[2])]
    assert power_along(left, one_only, colours).freedom == pytest.approx(FEWEST_FREEDOM)


def test_what_lacks_in_one_channel_does_not_hide_what_another_one_shows():
    """A second log in which something large is left over adds nothing, and takes nothing away."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    clean = random.normal(size=SAMPLES)
    colours = likelihood([clean, clean], [Noise(1e-9, ORDER)] * 2).colours
    change = in_deviations(colours, [DIRECTIONS['a fast one']] * 2)
    clean, disturbed = in_deviations(colours, [clean, 30.0 * MOVES * DIRECTIONS['a fast one']])
    alone = sum(log_likelihood_ratios_in(powers_along([clean], change[:1], colours[:1]), [50.0]))
    both = sum(
        log_likelihood_ratios_in(powers_along([clean, disturbed], change, colours), [50.0, 50.0])
    )
    assert alone <= both < alone + 1.0
    pooled = power_along([clean, disturbed], change, colours)
    assert pooled.log_likelihood_ratio(100.0) < 0.1 * alone


def test_a_channel_that_follows_to_the_last_bit_has_its_floor_and_nothing_to_estimate():
    residual = np.zeros(SAMPLES)
    colours = likelihood([residual], [Noise(0.5, 0)]).colours
    power = power_along([residual], [DIRECTIONS['friction']], colours)
    assert power == Power(1.0, math.inf)


def test_cosines_have_a_mean_square_of_one_and_are_orthogonal():
    rows = on_cosines(np.eye(1000), 40)
    assert rows @ rows.T / 1000.0 == pytest.approx(np.eye(40), abs=1e-9)


def test_power_is_known_better_from_a_longer_log_and_from_lines_up_to_the_same_frequency():
    assert [freedom_of(duration_s) for duration_s in (0.1, 1.0, 25.0)] == [16, 16, 400]
    random = np.random.default_rng(SEED)
    channel = random.normal(size=SAMPLES)
    for freedom in (16, 64):
        colours = likelihood([channel], [Noise(1e-9, ORDER, freedom=freedom)]).colours
        (white,), (change,) = (in_deviations(colours, [one]) for one in (channel, channel[::-1]))
        assert power_along([white], [change], colours).freedom == pytest.approx(freedom)


@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
@settings(derandomize=True, deadline=None)
def test_the_power_of_few_samples_is_that_of_themselves(count, seed):
    """The likelihood ratio of two sets of samples, each with the variance that is its likeliest."""
    before, after = np.random.default_rng(seed).standard_normal((2, count))

    def log_likelihood(samples):
        return norm.logpdf(samples, scale=np.sqrt(np.mean(samples**2))).sum()

    power = WholePower.of(after)
    assert power.as_if_known is power
    ratio = power.log_likelihood_ratio(float(before @ before - after @ after))
    assert ratio == pytest.approx(log_likelihood(after) - log_likelihood(before), abs=1e-9)


def test_a_likelihood_ratio_is_half_of_the_squares_where_power_is_known_and_less_where_it_is_not():
    known, estimated = Power(2.0, math.inf), Power(2.0, 16.0)
    for squares in (0.1, 5.0, 400.0):
        ratio = known.log_likelihood_ratio(squares)
        assert ratio == pytest.approx(squares / 4.0)
        by_t = student(16.0).logpdf(0.0) - student(16.0).logpdf(math.sqrt(squares / 2.0))
        assert estimated.log_likelihood_ratio(squares) == pytest.approx(by_t)
        assert estimated.log_likelihood_ratio(-squares) == pytest.approx(-by_t)
    assert estimated.log_likelihood_ratio(400.0) < known.log_likelihood_ratio(400.0)


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
