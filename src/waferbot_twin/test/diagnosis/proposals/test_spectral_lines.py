# SPDX-License-Identifier: Apache-2.0
"""Lines in the spectrum of what is left over."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.proposals.spectral_lines import lines
from waferbot_twin.residuals.problem import PLANT

RATE_HZ = 2250.0


def left_over(channels):
    """Return a problem of one log and a hypothesis with these residuals."""
    problem = SimpleNamespace(
        channel_names=lambda block: list(channels), plant_rates_hz=[RATE_HZ] * len(channels)
    )
    return problem, SimpleNamespace(residuals={PLANT: list(channels.values())})


def test_a_line_is_found_and_noise_has_none():
    seed = 20261123
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    time_s = np.arange(4500) / RATE_HZ
    quiet = random.normal(0.0, 1.0, 4500)
    loud = random.normal(0.0, 1.0, 4500) + 0.5 * np.sin(2.0 * np.pi * 612.0 * time_s)
    (line,) = lines(*left_over({'x_rotate': quiet, 'y_linear': loud}))
    assert line.channel == 'y_linear'
    assert line.frequency_hz == pytest.approx(612.0, abs=RATE_HZ / 1024)
    assert line.rate_hz == pytest.approx(RATE_HZ)


def test_a_ring_at_half_the_rate_of_the_samples_is_a_line():
    seed = 20261126
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    time_s = np.arange(4500) / RATE_HZ
    ring = np.cos(2.0 * np.pi * 1124.6 * time_s)
    (line,) = lines(*left_over({'y_linear': random.normal(0.0, 1.0, 4500) + ring}))
    assert line.frequency_hz == pytest.approx(1124.6, abs=RATE_HZ / 1024)


def test_a_ring_of_a_tenth_of_a_second_is_a_brief_line():
    seed = 20261124
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    time_s = np.arange(9000) / RATE_HZ
    ring = np.exp(-time_s / 0.05) * np.sin(2.0 * np.pi * 556.0 * time_s)
    once = random.normal(0.0, 1.0, 9000)
    once[3000:] += 1.5 * ring[:6000]
    (line,) = lines(*left_over({'y_linear': once}))
    assert line.brief
    assert line.frequency_hz == pytest.approx(556.0, abs=RATE_HZ / 256)


def test_noise_has_a_brief_line_as_seldom_as_it_may_also_where_it_is_louder_while_moving():
    seed = 20261125
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    loudness = np.repeat([1.0, 5.0, 1.0, 2.0], 2250)
    found = 0
    for _ in range(300):
        white = random.normal(0.0, 1.0, 9000)
        coloured = white[1:] - 0.6 * white[:-1]
        found += len(lines(*left_over({'y_linear': coloured * loudness[1:]})))
    # A hundredth each for lines of the mean and for brief ones: six, with a chance of 1e-3 above 15.
    assert found <= 15


def test_what_the_observer_holds_is_no_line():
    time_s = np.arange(4500) / RATE_HZ
    random = np.random.default_rng(1)
    slow = random.normal(0.0, 1.0, 4500) + 5.0 * np.sin(2.0 * np.pi * 40.0 * time_s)
    assert not lines(*left_over({'x_rotate': slow}))
