# SPDX-License-Identifier: Apache-2.0
"""
A recorder that is faster than what it records writes readings several times: a staircase, no motion.

The truth is a simulated axis with inertia, viscous and Coulomb friction and a constant force under a PD
loop, read 100 times a second; what is written of it are rows at other rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from waferbot_twin.identification.least_squares import identify_by_least_squares
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.mapping import mapping_text

SEED = 7
INERTIA, VISCOUS, COULOMB, OFFSET = 0.02, 0.01, 0.05, 0.01
DURATION_S, STEP_S = 30.0, 5e-4
RADIANS, NEWTON_METRES = 1e-5, 1e-5  # steps of the readings
MAPPING = """
time: {{column: time, unit: s}}
signals:
  - {{column: angle, kind: position, axis: x_rotate, unit: rad}}
  - {{column: torque, kind: torque, axis: x_rotate, unit: Nm}}
options: {{{options}}}
"""


@dataclass
class Motion:
    """Times, angle and torque of the axis (n,), finer than any log of it."""

    time_s: np.ndarray
    angle: np.ndarray
    torque: np.ndarray

    def read(self, time_s, step=RADIANS):
        """Return what is read at some times (m,): rows of angle and torque (m, 2)."""
        angle = np.interp(time_s, self.time_s, self.angle)
        torque = np.interp(time_s, self.time_s, self.torque)
        coarse = np.round(torque / NEWTON_METRES) * NEWTON_METRES
        return np.column_stack([np.round(angle / step) * step, coarse])


@pytest.fixture(scope='module')
def motion():
    time_s = STEP_S * np.arange(round(DURATION_S / STEP_S))
    wave = 2.0 * np.pi * np.array([0.15, 0.37, 0.83, 1.7])
    phase = np.outer(time_s, wave) + np.array([0.3, 2.0, 4.1, 5.5])
    size = np.array([2.0, 1.0, 0.5, 0.15])
    wanted, wanted_speed = np.sin(phase) @ size, np.cos(phase) @ (size * wave)
    angles, torques = np.zeros(len(time_s)), np.zeros(len(time_s))
    angle, speed = wanted[0], 0.0
    for row in range(len(time_s)):
        torque = 3.0 * (wanted[row] - angle) + 0.3 * (wanted_speed[row] - speed)
        angles[row], torques[row] = angle, torque
        free = torque - OFFSET - VISCOUS * speed
        friction = (
            COULOMB * np.sign(speed) if abs(speed) > 1e-3 else np.clip(free, -COULOMB, COULOMB)
        )
        speed += (free - friction) / INERTIA * STEP_S
        angle += speed * STEP_S
    return Motion(time_s, angles, torques)


def imported(folder, time_s, values, options='', mapping=MAPPING):
    """Return what the import makes of a log with these rows."""
    file = folder / 'log.csv'
    rows = np.column_stack([time_s, values])
    header = 'time,angle,torque'
    np.savetxt(file, rows, delimiter=',', comments='', header=header, fmt='%.9g')
    return load_log(file, mapping_text(mapping.format(options=options)))


def written(folder, motion, row_s, reading_s, options=''):
    """Return the log of a recorder whose rows, at `row_s`, hold the newest reading of `reading_s`."""
    newest = np.searchsorted(reading_s, row_s, side='right') - 1
    return imported(folder, row_s, motion.read(reading_s)[newest], options)


def said(log):
    return [finding for finding in log.findings if 'repeat' in finding.reason]


def assert_the_truth_is_found(log):
    (fit,) = identify_by_least_squares([log], [], None).fits
    found = dict(zip(fit.estimate.names, fit.estimate.value, strict=True))
    assert fit.late_s == 0.0
    assert found['inertia'] == pytest.approx(INERTIA, rel=0.01)
    assert found['viscous'] == pytest.approx(VISCOUS, rel=0.1)
    assert found['coulomb'] == pytest.approx(COULOMB, rel=0.05)
    assert found['offset'] == pytest.approx(OFFSET, abs=1e-3)


def test_a_log_of_every_reading_five_times_is_the_log_of_its_readings(motion, tmp_path) -> None:
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    original = written(tmp_path, motion, row_s[::5], row_s[::5])
    log = written(tmp_path, motion, row_s, row_s[::5])
    for one, other in zip(log.signals, original.signals, strict=True):
        assert one.time_s.tobytes() == other.time_s.tobytes()
        assert one.value.tobytes() == other.value.tobytes()
        assert (one.resolution, one.hold) == (other.resolution, other.hold)
    assert not said(original)
    (finding,) = said(log)
    assert finding.place == 'x_rotate.position, x_rotate.force'
    assert finding.action == 'left out'
    assert '80 % of the rows repeat' in finding.reason
    assert 'in every 5th row, 100 times a second in 500 rows a second' in finding.reason
    assert_the_truth_is_found(log)


def test_readings_by_another_clock_than_the_rows_tell_the_truth_too(motion, tmp_path) -> None:
    reading_s = 0.01 * np.arange(round(DURATION_S / 0.01))
    row_s = np.arange(0.0, DURATION_S, 1.0 / 470.0)
    log = written(tmp_path, motion, row_s, reading_s)
    assert len(log['x_rotate', 'position'].time_s) == pytest.approx(len(reading_s), abs=2)
    repeated, uneven = (one for one in log.findings if one.action != 'note')
    assert 'after 4 to 5 rows, 100 times a second in 470 rows a second' in repeated.reason
    assert uneven.action == 'suspect'
    assert 'only to about 0.0021 s' in uneven.reason
    assert 'time_column' in uneven.reason
    assert_the_truth_is_found(log)
    stairs = written(tmp_path, motion, row_s, reading_s, 'repeated_rows: keep')
    assert said(stairs)[0].action == 'suspect'
    assert 'repeated_rows: leave_out' in said(stairs)[0].reason
    assert len(stairs['x_rotate', 'position'].time_s) == len(row_s)


def test_readings_at_irregular_times_tell_the_truth_and_how_late_they_may_be(
    random, motion, tmp_path
) -> None:
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    at = np.cumsum(random.integers(3, 9, len(row_s) // 3))
    reading_s = row_s[np.concatenate([[0], at[at < len(row_s)]])]
    original = written(tmp_path, motion, reading_s, reading_s)
    log = written(tmp_path, motion, row_s, reading_s)
    assert len(log['x_rotate', 'position'].time_s) == pytest.approx(len(reading_s), rel=0.001)
    assert not said(original)
    assert 'after 3 to 8 rows' in said(log)[0].reason
    assert any('only to about 0.01 s' in finding.reason for finding in log.findings)
    assert_the_truth_is_found(log)


def test_where_some_rows_repeat_the_log_is_kept_and_what_to_do_is_said(motion, tmp_path) -> None:
    reading_s = 0.01 * np.arange(round(DURATION_S / 0.01))
    row_s = np.arange(0.0, DURATION_S, 0.0071)
    log = written(tmp_path, motion, row_s, reading_s)
    assert len(log['x_rotate', 'position'].time_s) == len(row_s)
    assert said(log)[0].action == 'suspect'
    assert '29 % of the rows repeat' in said(log)[0].reason
    left = written(tmp_path, motion, row_s, reading_s, 'repeated_rows: leave_out')
    assert len(left['x_rotate', 'position'].time_s) == pytest.approx(len(reading_s), rel=0.02)
    assert_the_truth_is_found(left)


def test_a_rest_is_no_gap(motion, tmp_path) -> None:
    """Coarse readings of an axis that waits between two motions, each five times."""
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    values = np.repeat(motion.read(row_s[::5]), 5, axis=0)
    values[6000:9000] = values[6000]
    log = imported(tmp_path, row_s, values)
    position = log['x_rotate', 'position']
    assert not position.gaps()
    assert len(position.time_s) == len(row_s) // 5
    assert position.value == pytest.approx(values[::5, 0])


@pytest.mark.parametrize('step', [2e-2, 2e-3, 1e-5])
def test_a_coarse_counter_is_no_repetition(motion, tmp_path, step) -> None:
    """At 500 rows a second most coarse counts are those of the row before, and rightly so."""
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    values = motion.read(row_s, step)
    values[3000:6000] = values[3000]
    for options in ('', 'repeated_rows: leave_out'):
        log = imported(tmp_path, row_s, values, options)
        assert not said(log)
        assert len(log['x_rotate', 'position'].time_s) == len(row_s)


def test_a_torque_that_is_read_in_every_row_stays_as_it_is(motion, tmp_path) -> None:
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    values = motion.read(row_s)
    values[:, 0] = np.repeat(values[::5, 0], 5)
    log = imported(tmp_path, row_s, values)
    (finding,) = said(log)
    assert finding.place == 'x_rotate.position'
    assert 'force changes' in finding.reason
    assert log['x_rotate', 'position'].rate_hz == pytest.approx(100.0)
    assert log['x_rotate', 'force'].rate_hz == pytest.approx(500.0)


def test_a_command_that_stands_for_long_goes_with_the_readings(motion, tmp_path) -> None:
    """A torque in few large steps, which is constant for most of the time, in a log of held readings."""
    row_s = 0.002 * np.arange(round(DURATION_S / 0.002))
    values = np.repeat(motion.read(row_s[::5]), 5, axis=0)
    values[:, 1] = np.round(values[:, 1] / 0.1) * 0.1
    log = imported(tmp_path, row_s, values)
    assert said(log)[0].place == 'x_rotate.position, x_rotate.force'
    assert log['x_rotate', 'force'].value == pytest.approx(values[::5, 1])
