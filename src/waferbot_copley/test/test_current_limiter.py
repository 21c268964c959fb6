# SPDX-License-Identifier: Apache-2.0
"""Peak and I2T limits: the time they act at, what they leave, when they let go."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from waferbot_copley.amplifier import report
from waferbot_copley.limiter import CONTINUOUS_CURRENT, PEAK_CURRENT, clamp, i2t_setpoint

RIGHT_ANGLE = math.pi / 2


def limited_command(stand, command, actual):
    """
    Return what is left of a command while the motor carries `actual` A (both at 90 degrees).

    With Ci = 0 the voltage of line 1 is Kp times the error, which gives the command away.
    """
    stand.lines = actual * stand.phasing(RIGHT_ANGLE)
    return stand.amplifier_only(command, RIGHT_ANGLE)[0] / stand.loop_gains()[0] + actual


@pytest.fixture
def proportional_stand(drive_stand):
    """Make stands whose loop has no integrator."""
    return functools.partial(drive_stand, integral_gain=0, limit_order=0)


def reported_limits(stand):
    """Ask for a report; return the limits of the axis."""
    limits = np.zeros(3, np.uint8)
    report(
        stand.state, stand.parameters, 7, np.zeros(3), np.zeros(3), limits, np.zeros(3, np.uint32)
    )
    return limits[stand.axis]


def test_setpoint_of_the_manuals_example():
    """12 A peak, 6 A continuous, 1 s: 108 A^2 s."""
    assert i2t_setpoint(12.0, 6.0, 1.0) == 108.0


@given(st.floats(-1e6, 1e6), st.floats(0.0, 1e6))
def test_clamp(value, limit):
    """The clamp is the one of NumPy."""
    assert clamp(value, limit) == np.clip(value, -limit, limit)


@pytest.mark.parametrize('command', [55.0, -55.0])
def test_peak_limit(proportional_stand, command):
    """The amplitude of a command never exceeds the peak current, and the report says so."""
    stand = proportional_stand(peak_current=40.0)
    assert limited_command(stand, 39.9, 0.0) == pytest.approx(39.9)
    assert reported_limits(stand) == 0
    assert limited_command(stand, command, 0.0) == pytest.approx(math.copysign(40.0, command))
    assert reported_limits(stand) == PEAK_CURRENT
    limited_command(stand, 1.0, 0.0)
    assert reported_limits(stand) == 0


def test_user_peak_limit_is_the_lower_one(proportional_stand, drive_stand):
    """A limit of the user below the drive's rating holds; the loop's scale stays the drive's."""
    stand = proportional_stand(peak_current=40.0, user_peak_current=15.0)
    free = drive_stand(integral_gain=0, limit_order=0, peak_current=40.0)
    assert limited_command(stand, 30.0, 0.0) == pytest.approx(15.0)
    assert stand.loop_gains() == free.loop_gains()


@pytest.mark.parametrize(
    ('peak', 'continuous', 'time', 'actual'),
    [(12.0, 6.0, 0.3, 12.0), (40.0, 20.0, 0.5, 35.0), (18.0, 6.0, 0.2, 9.0)],
)
def test_i2t_trips_at_the_analytic_time(proportional_stand, peak, continuous, time, actual):
    """
    A constant current I trips after setpoint / (I^2 - I_continuous^2).

    The peak current itself trips after the I2T time.
    """
    stand = proportional_stand(peak_current=peak, continuous_current=continuous, i2t_time=time)
    analytic = (peak**2 - continuous**2) * time / (actual**2 - continuous**2)
    ticks = 0
    while limited_command(stand, peak, actual) > continuous * 1.001:
        ticks += 1
    assert abs(ticks - analytic * stand.tick_hz) <= 1
    assert limited_command(stand, peak, actual) == pytest.approx(continuous)
    assert reported_limits(stand) & CONTINUOUS_CURRENT


def test_amplitude_counts_at_every_angle(proportional_stand):
    """The limit acts after the same time wherever the motor stands."""
    trips = []
    for angle in np.linspace(0.0, 2 * math.pi, 7):
        stand = proportional_stand(i2t_time=0.02)
        stand.lines = 40.0 * stand.phasing(angle)
        ticks = 0
        while not stand.field('i2t_limited')[0]:
            stand.amplifier_only(40.0, angle)
            ticks += 1
        trips.append(ticks)
    assert max(trips) - min(trips) <= 1


