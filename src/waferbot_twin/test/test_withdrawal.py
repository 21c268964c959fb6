# SPDX-License-Identifier: Apache-2.0
"""When an extension that was found is withdrawn for what it does to the positions."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.diagnosis.gain import AxisGain
from waferbot_twin.diagnosis.withdrawal import loses

AXES = ('y_linear', 'x_rotate', 'y_rotate')
SAMPLES = 2000
BEFORE = 2e-6 * np.sin(np.linspace(0.0, 120.0 * np.pi, SAMPLES))


def gain(axis, before, after):
    time_s = np.arange(SAMPLES) * 1e-3
    return AxisGain('log', axis, 'm', time_s, np.zeros(SAMPLES), before, after, True)


@pytest.mark.parametrize(
    ('ratios', 'worse'),
    [
        ((1.000001, 1.0, 1.0), False),  # as of a warm winding
        ((0.7, 1.02, 1.0), False),
        ((1.0, 1.05, 1.0), True),
        ((0.98, 1.3, 0.99), True),
        ((), False),
    ],
)
def test_an_extension_is_withdrawn_if_it_plainly_loses(ratios, worse):
    gains = [gain(axis, BEFORE, ratio * BEFORE) for axis, ratio in zip(AXES, ratios, strict=False)]
    assert loses(gains) is worse


def test_what_is_lost_in_one_stretch_alone_may_be_chance():
    after = BEFORE.copy()
    after[300:400] *= 1.5  # 3 % more in RMS, by one stretch of twenty
    assert np.std(after) / np.std(BEFORE) > 1.02
    assert not loses([gain('x_rotate', BEFORE, after)])


def test_what_is_lost_in_one_stretch_alone_counts_if_it_is_much():
    after = BEFORE.copy()
    after[300:400] *= 4.0
    assert np.std(after) / np.std(BEFORE) > 1.3
    assert loses([gain('x_rotate', BEFORE, after)])


def test_noise_of_the_machine_makes_no_true_model_lose():
    seed = 20261121
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    lost = 0
    for _ in range(100):
        white = random.normal(size=SAMPLES + 39)
        noise = np.convolve(white, np.ones(40) / 40.0, 'valid')
        moved = 0.05 * np.roll(noise, int(random.integers(SAMPLES)))
        lost += loses([gain('x_rotate', noise, noise + moved)])
    assert lost <= 5
