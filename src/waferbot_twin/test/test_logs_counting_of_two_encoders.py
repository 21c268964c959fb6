# SPDX-License-Identifier: Apache-2.0
"""How two encoders of one axis count, told by the mean of what they differ."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.logs.counting import FLOOR, ROUND, told_by_both
from waferbot_twin.logs.measured import Signal

SEED, COUNT = 4, 1e-4


def pair(how, steps, readings):
    """Return an axis and its motor on a path that crosses many steps of both."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    time_s = 1e-3 * np.arange(readings)
    path = 0.2 * np.sin(7.0 * time_s) + 1e-3 * random.standard_normal(readings)
    half = {FLOOR: 0.0, ROUND: 0.5}[how]
    return tuple(
        Signal(kind, 'y_rotate', 'rad', time_s, step * np.floor(path / step + half), step)
        for kind, step in zip(('position', 'motor_position'), steps, strict=True)
    )


@pytest.mark.parametrize('how', [FLOOR, ROUND])
@pytest.mark.parametrize('ratio', [1.6, 5.0])
def test_steps_of_similar_size_tell_it_if_there_are_readings_enough(how, ratio):
    """Half counts of 1 and 1.6 steps differ by a fifth of the larger one."""
    position, motor = pair(how, (COUNT, ratio * COUNT), 8000)
    assert told_by_both(position, motor, 1.0, (True, True)) == how


def test_few_readings_and_equal_steps_tell_nothing():
    assert not told_by_both(*pair(FLOOR, (COUNT, 1.02 * COUNT), 400), 1.0, (True, True))
    assert not told_by_both(*pair(FLOOR, (COUNT, COUNT), 8000), 1.0, (True, True))
