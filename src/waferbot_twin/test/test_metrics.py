# SPDX-License-Identifier: Apache-2.0
"""Figures of a step against the closed form of a second-order system, and against the thesis."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from waferbot_twin.metrics import (
    percent_difference,
    performance_improvement,
    rms,
    step_metrics,
)

INTERVAL_S = 1.0 / 9000.0


def second_order(time, frequency: float, damping: float):
    """Unit step response of w^2 / (s^2 + 2 z w s + w^2), z < 1."""
    damped = frequency * math.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * frequency * time)
    return 1.0 - decay * (
        np.cos(damped * time) + damping * frequency / damped * np.sin(damped * time)
    )


@settings(deadline=None, max_examples=60)
@given(
    frequency=st.floats(40.0, 160.0),
    damping=st.floats(0.15, 0.6),
    step=st.sampled_from([2.5e-4, -4.79e-3, 1.0]),
)
def test_second_order_step(frequency: float, damping: float, step: float) -> None:
    time = np.arange(0.0, 30.0 / (damping * frequency), INTERVAL_S)
    figures = step_metrics(time, step * second_order(time, frequency, damping), step)
    damped = frequency * math.sqrt(1.0 - damping**2)
    overshoot = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    delay = brentq(
        lambda t: float(second_order(t, frequency, damping)) - 0.5, 0.0, math.pi / damped
    )
    # The curve bends by at most w^2 between samples, and the peak falls between two of them.
    bend = (frequency * INTERVAL_S) ** 2
    assert figures.delay_time == pytest.approx(delay, abs=bend / frequency)
    rise = (math.pi - math.acos(damping)) / damped
    assert figures.rise_time == pytest.approx(rise, abs=bend / frequency)
    assert figures.peak_time == pytest.approx(math.pi / damped, abs=INTERVAL_S)
    assert figures.overshoot_percent == pytest.approx(100.0 * overshoot, abs=100.0 * bend)
    assert figures.peak == pytest.approx(step * (1.0 + overshoot), abs=abs(step) * bend)
    # Settling: the last extremum outside the band, then where the curve enters it for good. Left out
    # where an extremum lies on the edge of the band, which sampling may see on either side.
    heights = overshoot ** np.arange(1, 60)
    last = int(np.flatnonzero(heights > 0.05)[-1]) + 1 if heights[0] > 0.05 else 0
    if np.min(np.abs(heights - 0.05)) > 10.0 * bend:
        edge = 1.0 + (0.05 if last % 2 else -0.05)
        settling = brentq(
            lambda t: float(second_order(t, frequency, damping)) - edge,
            last * math.pi / damped,
            (last + 1) * math.pi / damped,
        )
        assert figures.settling_time == pytest.approx(settling, abs=INTERVAL_S)


def test_an_overdamped_step_has_no_overshoot_and_no_rise() -> None:
    time = np.arange(0.0, 0.5, INTERVAL_S)
    figures = step_metrics(time, 1.0 - np.exp(-time / 0.1), 1.0)
    assert figures.delay_time == pytest.approx(0.1 * math.log(2.0), rel=1e-5)
    assert math.isnan(figures.rise_time)
    assert figures.overshoot_percent < 0.0
    assert figures.settling_time == pytest.approx(0.1 * math.log(20.0), rel=1e-5)


def test_not_settled_at_the_end() -> None:
    time = np.arange(0.0, 0.1, INTERVAL_S)
    assert math.isnan(step_metrics(time, 1.1 * np.ones_like(time), 1.0).settling_time)


def two_peaks(first: float):
    """A response with a small peak of height `first` at 12 ms and the main one, 1.5, at 32 ms."""
    time = np.arange(0.0, 0.2, INTERVAL_S)
    knots = np.array([0.0, 0.012, 0.018, 0.032, 0.06, 0.2])
    return time, np.interp(time, knots, [0.0, first, 0.7, 1.5, 1.0, 1.0])


@pytest.mark.parametrize('first', [0.97, 1.03])
def test_main_peak_rule_does_not_depend_on_the_small_peak(first: float) -> None:
    """Whether the initial peak just misses the command or passes it: same rise (chapter 6)."""
    time, response = two_peaks(first)
    rise = step_metrics(time, response, 1.0, 'main-peak').rise_time
    assert rise == pytest.approx(0.018 + 0.014 * 0.3 / 0.8, abs=INTERVAL_S)


def test_first_rule_takes_the_small_peak_when_it_passes() -> None:
    time, response = two_peaks(1.03)
    assert step_metrics(time, response, 1.0).rise_time < 0.012
    time, response = two_peaks(0.97)
    assert step_metrics(time, response, 1.0).rise_time > 0.018


def test_level_shift_shows_a_knife_edge() -> None:
    time, response = two_peaks(1.005)
    low, high = (step_metrics(time, response, 1.0, level_shift=shift) for shift in (-0.01, 0.01))
    assert high.rise_time - low.rise_time > 0.01
    assert high.peak == low.peak


def test_unknown_rise_rule() -> None:
    time, response = two_peaks(1.0)
    with pytest.raises(ValueError, match='main-peak'):
        step_metrics(time, response, 1.0, 'second')


def test_rms_of_a_sine() -> None:
    phase = np.linspace(0.0, 20.0 * np.pi, 200000, endpoint=False)
    assert rms(3.0 * np.sin(phase)) == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-9)
    assert math.isnan(rms(np.array([])))


def test_percent_difference_of_the_thesis() -> None:
    """Rows of Tables 4.1 and 4.2, one of them misprinted there (76.97)."""
    assert percent_difference(6.263e-3, 3.559e-3) == pytest.approx(75.97, abs=0.01)
    assert percent_difference(0.01080, 0.01861) == pytest.approx(41.97, abs=0.01)
    assert percent_difference(6.927e-3, 6.879e-3) == pytest.approx(0.6969, abs=0.002)
    assert math.isnan(percent_difference(1.0, 0.0))


def test_performance_improvement_of_the_thesis() -> None:
    """Rows of Table 6.2: helped, and made worse."""
    assert performance_improvement(75.97, 23.10) == pytest.approx(69.60, abs=0.01)
    assert performance_improvement(6.205, 11.05) == pytest.approx(-78.02, abs=0.1)
    assert performance_improvement(2.5594e-5, 1.789e-5) == pytest.approx(30.07, abs=0.05)
    assert performance_improvement(0.0, 0.0) == 0.0
    assert math.isnan(performance_improvement(0.0, 1.0))
