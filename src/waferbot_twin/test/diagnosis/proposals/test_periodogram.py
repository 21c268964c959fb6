# SPDX-License-Identifier: Apache-2.0
"""Frequencies that stand out of what is left over, and the shaking floor that is found by one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.periodogram import CHANCE, at_tones, tones
from waferbot_twin.diagnosis.proposals.screening import candidates, screen, signatures
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

RATE_HZ = 2250.0


def white(logs):
    """Return a problem of logs with one channel, and a hypothesis that leaves this over."""
    problem = SimpleNamespace(
        channel_names=lambda block: ['x_rotate'] * len(logs), plant_rates_hz=[RATE_HZ] * len(logs)
    )
    fits = {PLANT: SimpleNamespace(whitened=tuple(logs))}
    return problem, SimpleNamespace(fits=fits, residuals={PLANT: list(logs)})


def coloured(logs, order):
    """Return the same of coloured noise, whitened by itself."""
    problem, base = white(logs)
    fit = likelihood(logs, [Noise(0.0, order)] * len(logs))
    return problem, SimpleNamespace(fits={PLANT: fit}, residuals=base.residuals)


def test_a_tone_is_found_within_a_tenth_of_what_the_log_resolves():
    seed = 20261125
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    lengths = (2100, 1700)
    logs = [
        random.normal(0.0, 1.0, length)
        + 0.25 * np.sin(2.0 * np.pi * 14.6 * np.arange(length) / RATE_HZ + random.uniform(0, 6))
        for length in lengths
    ]
    (found,) = tones(*white(logs))
    assert found == pytest.approx(14.6, abs=0.3 * RATE_HZ / max(lengths))


def test_a_tone_is_found_whether_weak_or_so_strong_that_it_colours_the_noise():
    seed = 20261128
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    noise = lfilter([1.0], [1.0, -1.6, 0.8], random.normal(0.0, 1.0, 2000))
    tone = np.sin(2.0 * np.pi * 28.7 * np.arange(2000) / RATE_HZ + 1.0)
    for amplitude in (2.0, 5.0, 20.0, 80.0):
        first, *_ = tones(*coloured([noise + amplitude * tone], 24))
        assert first == pytest.approx(28.7, abs=0.3 * RATE_HZ / 2000)


def test_noise_has_a_tone_as_rarely_as_promised():
    seed = 20261126
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    found = sum(bool(tones(*white(random.normal(0.0, 1.0, (2, 2000))))) for _ in range(300))
    assert found <= CHANCE * 300 + 3.0 * np.sqrt(CHANCE * 300)


@pytest.mark.slow
def test_a_floor_that_shakes_between_the_trials_of_the_library_is_found():
    seed = 20261127
    print(f'seed {seed}')
    nominal = Variant.of(load_model('rigid'))
    effect, axis = find('floor_vibration'), 'y_linear'
    hidden = {'cosine': 0.05, 'sine': -0.08, 'frequency': 17.3}
    timing = Timing()
    noisy = with_noise(
        effect.apply(nominal, axis, hidden), nominal, 1.0, np.random.default_rng(seed)
    )
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment('step'), twin.servo_parameters, timing.servo_hz
    )
    problem = Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(1.0)))])
    base = evaluate(problem)
    toned = at_tones(problem, base, candidates(problem, [effect]))
    found = signatures(problem, base, toned, 1, lambda *_: None)
    first, *_ = screen(problem, base, toned, found, [], Settings().prior_scales)
    fitted = fit_causes(problem, (first.cause,))
    assert 2.0 * (fitted.log_likelihood - base.log_likelihood) > 50.0
    values = fitted.causes[0].values
    assert values['frequency'] == pytest.approx(17.3, abs=0.1)
    assert np.hypot(values['cosine'], values['sine']) == pytest.approx(
        np.hypot(0.05, 0.08), rel=0.1
    )
