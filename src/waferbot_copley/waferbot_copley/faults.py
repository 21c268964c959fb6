# SPDX-License-Identifier: Apache-2.0
"""
Faults of the drive: what each one watches, what it does, how it goes away.

| bit | watches |
|---|---|
| OVER_CURRENT | the line currents: `over_current_ratio` peak currents are a short circuit |
| DRIVE_OVER_TEMPERATURE | the heat sink, heated by the losses of the bridge |
| MOTOR_OVER_TEMPERATURE | the motor's temperature sensor, an input |
| OVER_VOLTAGE, UNDER_VOLTAGE | the bus voltage |
| PHASING | the commutation angle against the motor's Hall sensors, an input |
| FOLLOWING_ERROR | the following-error input, set by whoever closes the position loop |
| I2T | the I2T limit, if the setting `i2t_fault` makes it a fault |
| SAFE_TORQUE_OFF | the safe-torque-off input |

Every one but FOLLOWING_ERROR takes the gate drive away: the bridge is off, the duty is zero, the
motor's terminals are open. A fault whose bit is in the setting `latched_faults` stays until it is
reset, the others go as soon as their cause does.
"""

from __future__ import annotations

from waferbot_copley.commutation import HALF_ROOT_3
from waferbot_lockstep.compiled import compiled

OVER_CURRENT = 1
DRIVE_OVER_TEMPERATURE = 2
MOTOR_OVER_TEMPERATURE = 4
OVER_VOLTAGE = 8
UNDER_VOLTAGE = 16
PHASING = 32
FOLLOWING_ERROR = 64
I2T = 128
SAFE_TORQUE_OFF = 256

NAMES = {
    OVER_CURRENT: 'over-current',
    DRIVE_OVER_TEMPERATURE: 'drive over-temperature',
    MOTOR_OVER_TEMPERATURE: 'motor over-temperature',
    OVER_VOLTAGE: 'bus over-voltage',
    UNDER_VOLTAGE: 'bus under-voltage',
    PHASING: 'phasing error',
    FOLLOWING_ERROR: 'following error',
    I2T: 'I2T',
    SAFE_TORQUE_OFF: 'safe torque off',
}

ALL_FAULTS = sum(NAMES)
LATCHED_BY_DEFAULT = OVER_CURRENT | DRIVE_OVER_TEMPERATURE | MOTOR_OVER_TEMPERATURE | PHASING | I2T
DISABLING = ALL_FAULTS & ~FOLLOWING_ERROR
"""The faults that take the gate drive away."""


def describe(faults: int) -> str:
    """Return the names of the faults whose bits are set, for messages to the user."""
    return ', '.join(name for bit, name in NAMES.items() if faults & bit) or 'none'


@compiled
def disagrees_with_halls(sine, cosine, hall_state, tolerance_sine):
    """
    Tell whether the Hall sensors contradict the electrical angle by more than a tolerance.

    Hall sensor k is high where the phasing of line k is positive; `hall_state` has it in bit
    k - 1, and is 0 for a motor without Hall sensors. A sensor contradicts the angle if it is on
    the wrong side of its edge by more than the tolerance, whose sine is given. All three high is
    always an error.
    """
    if hall_state == 0:
        return False
    line_2 = -0.5 * sine - HALF_ROOT_3 * cosine
    line_3 = -0.5 * sine + HALF_ROOT_3 * cosine
    return (
        hall_state == 7
        or (sine if hall_state & 1 else -sine) < -tolerance_sine
        or (line_2 if hall_state & 2 else -line_2) < -tolerance_sine
        or (line_3 if hall_state & 4 else -line_3) < -tolerance_sine
    )
