# SPDX-License-Identifier: Apache-2.0
"""Responses by axis: where the motion starts, RMS between two of them; and the commands on them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from waferbot_twin.cli.main import main
from waferbot_twin.response import AxisResponse, rms_difference


def response(start_s: float, position, command_height: float = 1.0) -> AxisResponse:
    """An axis whose command steps at `start_s` and whose position follows `position(t - start)`."""
    encoder_time = np.arange(0.0, 0.3, 1.0 / 9000.0)
    servo_time = np.arange(0.0, 0.3, 1.0 / 2250.0)
    commanded = np.where(servo_time >= start_s - 1e-9, command_height, 0.0)
    nothing = np.zeros_like(servo_time)
    place = np.where(encoder_time >= start_s, position(encoder_time - start_s), 0.0)
    return AxisResponse(
        'y_linear', 'm', encoder_time, place, servo_time, commanded, nothing, servo_time,
        nothing, encoder_time, np.zeros_like(encoder_time),
    )  # fmt: skip


def ramp(time):
    return np.minimum(time / 0.1, 1.0)


def test_rms_counts_from_the_start_of_each_motion() -> None:
    early, late = response(0.02, ramp), response(0.06, ramp)
    assert rms_difference(early, early) == 0.0
    assert rms_difference(early, late) == pytest.approx(0.0, abs=2e-3)
    offset = response(0.02, lambda time: ramp(time) + 0.25)
    assert rms_difference(offset, early) == pytest.approx(0.25, rel=1e-6)


def test_metrics_count_from_the_step() -> None:
    figures = response(0.02, ramp).metrics()
    assert figures is not None
    assert figures.delay_time == pytest.approx(0.05, abs=5e-4)


def test_an_axis_that_does_not_move_has_no_step() -> None:
    still = response(1.0, ramp)
    assert still.step() is None
    assert not still.moves()
    assert still.metrics() is None


def test_metrics_and_compare_on_recordings(tmp_path, capsys) -> None:
    """The commands read what `run` recorded; against itself nothing differs."""
    out = tmp_path / 'run'
    arguments = ['--experiment', 'step_y_linear', '--duration', '0.2', '--out', str(out)]
    assert main(['run', '--engine', 'inprocess', '--model', 'rigid', *arguments]) == 0
    capsys.readouterr()
    assert main(['metrics', str(out), '--json']) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures['y_linear']['step'] == pytest.approx(2.5e-4)
    assert 'step' not in figures['x_rotate']
    assert main(['compare', str(out), str(out), '--before', str(out), '--json']) == 0
    compared = json.loads(capsys.readouterr().out)
    assert set(compared) == {'y_linear'}
    assert compared['y_linear']['RMS error']['simulated'] == 0.0
    assert compared['y_linear']['Rise Time']['difference_percent'] == 0.0
    assert main(['compare', str(out), str(tmp_path / 'missing')]) == 1
    assert 'does not exist' in capsys.readouterr().err
