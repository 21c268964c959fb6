# SPDX-License-Identifier: Apache-2.0
"""
A drive whose output is bolted to a table: nothing holds it to its readings but its own spring.

A torque that is a sum of slow sines twists it by the formula of a driven oscillator, so that no
integrator stands between the log and the truth.
"""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import record_of_measured_log
from waferbot_twin.residuals.observer_bandwidth import with_observers
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import Cause, Problem, apply_all

AXIS = 'x_rotate'
SEED = 11
INERTIA, STIFFNESS, DAMPING = 0.02, 1500.0, 1.0  # of the description
COUNTS = 65536 / (2.0 * np.pi)
WAVES = 2.0 * np.pi * np.array([0.25, 0.8, 1.9])


@pytest.fixture(scope='module')
def locked():
    return Variant.of(load_model_or_machine('locked_cycloidal_drive'))


def log_of(stiffness, zero=0.0):
    """Return 12 s at 500 Hz of a drive with a stiffness, its encoder's zero anywhere."""
    time_s = np.arange(6000) / 500.0
    waves = np.exp(1j * np.outer(time_s, WAVES)) * np.array([3.0, 1.0, 0.5])
    answer = 1.0 / (stiffness - INERTIA * WAVES**2 + 1j * DAMPING * WAVES)
    angle, torque = (waves @ answer).imag, waves.sum(axis=1).imag
    return MeasuredLog(
        'log',
        (
            Signal('position', AXIS, 'rad', time_s, angle + zero),
            Signal('force', AXIS, 'Nm', time_s, torque),
        ),
    )


def left(variant, log):
    """Return what a model leaves over of a log, rad, and the times, s."""
    block = PlantBlock(record_of_measured_log(log, variant), variant)
    (found,) = block.innovations(variant)
    return found / COUNTS, block.times_s(AXIS)


def test_the_true_model_leaves_next_to_nothing(locked) -> None:
    found, time_s = left(locked, log_of(STIFFNESS))
    assert np.abs(found[time_s > 1.0]).max() < 0.005 * 3.0 / STIFFNESS


def test_where_the_encoder_has_its_zero_is_all_the_same(locked) -> None:
    here, there = (left(locked, log_of(2.0 * STIFFNESS, zero))[0] for zero in (0.0, -2.7))
    np.testing.assert_allclose(here, there, atol=1e-9)


def test_what_a_wrong_stiffness_makes_stays_for_as_long_as_the_torque(locked) -> None:
    """No observer pulls the drive to its readings: all of the difference of both twists is there."""
    log = log_of(2.0 * STIFFNESS)
    found, time_s = left(locked, log)
    torque = np.sin(np.outer(time_s, WAVES)) @ np.array([3.0, 1.0, 0.5])
    missing = torque * (0.5 - 1.0) / STIFFNESS
    late = time_s > 1.0
    np.testing.assert_allclose(
        found[late] - found[late].mean(),
        missing[late] - missing[late].mean(),
        atol=0.02 * np.abs(missing).max(),
    )


def test_no_observer_is_slower_there_than_another(locked) -> None:
    record = record_of_measured_log(log_of(2.0 * STIFFNESS), locked)
    (followed,) = with_observers([record], locked, locked)
    assert PlantBlock(followed, locked).observer_hz == PlantBlock(record, locked).observer_hz


def test_play_is_crossed_from_flank_to_flank(locked) -> None:
    """The angles of a drive with play are apart by the play, whichever way a log begins."""
    play = Cause(find('backlash'), AXIS, {'gap': 0.02})
    found, time_s = left(apply_all(locked, [play]), log_of(STIFFNESS))
    torque = np.sin(np.outer(time_s, WAVES)) @ np.array([3.0, 1.0, 0.5])
    forward, backward = (np.median(found[sign * torque > 2.0]) for sign in (1.0, -1.0))
    assert backward - forward == pytest.approx(0.02, rel=0.05)


def hysteresis(gap, stiffness, friction, damping, rng):
    """
    Return 12 s at 200 Hz of a drive with play and dry friction under a torque that goes up and down.

    In explicit steps of 20 us, so that no code of the twin makes the log; its encoder's zero is
    anywhere.
    """
    step_s, time_s, angle = 2e-5, [], []
    x = speed = 0.0
    rows = range(round(12.0 / step_s))
    torques = (
        4.0 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * np.arange(len(rows)) * step_s / 4))
    )
    for row, torque in zip(rows, torques.tolist(), strict=True):
        beyond = abs(x) - 0.5 * gap
        contact = np.sign(x) * stiffness * beyond + damping * speed if beyond > 0.0 else 0.0
        push = torque - contact
        if speed == 0.0 and abs(push) <= friction:
            rate = 0.0
        else:
            rate = (push - friction * np.sign(speed or push)) / INERTIA
        after = speed + step_s * rate
        speed = after if speed * after >= 0.0 else 0.0
        x += step_s * speed
        if row % 250 == 0:
            time_s.append(row * step_s)
            angle.append(x)
    noise = 2e-5 * rng.standard_normal(len(angle))
    return MeasuredLog(
        'log',
        (
            Signal('position', AXIS, 'rad', np.array(time_s), np.array(angle) + noise - 0.7),
            Signal('force', AXIS, 'Nm', np.array(time_s), torques[::250]),
        ),
    )


def test_play_and_friction_come_out_of_a_hysteresis(locked, random) -> None:
    """What a test bench measures of a gear."""
    log = hysteresis(0.02, 9000.0, 1.0, 2.0, random)
    problem = Problem(locked, [record_of_measured_log(log, locked)])
    begun = {
        'backlash': {'gap': 0.016},
        'coulomb_friction': {'friction': 1.4},
        'coupling_compliance': {'compliance': 1.0 / 5000.0},
    }
    causes = tuple(Cause(find(name), AXIS, values) for name, values in begun.items())
    found = fit_causes(problem, causes)
    gap, friction, compliance = (next(iter(one.values.values())) for one in found.causes)
    assert gap == pytest.approx(0.02, rel=0.02)
    assert friction == pytest.approx(1.0, rel=0.02)
    assert compliance == pytest.approx(1.0 / 9000.0, rel=0.3)