def test_limit_lets_go_one_percent_below_the_setpoint(proportional_stand):
    """Below the continuous current the accumulator empties at the rate of eq. (3.3)."""
    stand = proportional_stand(peak_current=20.0, continuous_current=10.0, i2t_time=0.1)
    setpoint = (20.0**2 - 10.0**2) * 0.1
    while limited_command(stand, 20.0, 20.0) > 10.01:
        pass
    for _ in range(500):  # rests at the limit
        assert limited_command(stand, 20.0, 10.0) == pytest.approx(10.0)
    start = stand.field('i2t_accumulator')[0]
    ticks = 0
    while limited_command(stand, 20.0, 6.0) < 10.01:
        ticks += 1
    analytic = (start - 0.99 * setpoint) / (10.0**2 - 6.0**2) * stand.tick_hz
    assert abs(ticks - analytic) <= 1


def test_ripple_about_the_continuous_current_does_not_chatter(proportional_stand):
    """With 5 % ripple on the measured current the limit holds without a gap."""
    stand = proportional_stand(peak_current=20.0, continuous_current=10.0, i2t_time=0.1)
    while not stand.field('i2t_limited')[0]:
        limited_command(stand, 20.0, 20.0)
    for tick in range(2000):
        ripple = 0.5 * math.sin(2 * math.pi * 600 * tick / stand.tick_hz) - 0.02
        assert limited_command(stand, 20.0, 10.0 + ripple) == pytest.approx(10.0)


def test_accumulator_is_never_negative(proportional_stand):
    """Rest does not earn credit: afterwards the full allowance holds, and no more."""
    stand = proportional_stand(peak_current=20.0, continuous_current=10.0, i2t_time=0.05)
    for _ in range(5000):
        limited_command(stand, 0.0, 0.0)
    assert stand.field('i2t_accumulator').tolist() == [0.0, 0.0]
    ticks = 0
    while limited_command(stand, 20.0, 20.0) > 10.01:
        ticks += 1
    assert abs(ticks - 0.05 * stand.tick_hz) <= 1


def test_user_and_drive_accumulate_beside_each_other(proportional_stand):
    """The user's motor limit trips first here, and is the one reported; the drive's goes on."""
    stand = proportional_stand(
        peak_current=40.0, continuous_current=20.0, i2t_time=1.0,
        user_peak_current=20.0, user_continuous_current=5.0, user_i2t_time=0.1,
    )  # fmt: skip
    ticks = 0
    while limited_command(stand, 20.0, 20.0) > 5.01:
        ticks += 1
    assert abs(ticks - 0.1 * stand.tick_hz) <= 1
    assert stand.field('i2t_limited').tolist() == [0, 1]
    assert stand.field('i2t_accumulator')[0] == 0.0  # 20 A is the drive's continuous current
    accumulator, setpoint = np.zeros(3), np.zeros(3)
    report(
        stand.state, stand.parameters, 7, accumulator, setpoint, np.zeros(3, np.uint8),
        np.zeros(3, np.uint32),
    )  # fmt: skip
    assert setpoint[1] == pytest.approx((20.0**2 - 5.0**2) * 0.1)
    assert accumulator[1] >= setpoint[1]


def test_closed_loop_falls_back_to_the_continuous_current(drive_stand):
    """On a motor the amplitude stands at the peak, then at the continuous current."""
    stand = drive_stand(peak_current=20.0, continuous_current=10.0, i2t_time=0.05, limit_order=0)
    amplitudes = []
    for _ in range(1800):
        lines = stand.tick(30.0, 1.0)
        amplitudes.append(math.sqrt(2 / 3 * (lines**2).sum()))
    assert amplitudes[600] == pytest.approx(20.0, rel=1e-3)
    assert amplitudes[-1] == pytest.approx(10.0, rel=1e-3)


@pytest.mark.parametrize('line', [0, 1, 2])
def test_limit_after_the_phasing_clips_each_line(drive_stand, line):
    """
    The thesis' order clips every line, and what three clipped lines leave over is not controlled.

    Where one line carries the whole command the others carry half of it, so that line alone is
    clipped; a motor without neutral then takes the three values less their mean.
    """
    stand = drive_stand(integral_gain=0, limit_order=1, peak_current=10.0, continuous_current=5.0)
    voltage = stand.amplifier_only(14.0, RIGHT_ANGLE + line * 2 * math.pi / 3)
    clipped = np.full(3, -7.0)
    clipped[line] = 10.0
    assert voltage / stand.loop_gains()[0] == pytest.approx(clipped - clipped.mean(), abs=1e-6)
    assert reported_limits(stand) == PEAK_CURRENT


def test_lowest_limit_holds(proportional_stand):
    """An exhausted drive does not lift the command above a lower peak limit of the user."""
    stand = proportional_stand(
        i2t_time=0.001, user_peak_current=15.0, user_continuous_current=10.0, user_i2t_time=100.0
    )
    for _ in range(100):
        assert limited_command(stand, 30.0, 38.0) == pytest.approx(15.0)
    assert stand.field('i2t_limited').tolist() == [1, 0]
