# SPDX-License-Identifier: Apache-2.0
"""What is fitted to noise alone is no more often large than the power along it says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from scipy.stats import binom
from scipy.stats import t as student

from waferbot_twin.noise_model.leverage import Leverage
from waferbot_twin.noise_model.motion_basis import motion_basis, moves
from waferbot_twin.noise_model.noise_beside_fit import leverages_of, while_moving
from waferbot_twin.noise_model.prediction_error import (
    Colour,
    Noise,
    PredictionError,
    in_deviations,
    likelihood,
)
from waferbot_twin.noise_model.residual_spectrum import powers_along
from waferbot_twin.noise_model.variance_components import Shapes

SEED, DRAWS = 20261130, 300
SAMPLES, RATE_HZ, OBSERVER_HZ, DAMPING = 2205, 2205.0, 80.0, 0.7
COLUMNS = 9
TIME_S = np.arange(SAMPLES) / RATE_HZ


def observed(force):
    """Return what an observer of this frequency shows of a force (N,) or (N, k)."""
    wave = 2.0 * math.pi * OBSERVER_HZ
    over, under, _ = cont2discrete(
        ([wave**2], [1.0, 2.0 * DAMPING * wave, wave**2]), 1.0 / RATE_HZ, 'bilinear'
    )
    return lfilter(over.ravel(), under, force, axis=0)


def motion(random):
    """Return when an axis moves, once in a second, and where it is."""
    lasts_s = random.uniform(0.2, 0.9)
    going = np.abs(TIME_S - 0.05 - 0.5 * lasts_s) < 0.5 * lasts_s
    speed = np.sin(np.pi * np.clip((TIME_S - 0.05) / lasts_s, 0.0, 1.0))
    speed *= 1.0 + 0.3 * np.sin(2.0 * np.pi * random.uniform(1.0, 5.0) * TIME_S)
    return going, np.cumsum(going * speed) * 100.0


def slow_force(random):
    """Return a force of unit variance up to a corner, 3 to 60 Hz."""
    corner_hz = math.exp(random.uniform(math.log(3.0), math.log(60.0)))
    pole = math.exp(-2.0 * np.pi * corner_hz / RATE_HZ)
    noise = random.normal(size=SAMPLES + 2000)
    return lfilter([math.sqrt(1.0 - pole**2)], [1.0, -pole], noise)[2000:]


@pytest.mark.parametrize('when', ['never', 'always', 'while it moves'])
def test_noise_alone_seems_to_be_a_cause_no_more_often_than_said(when):
    """Of slow columns, nine of them, the size of one: Student's t with the power along it."""
    random = np.random.default_rng(SEED)
    chances, by_all_of_it = [], []
    for _ in range(DRAWS):
        going, position = motion(random)
        shaken = {'never': 0.0 * TIME_S, 'always': 1.0, 'while it moves': going}[when]
        force = random.uniform(0.2, 2.0) * slow_force(random) * shaken
        channel = 0.3 * random.normal(size=SAMPLES) + observed(force)
        waves = np.outer(TIME_S, 2.0 * np.pi * random.uniform(0.5, 8.0, COLUMNS))
        columns = observed(np.cos(waves + random.uniform(0.0, 6.3, COLUMNS)) * going[:, None])
        shapes = Shapes(
            RATE_HZ, OBSERVER_HZ, DAMPING, motion_basis(position), moves=moves(position)
        )
        noise = Noise(1e-9, 24, shapes=shapes)
        solved = np.linalg.lstsq(columns, channel, rcond=None)[0]
        colours = likelihood([channel - columns @ solved], [noise]).colours
        (white,), (rows,) = (in_deviations(colours, [one]) for one in (channel, columns))
        value = np.linalg.lstsq(rows, white, rcond=None)[0]
        left = white - rows @ value
        others = np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
        change = value[0] * (rows[:, 0] - rows[:, 1:] @ others)
        leverages = leverages_of([rows], [left], [noise], colours, np.zeros(COLUMNS))
        for found, known in ((chances, leverages), (by_all_of_it, ())):
            (power,) = powers_along([left], [change], colours, known)
            size = math.sqrt(float(change @ change) / power.value)
            found.append(2.0 * student(power.freedom).sf(size))
    for level in (0.05, 0.01):
        seen, most = sum(one < level for one in chances), binom(DRAWS, level).ppf(0.999)
        print(f'seed {SEED}: {seen} of {DRAWS} below {level}, {most:.0f} at most expected')
        assert seen <= most
    if when == 'while it moves':  # why it is there
        assert sum(one < 0.01 for one in by_all_of_it) > 3.0 * most


@pytest.mark.parametrize('share', [0.3, 1.0])
def test_the_spectrum_is_that_of_the_noise_while_the_axis_moves(share):
    """Of white noise and a force up to 10 Hz, through the filter of a colour."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    count = 20 * SAMPLES
    going = np.arange(count) < share * count
    pole = math.exp(-2.0 * np.pi * 10.0 / RATE_HZ)
    force = lfilter([20.0 * math.sqrt(1.0 - pole**2)], [1.0, -pole], random.normal(size=count))
    channel = random.normal(size=count) + observed(force * going)
    shapes = Shapes(RATE_HZ, OBSERVER_HZ, DAMPING, np.zeros((count, 0)), moves=going)
    colour = Colour(PredictionError(np.array([1.0, -0.5, *np.zeros(23)]), np.zeros(0), 0), 2.0)
    (white,) = in_deviations([colour], [channel])
    nothing = Leverage(np.zeros((-(-len(white) // 12), 0)), 12)
    found = while_moving(white, colour, shapes, nothing)
    frequency_hz = np.arange(len(found)) * RATE_HZ / (12 * (2 * (len(found) - 1)))
    # The force's spectrum is 20^2 tau f_s / 2 over 1 + (f / 10 Hz)^2, of one side and per sample.
    slow = 400.0 * 2.0 / (2.0 * np.pi * 10.0) * RATE_HZ / (1.0 + (frequency_hz / 10.0) ** 2)
    angle = 2.0 * np.pi * frequency_hz / RATE_HZ
    expected = np.abs(1.0 - 0.5 * np.exp(-1j * angle)) ** 2 / 4.0 * (1.0 + slow)
    expected *= np.sinc(6.0 * angle / np.pi) ** 2  # sums over 12 samples show less of what is fast
    told = (frequency_hz > 1.0) & (frequency_hz < 40.0)
    assert np.median(found[told] / expected[told]) == pytest.approx(1.0, abs=0.15)
    assert found[told] == pytest.approx(expected[told], rel=0.5)


def test_an_axis_that_stands_has_no_such_spectrum():
    colour = Colour(PredictionError(np.eye(25)[0], np.zeros(0), 0), 1.0)
    still = Shapes(
        RATE_HZ, OBSERVER_HZ, DAMPING, np.zeros((SAMPLES, 0)), moves=moves(np.zeros(SAMPLES))
    )
    white = np.random.default_rng(SEED).normal(size=SAMPLES - 24)
    nothing = Leverage(np.zeros((-(-len(white) // 12), 0)), 12)
    assert len(while_moving(white, colour, still, nothing)) == 0
