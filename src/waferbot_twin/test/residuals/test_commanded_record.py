# SPDX-License-Identifier: Apache-2.0
"""What commands explain of a log: the response of a loop, and nothing of its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.timing import Timing
from waferbot_twin.residuals.commanded_record import as_commanded, tells_command
from waferbot_twin.residuals.record import Record

SEED = 9
X = AXES.index('x_rotate')
ENCODER = ENCODERS.index('x_rotate')
TIMING = Timing(4000, 2, 4)
ROWS = 8000


@pytest.fixture
def random():
    print(f'seed {SEED}')
    return np.random.default_rng(SEED)


def log_of(random, noise):
    """
    Return the log of a loop of second order with dry friction in its drive, and both without noise.

    The controller answers to the noise of the position.
    """
    steps = np.repeat(random.uniform(-3000.0, 3000.0, 16), ROWS // 32)
    path = lfilter(np.full(80, 1 / 80.0), [1.0], steps)
    command = np.full((len(path), len(AXES)), np.nan)
    command[:, X] = path
    held = np.repeat(path, 2)
    poles = np.exp(np.array([-0.02 + 0.03j, -0.02 - 0.03j]))
    answer = np.real(np.poly(poles))
    position = lfilter([answer.sum()], answer, held - held[0]) + held[0]
    speed = np.gradient(position) * TIMING.encoder_hz
    drive = 1e-5 * np.gradient(speed) + 1e-5 * speed + 0.4 * np.sign(np.round(speed, 3))
    shaken = noise * random.standard_normal(ROWS)
    reading = np.full((ROWS, len(ENCODERS)), np.nan)
    reading[:, ENCODER] = position + shaken
    current = np.full((2 * ROWS, len(AXES)), np.nan)
    current[:, X] = np.repeat(drive - 0.05 * shaken, 2)
    nothing = np.full((2 * ROWS, 2 * len(AXES)), np.nan)
    record = Record('log', TIMING, nothing, reading, command, None, current=current, controlled=())
    return record, position, np.repeat(drive, 2)


def test_the_response_is_found_and_the_noise_is_not(random) -> None:
    record, position, drive = log_of(random, noise=2.0)
    assert tells_command(record)
    found = as_commanded(record)
    seen, driven = found.reading[:, ENCODER], found.current[:, X]
    # Some forty numbers of 8000 samples: a fourteenth of the noise.
    assert np.std(seen - position) < 0.1 * 2.0
    assert np.corrcoef(driven, drive)[0, 1] > 0.9
    measured = record.reading[:, ENCODER] - position
    assert abs(np.corrcoef(seen - position, measured)[0, 1]) < 0.2
    assert abs(np.corrcoef(driven - drive, np.repeat(measured, 2))[0, 1]) < 0.1


def test_gaps_stay_and_what_was_not_commanded_stays_as_measured(random) -> None:
    record, *_ = log_of(random, noise=1.0)
    record.reading[100:200, ENCODER] = np.nan
    record.current[1000:1100, X] = np.nan
    found = as_commanded(record)
    for one, other in ((found.reading, record.reading), (found.current, record.current)):
        np.testing.assert_array_equal(np.isnan(one), np.isnan(other))
    uncommanded = replace(record, commanded=None)
    assert not tells_command(uncommanded)
    np.testing.assert_array_equal(as_commanded(uncommanded).reading, record.reading)
    recorded = replace(record, current=None)
    assert not tells_command(recorded)
    assert as_commanded(recorded) is recorded
