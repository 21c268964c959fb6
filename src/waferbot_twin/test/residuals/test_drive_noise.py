# SPDX-License-Identifier: Apache-2.0
"""
Noise of a measured current: what is taken out of it, and what a fit finds beside it.

The machine is a rotor with dry and viscous friction in explicit steps: no code of the twin makes logs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.noise_of_currents import noise_of_currents, without_noise_of_currents
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.drive_noise import (
    CurrentNoise,
    by_octaves,
    quieter,
    white_floor,
    white_floors,
    without_noise,
)
from waferbot_twin.residuals.from_measured_log import record_of_measured_log
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.windows import Windows

AXIS = 'x_rotate'
SEED = 31
SAMPLES, TICKS = 4000, 4
"""Samples of a current, and ticks in one."""

KINDS = [('straight', (float(TICKS), 2)), ('held', (float(TICKS), 1))]


def at_ticks(samples, kind):
    if kind == 'held':
        return np.repeat(samples, TICKS)
    return np.interp(np.arange(SAMPLES * TICKS) / TICKS, np.arange(SAMPLES), samples)


def current():
    """Return a step with a slow wave, A."""
    sample = np.arange(SAMPLES)
    return np.where(sample < SAMPLES // 2, 1.0, 1.5) + 0.3 * np.sin(0.02 * sample)


def noise(sigma):
    return sigma * np.random.default_rng(SEED).standard_normal(SAMPLES)


@pytest.mark.parametrize(('kind', 'between'), KINDS)
@pytest.mark.parametrize('sigma', [0.05, 0.5])
@pytest.mark.parametrize('samples', [64, 512])
def test_white_noise_is_found_and_taken_out(kind, between, sigma, samples) -> None:
    true, read = (at_ticks(one, kind) for one in (current(), current() + noise(sigma)))
    assert white_floor([by_octaves(read, *between)]) == pytest.approx(sigma, rel=0.15)
    left = quieter(read, CurrentNoise(sigma, samples), *between)
    assert np.std(left - true) < 0.5 * np.std(read - true)


@pytest.mark.parametrize(('kind', 'between'), KINDS)
def test_a_current_without_noise_stays(kind, between) -> None:
    """A wave that begins and ends where it is level has next to nothing above its own frequency."""
    true = at_ticks(np.cos(np.linspace(0.0, 20.0 * np.pi, SAMPLES)), kind)
    assert white_floor([by_octaves(true, *between)]) < 1e-3
    np.testing.assert_allclose(quieter(true, CurrentNoise(0.0, 64), *between), true, atol=1e-12)


def test_a_short_window_keeps_what_comes_and_goes() -> None:
    """A move in each 800 samples, with all frequencies in it, and a standstill after it."""
    sample = np.arange(SAMPLES) % 800
    true = np.where(sample < 160, np.sin(0.0075 * sample**2), 0.0)
    read = true + noise(0.1)
    short, long = (
        quieter(at_ticks(read, 'straight'), CurrentNoise(0.1, samples), float(TICKS), 2)[::TICKS]
        - true
        for samples in (64, 2048)
    )
    assert np.std(short) < 0.8 * np.std(long)


def test_what_is_too_short_has_no_floor_and_stays() -> None:
    few = np.arange(10.0)
    assert white_floor([by_octaves(few, 1.0, 2)]) == 0.0
    np.testing.assert_array_equal(quieter(few[:3], CurrentNoise(1.0, 64), 1.0, 2), few[:3])


def test_the_floor_of_short_logs_is_that_of_all_of_them() -> None:
    """The least of single ones would be as low as chance makes it."""
    parts = [
        by_octaves(part, float(TICKS), 2)
        for part in np.split(at_ticks(1.0 + noise(0.2), 'straight'), 40)
    ]
    assert white_floor(parts) == pytest.approx(0.2, rel=0.1)
    assert min(white_floor([part]) for part in parts) < 0.17


def test_gaps_stay_and_so_does_the_mean(motor) -> None:
    record = record_of_measured_log(spin_up(0.1), motor)
    record.current[300:900, 1] = np.nan
    left = without_noise(record, {AXIS: CurrentNoise(0.1, 256)}).current
    assert np.array_equal(np.isnan(left), np.isnan(record.current))
    before, after = (np.nanmean(one[:, 1]) for one in (record.current, left))
    assert after == pytest.approx(before, rel=1e-3)


INERTIA, COULOMB, VISCOUS, PER_AMPERE = 2e-5, 0.02, 6e-5, 0.0318


def spin_up(sigma, answered=False):
    """
    Return 12 s at 1 kHz of a rotor that two levels of the current drive, read with noise.

    Or driven by what is read, noise and all, straight from sample to sample.
    """
    step_s, every, count = 5e-5, 20, 12000
    levels = np.where(np.arange(count + 1) < count // 2, 1.1, 1.5)
    read = levels + sigma * np.random.default_rng(SEED).standard_normal(count + 1)
    acts = read if answered else levels
    angle = speed = 0.0
    angles = []
    for row in range(count * every):
        place, part = divmod(row, every)
        if part == 0:
            angles.append(angle)
        now = levels[place]
        if answered:
            now = acts[place] + (part + 0.5) / every * (acts[place + 1] - acts[place])
        speed += (PER_AMPERE * now - COULOMB - VISCOUS * speed) / INERTIA * step_s
        angle += speed * step_s
    time_s = np.arange(count) * step_s * every
    counts = np.round(np.array(angles) * 20000 / (2.0 * np.pi))
    return MeasuredLog(
        'log',
        (
            Signal('position', AXIS, 'rad', time_s, counts * 2.0 * np.pi / 20000),
            Signal('current', AXIS, 'A', time_s, read[:-1]),
        ),
    )


def fitted(nominal, record):
    """Return the inertia that is fitted beside both frictions, and the values of these."""
    problem = Problem(nominal, [record])
    causes = fit_causes(
        problem,
        tuple(
            Cause(effect, AXIS, effect.complete(nominal, AXIS, {}))
            for effect in map(find, ('coulomb_friction', 'viscous_friction', 'wrong_inertia'))
        ),
    ).causes
    coulomb, viscous, inertia = (next(iter(cause.values.values())) for cause in causes)
    return 9e-6 + inertia, coulomb, viscous


@pytest.fixture(scope='module')
def motor():
    return Variant.of(load_model_or_machine('solo_motor'))


@pytest.mark.parametrize('sigma', [0.1, 0.5])
def test_an_inertia_is_right_without_the_noise_and_too_large_with_it(motor, sigma) -> None:
    """A tenth or half of the current is noise; taken for torque it takes the inertia to its bound."""
    record = record_of_measured_log(spin_up(sigma), motor)
    assert noise_of_currents(motor, [Windows(record)])[AXIS].ampere == pytest.approx(
        sigma, rel=0.15
    )
    (quiet,), (told,) = without_noise_of_currents(motor, [Windows(record)], [Windows(record)])
    assert 'A RMS are noise' in told
    inertia, *_ = fitted(motor, record)
    assert inertia > 1.5 * INERTIA
    inertia, coulomb, viscous = fitted(motor, quiet.record)
    assert inertia == pytest.approx(INERTIA, rel=0.02)
    assert coulomb == pytest.approx(COULOMB, rel=0.01)
    assert viscous == pytest.approx(VISCOUS, rel=0.02)


def test_a_current_that_the_machine_answers_is_no_noise(motor) -> None:
    """As white as noise would be, but it is what moves the machine."""
    record = record_of_measured_log(spin_up(0.1, answered=True), motor)
    assert white_floors([record])[AXIS] == pytest.approx(0.1, rel=0.15)
    assert not noise_of_currents(motor, [Windows(record)])
    (same,), told = without_noise_of_currents(motor, [Windows(record)], [Windows(record)])
    assert not told
    np.testing.assert_array_equal(same.record.current, record.current)
    inertia, *_ = fitted(motor, record)
    assert inertia == pytest.approx(INERTIA, rel=0.02)


def test_logs_without_a_measured_current_have_none(motor) -> None:
    position, current = spin_up(0.1).signals
    told = replace(current, kind='force', unit='Nm', value=PER_AMPERE * current.value)
    record = record_of_measured_log(MeasuredLog('log', (position, told)), motor)
    assert not white_floors([record])
    assert not noise_of_currents(motor, [Windows(record)])
