# SPDX-License-Identifier: Apache-2.0
"""
Current limits: peak at once, continuous when the thermal allowance I2T has run out.

The peak current may flow for the I2T time; what that allows is the set point, eq. (3.2),

    set point = (i_peak^2 - i_continuous^2) * t_I2T        A^2 s

and what has been used of it is the accumulator, eq. (3.3), never below zero,

    accumulator(n+1) = max(0, accumulator(n) + (i_actual^2 - i_continuous^2) * dt)

Above the set point the command is limited to the continuous current. The accumulator then rests
where it is until less than the continuous current flows, so the limit is latched and let go only
1 % below the set point; without that the limit would chatter on the ripple of the current.

Two accumulators run beside each other: one for the ratings of the drive, one for the limits that
the user sets to protect the motor. i_actual is the amplitude of the three measured line currents,
so the limit acts at the same time at every commutation angle, also at standstill.
"""

from __future__ import annotations

from waferbot_lockstep.compiled import compiled

PEAK_CURRENT = 1
CONTINUOUS_CURRENT = 2
VOLTAGE = 4
"""Bits of `AmplifierState.limits`."""

DRIVE, USER = 0, 1
"""The two accumulators."""

RELEASE_FRACTION = 0.99


def i2t_setpoint(peak_current: float, continuous_current: float, i2t_time: float) -> float:
    """Return the allowance of eq. (3.2) in A^2 s, from amperes and seconds."""
    return (peak_current**2 - continuous_current**2) * i2t_time


@compiled
def accumulate(accumulator, current_squared, continuous_current, tick_s):
    """Return the accumulator of eq. (3.3) in A^2 s, one tick later."""
    accumulator += (current_squared - continuous_current * continuous_current) * tick_s
    return accumulator if accumulator > 0.0 else 0.0


@compiled
def is_limited(was_limited, accumulator, setpoint):
    """Tell whether the continuous limit holds now: latched above the set point to 1 % below."""
    if was_limited:
        return accumulator > RELEASE_FRACTION * setpoint
    return accumulator > setpoint


@compiled
def clamp(value, limit):
    """Return `value` held between -limit and +limit."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value
