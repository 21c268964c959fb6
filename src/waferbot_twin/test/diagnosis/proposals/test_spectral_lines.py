# SPDX-License-Identifier: Apache-2.0
"""Lines in the spectrum of what is left over."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from waferbot_twin.diagnosis.proposals.spectral_lines import lasting_lines, lines
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


def test_a_line_lasts_if_all_logs_have_it_at_one_frequency_on_one_axis():
    seed = 20261130
    print(f'seed {seed}')
    random = np.random.default_rng(seed)

    def log(encoder, frequency_hz):
        """Return the ring of each of ten impacts, damped in a twentieth of a second, in noise."""
        time_s = np.arange(4500) / RATE_HZ
        since_s = time_s % 0.2
        ring = np.exp(-since_s / 0.05) * np.sin(2.0 * np.pi * frequency_hz * since_s)
        quiet = random.normal(0.0, 1.0, (2, 4500))
        other = {'x_rotate': 'y_rotate_load', 'y_rotate_load': 'x_rotate'}[encoder]
        return left_over({encoder: quiet[0] + ring, other: quiet[1]})

    first = log('y_rotate_load', 556.0)
    again = lasting_lines(*first, *log('y_rotate_load', 561.0))
    assert again == {'y_rotate': pytest.approx(556.0, abs=0.01 * 556.0)}
    assert not lasting_lines(*first, *log('y_rotate_load', 612.0))
    assert not lasting_lines(*first, *log('x_rotate', 556.0))


def test_a_line_may_be_brief_in_one_log_but_not_in_both():
    seed = 20261204
    print(f'seed {seed}')
    random = np.random.default_rng(seed)

    def log(impacts, damped_s):
        """Return rings after some impacts a second apart, in noise."""
        time_s = np.arange(9000) / RATE_HZ - 0.4
        since_s = np.where((time_s > 0.0) & (time_s < impacts), time_s % 1.0, 9.0)
        ring = 4.0 * np.exp(-since_s / damped_s) * np.sin(2.0 * np.pi * 556.0 * since_s)
        return left_over({'y_linear': random.normal(0.0, 1.0, 9000) + ring})

    often, once, again = log(3, 0.05), log(1, 0.02), log(1, 0.02)
    assert [[line.brief for line in lines(*one)] for one in (often, once, again)] == [
        [False],
        [True],
        [True],
    ]
    for both in ((often, once), (once, often)):
        assert lasting_lines(*both[0], *both[1]) == {'y_linear': pytest.approx(556.0, abs=9.0)}
    assert not lasting_lines(*once, *again)
