# SPDX-License-Identifier: Apache-2.0
"""Windows of long logs: motions that are formulas, with the friction that is to be found in them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_twin.diagnosis import notes
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import standard_errors
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.residuals.from_measured_log import record_of_measured_log
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.windows import ENOUGH_SAMPLES, WINDOWS, in_windows

INERTIA = 2.5e-4  # kg m2, of the direct-drive motor
COUNTS = 8192.0 / (2.0 * math.pi)
AXIS, PLACE = 'x_rotate', 1
RATE_HZ = 400.0
ENOUGH_S = ENOUGH_SAMPLES / RATE_HZ
FRICTION = 4e-4  # Nm s/rad

SEED = 7


@pytest.fixture(scope='module')
def motor():
    return Variant.of(load_model_or_machine('direct_drive_motor'))


def record(motor, random, duration_s, moves=(0.0, math.inf)):
    """Return the record of a motor that swings in a part of its log, and then stands where it is."""
    time_s = np.arange(int(duration_s * RATE_HZ)) / RATE_HZ
    begin_s, end_s = moves
    own_s = np.clip(time_s, begin_s, end_s) - begin_s
    wave = 2.0 * np.pi * np.array([0.5, 0.7, 1.1])
    phase = random.uniform(0.0, 2.0 * np.pi, 3)
    inside = ((time_s >= begin_s) & (time_s <= end_s)).astype(float)
    angle = np.sin(np.outer(own_s, wave) + phase) @ np.array([5.0, 3.0, 2.0])
    speed = inside * (np.cos(np.outer(own_s, wave) + phase) @ (np.array([5.0, 3.0, 2.0]) * wave))
    rate = -inside * (
        np.sin(np.outer(own_s, wave) + phase) @ (np.array([5.0, 3.0, 2.0]) * wave**2)
    )
    torque = INERTIA * rate + FRICTION * speed + random.normal(0.0, 2e-3, len(time_s))
    log = MeasuredLog(
        'log',
        (
            Signal(
                'position', AXIS, 'rad', time_s, np.round(angle * COUNTS) / COUNTS, 1.0 / COUNTS
            ),
            Signal('force', AXIS, 'Nm', time_s, torque),
        ),
    )
    return record_of_measured_log(log, motor)


def judged_s(windows):
    return sum(window.duration_s - window.judged_from_s for window in windows)


def test_a_log_that_is_not_too_long_is_used_whole(motor, random) -> None:
    whole = record(motor, random, 0.9 * ENOUGH_S)
    (windows,) = in_windows([whole], motor)
    assert windows.spans_s == ()
    assert windows.records == [whole]


def test_windows_are_where_the_axis_moves(motor, random) -> None:
    begin_s = 2.0 * ENOUGH_S
    whole = record(motor, random, 4.0 * ENOUGH_S, (begin_s, begin_s + 0.7 * ENOUGH_S))
    (found,) = in_windows([whole], motor)
    windows = found.records
    assert judged_s(windows) == pytest.approx(ENOUGH_S, rel=1e-3)
    moving = sum(
        np.count_nonzero(
            np.abs(np.diff(window.reading[np.isfinite(window.reading[:, PLACE]), PLACE]))
        )
        for window in windows
    )
    in_all = np.count_nonzero(np.diff(whole.reading[np.isfinite(whole.reading[:, PLACE]), PLACE]))
    assert moving > 0.95 * in_all
    errors = found.rms_errors(motor, motor)
    (inside, outside) = errors[AXIS]
    assert inside > outside  # friction lacks, and the axis stands in the rest
    note = notes.in_windows(whole, found.spans_s, motor, errors)
    assert note.startswith(
        f'log is longer than needed: of its {4 * ENOUGH_S:.1f} s those {ENOUGH_S:.1f} s'
    )
    assert 'rad RMS there on Motor, and ' in note


def test_two_logs_share_what_is_enough_and_both_are_used(motor, random) -> None:
    logs = [record(motor, random, 2.0 * ENOUGH_S), record(motor, random, 1.5 * ENOUGH_S)]
    windows = [part for one in in_windows(logs, motor) for part in one.records]
    assert judged_s(windows) == pytest.approx(ENOUGH_S, rel=1e-3)
    assert len(windows) <= 2 * WINDOWS
    assert {window.name.split()[0] for window in windows} == {'log'}
    assert all(one.spans_s for one in in_windows(logs, motor))


def test_windows_tell_what_the_whole_log_does(motor, random) -> None:
    whole = record(motor, random, 3.0 * ENOUGH_S)
    (windows,) = in_windows([whole], motor)
    effect = find('viscous_friction')
    start = Cause(effect, AXIS, effect.typical(motor, AXIS))
    found = fit_causes(Problem(motor, windows.records), (start,))
    (error,) = standard_errors(found)
    (cause,) = found.causes
    assert cause.values['damping'] == pytest.approx(FRICTION, abs=4.0 * error)
    assert error < 0.02 * FRICTION


def test_a_part_begins_in_motion_and_has_the_same_signals(motor, random) -> None:
    whole = record(motor, random, 4.0)
    part = whole.part(2.0, 3.0, begin_s=1.5)
    rows = slice(round(1.5 * whole.timing.encoder_hz), round(3.0 * whole.timing.encoder_hz))
    assert np.array_equal(part.reading, whole.reading[rows], equal_nan=True)
    assert part.judged_from_s == pytest.approx(0.5)
    assert part.duration_s == pytest.approx(1.5)


def test_a_machine_with_the_twins_controller_is_used_whole(motor, random) -> None:
    whole = record(motor, random, 3.0 * ENOUGH_S)
    (windows,) = in_windows([whole], Variant.of(load_model('rigid')))
    assert windows.records == [whole]
