# SPDX-License-Identifier: Apache-2.0
"""Which motors were killed, when and why, in one line."""

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_pmac import servo
from waferbot_pmac.killed import KilledMotors

FATAL = servo.MOTOR_KILLED | servo.FATAL_FOLLOWING_ERROR


def test_a_sound_machine_has_no_reason():
    killed = KilledMotors()
    assert not killed.note(0, np.array([servo.MOVING, 0, servo.WARNING_FOLLOWING_ERROR]))
    assert not killed
    assert killed.reason(Timing()) == ''


def test_axis_time_and_cause_are_named_and_those_killed_with_it():
    killed = KilledMotors()
    assert killed.note(1800, np.array([servo.MOTOR_KILLED, FATAL, servo.MOTOR_KILLED]))
    assert killed.reason(Timing()) == (
        'motor x_rotate was killed at tick 1800 (0.1000 s) by its fatal following error (Ixx11); '
        'y_linear, y_rotate with it (Ixx24)'
    )


def test_it_is_said_once():
    killed = KilledMotors()
    assert killed.note(8, np.array([FATAL, 0, 0]))
    assert not killed.note(16, np.array([FATAL, 0, 0]))
    assert killed.note(24, np.array([FATAL, 0, servo.MOTOR_KILLED | servo.AMPLIFIER_I2T]))
    assert killed.found['y_linear'][0] == 8
    assert 'current protection (Ixx57, Ixx58)' in killed.reason(Timing())


def test_many_cycles_at_once_give_the_first_of_each():
    flags = np.zeros((50, 3))
    flags[20:, 0] = FATAL
    flags[30:, 2] = FATAL | servo.INTEGRATOR_LIMITED
    killed = KilledMotors()
    killed.note_all(np.arange(50) * 8, flags)
    assert {axis: tick for axis, (tick, _) in killed.found.items()} == {
        'y_linear': 160,
        'y_rotate': 240,
    }
    assert 'a full integrator (Ixx63 < 0)' in killed.reason(Timing())
