# SPDX-License-Identifier: Apache-2.0
"""Errors of an encoder that come back along its way."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.proposals.encoder_orders import CHANCE, at_periods, periods
from waferbot_twin.diagnosis.proposals.screening import candidates
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise, likelihood
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import PLANT, Problem
from waferbot_twin.synthesis import with_noise

RATE_HZ, OBSERVER_HZ = 2250.0, 80.0

SLOWLY = """
name: slowly
duration_s: 1.0
motion:
  y_linear: {kind: linear, start_s: 0.05, acceleration_time_s: 0.1, s_curve_time_s: 0.02,
             speed_counts_per_s: 60000, distance_counts: 40000}
"""


def swing(random, travel=10000.0, length=4500):
    """Return counts on a way forth and back with a speed that changes all the time."""
    time_s = np.arange(length) / RATE_HZ
    turns = 2.0 * np.pi * np.outer(time_s, random.uniform(0.3, 1.0, 3)) + random.uniform(0, 6, 3)
    way = np.sin(turns).sum(axis=1)
    return np.rint(travel * (way - way.min()) / np.ptp(way))


def left_over(random, counts, error):
    """Return a problem of one log, and what is left over of readings that are off by an error."""
    w = 2.0 * np.pi * OBSERVER_HZ
    observer = bilinear([1.0, 0.0, 0.0], [1.0, 1.4 * w, w * w], RATE_HZ)
    noise = lfilter([1.0, -0.6], [1.0], random.normal(0.0, 1.0, len(counts)))
    residual = noise + lfilter(*observer, error)
    block = SimpleNamespace(
        channels=['y_linear'],
        measured=lambda name: counts,
        observer_hz=OBSERVER_HZ,
        rates_hz=[RATE_HZ],
    )
    problem = SimpleNamespace(channel_names=lambda block: ['y_linear'], plants=[block])
    return problem, SimpleNamespace(
        fits={PLANT: likelihood([residual], [Noise(0.0, 24)])}, residuals={PLANT: [residual]}
    )


@pytest.mark.parametrize(
    ('period', 'amplitude'), [(45.3, 0.3), (137.0, 0.3), (410.0, 2.0), (1150.0, 15.0)]
)
def test_a_period_is_found_whatever_the_speed_does(period, amplitude):
    """A long one is a slow error, most of which the observer holds."""
    seed = 20261130
    print(f'seed {seed}')
    random = np.random.default_rng(seed)

    counts = swing(random)
    error = amplitude * np.cos(2.0 * np.pi * counts / period + random.uniform(0, 6))
    first, *_ = periods(*left_over(random, counts, error), 'y_linear')
    off = 0.5 * period**2 / 10000.0  # half of what a travel of 10000 counts tells apart
    assert first == pytest.approx(period, abs=off)


@pytest.mark.parametrize('goes', [0.0, 3.0])
def test_an_axis_that_stands_has_no_period(goes):
    """Its readings may all be the same, so that it has no travel at all."""
    random = np.random.default_rng(1)
    counts = np.rint(np.linspace(700.0, 700.0 + goes, 4500))
    log = left_over(random, counts, np.zeros(4500))
    assert periods(*log, 'y_linear') == []


def test_noise_has_a_period_no_more_often_than_promised():
    seed = 20261201
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    found = 0
    for _ in range(150):
        counts = swing(random)
        found += bool(periods(*left_over(random, counts, np.zeros(len(counts))), 'y_linear'))
    assert found <= CHANCE * 150 + 3.0 * np.sqrt(CHANCE * 150)


FAST = """
name: fast
duration_s: 1.0
motion:
  y_rotate: {kind: linear, start_s: 0.05, acceleration_time_s: 0.1, s_curve_time_s: 0.02,
             speed_counts_per_s: 12000, distance_counts: 8000}
"""


def problem_of(effect, axis, hidden, experiment, seed):
    """Return the log of a rigid machine with an effect and noise as a problem."""
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    random = np.random.default_rng(seed)
    noisy = with_noise(effect.apply(nominal, axis, hidden), nominal, 1.0, random)
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(experiment), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(0.8)))])


@pytest.mark.slow
def test_a_large_error_at_even_speed_that_is_taken_for_noise_is_tried_in_its_size():
    """It is a tone in time: whitened, a little of it explains nothing, and no fit begins there."""
    seed = 20261126
    print(f'seed {seed}')
    effect, axis = find('interpolation_error'), 'y_rotate'
    hidden = {'cosine': -15.0, 'sine': -6.0, 'period': 256.0}
    problem = problem_of(effect, axis, hidden, FAST, seed)
    base = evaluate(problem)
    found = [
        one
        for one in at_periods(problem, base, candidates(problem, [effect]))
        if abs(one.values['period'] - 256.0) < 3.0
    ]
    assert found[0].values['cosine'] == found[0].values['sine'] == 0.0
    assert np.hypot(found[1].values['cosine'] + 15.0, found[1].values['sine'] + 6.0) < 8.0
    values = fit_causes(problem, (found[1],)).causes[0].values
    assert values == pytest.approx(hidden, rel=0.05)


@pytest.mark.slow
def test_lines_of_another_pitch_than_any_in_the_library_are_found():
    seed = 20261202
    print(f'seed {seed}')
    effect, axis = find('interpolation_error'), 'y_linear'
    hidden = {'cosine': 0.3, 'sine': -0.2, 'period': 137.0}
    problem = problem_of(effect, axis, hidden, SLOWLY, seed)
    base = evaluate(problem)
    first, *_ = at_periods(problem, base, candidates(problem, [effect]))
    assert first.axis == axis
    assert first.narrow == ('period',)
    assert not first.held
    fitted = fit_causes(problem, (first,))
    assert 2.0 * (fitted.log_likelihood - base.log_likelihood) > 100.0
    values = fitted.causes[0].values
    assert values['period'] == pytest.approx(137.0, rel=1e-3)
    assert values['cosine'] == pytest.approx(0.3, abs=0.05)
    assert values['sine'] == pytest.approx(-0.2, abs=0.05)
