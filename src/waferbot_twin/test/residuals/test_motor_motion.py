# SPDX-License-Identifier: Apache-2.0
"""Where the motors were: over how many rows readings are smoothed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from waferbot_twin.residuals.motor_motion import DEGREE, FEWEST, rows_to_smooth

SEED = 20261126


@pytest.mark.parametrize('period', [30.0, 300.0, 3000.0])
def test_smoothed_readings_are_near_the_motion_and_lose_next_to_nothing_of_it(period):
    """The true motion is known here: no other number of rows brings them twice as near."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    motion = 50.0 * np.sin(2.0 * np.pi * np.arange(9000) / period)
    readings = np.floor(motion + random.normal(scale=0.5, size=9000)) + 0.5

    def far_off(rows):
        return np.sqrt(np.mean((savgol_filter(readings, rows, DEGREE) - motion) ** 2))

    others = [far_off((FEWEST + 1) * 2**doubled - 1) for doubled in range(8)]
    rows = rows_to_smooth(readings)
    assert far_off(rows) <= 2.0 * min(others)
    lost = np.sqrt(np.mean((savgol_filter(motion, rows, DEGREE) - motion) ** 2))
    assert rows == FEWEST or lost < 0.1 * far_off(rows)


def test_an_axis_that_stands_between_two_counts_has_no_motion():
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    readings = np.floor(random.normal(scale=0.3, size=9000))
    rows = rows_to_smooth(readings)
    assert np.std(savgol_filter(readings, rows, DEGREE)) < 0.15 * np.std(readings)


def test_a_log_of_few_readings_is_smoothed_over_the_fewest_rows():
    assert rows_to_smooth(np.arange(20.0)) == FEWEST
