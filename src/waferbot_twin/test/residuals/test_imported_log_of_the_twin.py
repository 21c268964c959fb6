# SPDX-License-Identifier: Apache-2.0
"""Imported logs of a machine with a PMAC: the model's own controller closes the loop over them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.simulated import simulated_log
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.from_measured_log import aligned_record
from waferbot_twin.residuals.problem import CONTROLLER, Problem
from waferbot_twin.validation.gain import gains

AXIS = 'x_rotate'


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


@pytest.fixture(scope='module')
def log(rigid):
    """What the twin does for a smooth swing, as a log that has one axis only, in SI units."""
    time_s = np.arange(int(0.4 * Timing().servo_hz)) / Timing().servo_hz
    swing = 2e-3 * (1.0 - np.cos(2.0 * np.pi * 7.0 * time_s))
    told = Signal('commanded_position', AXIS, 'rad', time_s, swing)
    whole = simulated_log(rigid, MeasuredLog('swing', (told,)), Timing())
    kinds = ('position', 'commanded_position', 'current')
    return MeasuredLog('swing', tuple(whole[AXIS, kind] for kind in kinds))


def test_the_twin_does_again_what_its_own_log_says(rigid, log) -> None:
    record = aligned_record(log, rigid)
    assert record.is_imported
    assert record.closes_loop
    assert not any('weaker' in note for note in record.notes)
    found = simulate(rigid, record)
    known = np.isfinite(record.reading[:, 1])
    assert known.sum() > 0.9 * len(known)
    assert np.array_equal(known, np.isfinite(found.reading[:, 1]))
    apart = (found.reading - record.reading)[known, 1]
    assert np.ptp(record.reading[known, 1]) > 400.0
    assert np.abs(apart).max() <= 2.0
    assert np.mean(apart) == pytest.approx(0.0, abs=0.2)


def test_counts_that_the_servo_did_not_see_are_not_replayed(rigid, log) -> None:
    problem = Problem(rigid, [aligned_record(log, rigid)])
    assert not problem.blocks[CONTROLLER]
    ideal = problem.ideal(())
    assert ideal is not None
    (measured,), (noise_free,) = problem.plants, ideal.plants
    assert [len(one) for one in measured.residuals(rigid)] == [
        len(one) for one in noise_free.residuals(rigid)
    ]
    closed = [gain.closed_loop for gain in gains(rigid, rigid, problem.records)]
    assert closed == [True]


def test_between_gaps_that_lie_close_together_no_gain_can_be_told(rigid, log) -> None:
    """A position for 20 ms, none for 10 ms: an observer of some Hz settles in none of these."""
    record = aligned_record(log, rigid)
    reading = record.reading.copy()
    rate_hz = record.timing.encoder_hz
    times_s = np.arange(len(reading)) / rate_hz
    reading[times_s % 0.03 >= 0.02] = np.nan
    assert gains(rigid, rigid, [replace(record, reading=reading, controlled=())]) == []
