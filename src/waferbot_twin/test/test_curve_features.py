# SPDX-License-Identifier: Apache-2.0
"""Features of curves against closed forms: decaying cosines, sums of sines, shifted curves."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin import curve_features as features

TIME = np.arange(0.0, 0.6, 1.0 / 9000.0)


def decaying(frequency_hz: float, rate: float, time: np.ndarray = TIME) -> np.ndarray:
    """Return 1 - exp(-r t) cos(w t): it turns where tan(w t) = -r / w."""
    return 1.0 - np.exp(-rate * time) * np.cos(2.0 * np.pi * frequency_hz * time)


def test_turning_points_are_those_of_the_closed_form() -> None:
    omega, rate = 2.0 * np.pi * 20.0, 15.0
    found = features.turning_points(TIME, decaying(20.0, rate), 0.02)
    first = (np.pi - np.arctan(rate / omega)) / omega
    expected = first + np.pi / omega * np.arange(len(found))
    np.testing.assert_allclose([moment for moment, _ in found], expected, atol=1.2e-4)
    heights = 1.0 - np.exp(-rate * expected) * np.cos(omega * expected)
    np.testing.assert_allclose([value for _, value in found], heights, atol=3e-5)  # half a sample
    swings = np.abs(np.diff([value for _, value in found]))
    assert np.all(swings >= 0.02)  # smaller ones are passed over
    assert features.turning_points(TIME, TIME, 0.02) == []


def test_crossings() -> None:
    values = np.sin(2.0 * np.pi * 10.0 * (TIME + 0.01))
    assert features.crossings(values, 0.0) == 12  # two for each of the six periods in 0.6 s


@pytest.mark.parametrize('frequency_hz', [75.0, 435.0])
def test_strongest_line_is_found_beside_the_slow_part_of_a_step(frequency_hz: float) -> None:
    slow = decaying(24.0, 30.0)
    line = 0.01 * np.sin(2.0 * np.pi * frequency_hz * TIME)
    found = features.strongest_line(TIME, slow + line, (50.0, 1125.0), 1.0)
    assert found.frequency_hz == pytest.approx(frequency_hz, abs=1.0)
    assert found.amplitude == pytest.approx(0.01, rel=0.05)


def test_the_flank_of_a_slow_part_is_no_line() -> None:
    curve = 1.0 - np.exp(-TIME / 0.01)
    found = features.strongest_line(TIME, curve, (50.0, 60.0), 1.0)
    assert found.amplitude == 0.0
    assert np.isnan(found.frequency_hz)


def test_low_pass_takes_vibration_and_leaves_the_response() -> None:
    response = decaying(24.0, 30.0)
    curve = response + 0.03 * np.sin(2.0 * np.pi * 600.0 * TIME)
    slow = features.low_passed(TIME, curve, 300.0)
    inside = (TIME > 0.02) & (TIME < 0.5)
    assert np.abs(slow - response)[inside].max() < 0.001


@pytest.mark.parametrize('shift', [-37, 0, 12])
def test_lead_is_the_shift_between_two_curves(shift: int) -> None:
    long = np.arange(-0.1, 0.7, 1.0 / 9000.0)
    curve = np.where(long > 0.0, decaying(24.0, 30.0, long), 0.0)
    place = 1000
    first = curve[place : place + 2000]
    second = curve[place - shift : place - shift + 2000]
    time = long[place : place + 2000]
    assert features.lead(time, first, second) == pytest.approx(shift / 9000.0, abs=1e-9)


def test_time_of_final_amplitude_is_where_growth_ends() -> None:
    """Amplitude grows with a time constant of 0.1 s until 0.4 s: 0.9 is 0.1 ln(1 / 0.9) before."""
    time = np.arange(0.0, 2.0, 1.0 / 9000.0)
    amplitude = np.exp((np.minimum(time, 0.4) - 0.4) / 0.1)
    curve = amplitude * np.sin(2.0 * np.pi * 50.0 * time)
    found = features.time_of_final_amplitude(time, curve)
    assert found == pytest.approx(0.4 - 0.1 * np.log(1.0 / 0.9), abs=0.012)  # a period is 0.02 s
    assert np.isnan(features.time_of_final_amplitude(time, time))


def test_time_above() -> None:
    values = np.where((TIME > 0.1) & (TIME < 0.15), -2.0, 0.5)
    assert features.time_above(TIME, values, 1.0) == pytest.approx(0.05, abs=2.5e-4)
