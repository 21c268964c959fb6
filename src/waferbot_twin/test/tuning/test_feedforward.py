# SPDX-License-Identifier: Apache-2.0
"""Compensation tables: what they hold, and what they gain on the machine as built."""

from __future__ import annotations

import json

import numpy as np
import pytest

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.motors import force_constant
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.cogging import EFFECT as COGGING
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.models import load_model
from waferbot_twin.tuning.compensate import CASES, compensate
from waferbot_twin.tuning.feedforward import machine_tables, motion_tables
from waferbot_twin.tuning.runs import behave


@pytest.fixture(scope='module')
def as_built():
    return Variant.of(load_model('as_built'))


def with_cogging(variant, cosine, sine):
    """Return the model with cogging of Y-Linear once per pole, N."""
    values = dict.fromkeys((one.name for one in COGGING.parameters(variant, 'y_linear')), 0.0)
    values |= {'cosine_1': cosine, 'sine_1': sine, 'order': 2.0}
    return variant.with_overlay(COGGING.overlay(variant, 'y_linear', values))


def table_over(tables, axis, over):
    (found,) = [table for table in tables if table.axis == axis and table.over == over]
    return found


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['tables', 'motion'])
def test_following_error_of_the_machine_as_built_is_less_than_half(as_built, kind):
    """On every axis in the wafer exchange, against the gains as they are; see docs/tuning.md."""
    found = compensate(as_built, as_built, load_experiment('wafer_exchange'), kind)
    assert set(found.axes) == set(AXES)
    for axis in AXES:
        assert found.gain(axis) > 0.5
        assert found.runs[CASES[2]][axis].alive
    if kind == 'motion':
        # Beyond what velocity feedforward alone would have done, too.
        assert all(found.gain(axis, CASES[1]) > 0.5 for axis in AXES)


@pytest.mark.slow
def test_tables_of_the_nominal_model_help_the_machine_as_built(as_built):
    """The model is off by what the calibration found: inertia, motor constants, friction."""
    nominal = Variant.of(load_model('flexible'))
    found = compensate(nominal, as_built, load_experiment('full_stroke_x_rotate'), 'tables')
    own = compensate(as_built, as_built, load_experiment('full_stroke_x_rotate'), 'tables')
    assert 0.5 < found.gain('x_rotate') < own.gain('x_rotate')


def test_cogging_is_in_the_table_over_position(as_built):
    """A cogging force F needs -F / K more current there; K from the description."""
    cogging = with_cogging(as_built, 8.0, 0.0)
    travel, speed = {'y_linear': (0.0, 0.2)}, {'y_linear': 0.5}
    with_it = table_over(machine_tables(cogging, travel, speed), 'y_linear', 'position_m')
    without = table_over(machine_tables(as_built, travel, speed), 'y_linear', 'position_m')
    at = np.linspace(0.0, 0.2, 977)
    added = np.interp(at, with_it.at, with_it.current) - np.interp(at, without.at, without.current)
    motor = as_built.description.motors['y_linear']
    expected = -8.0 / force_constant(motor) * np.cos(2.0 * motor.electrical_gain * at)
    np.testing.assert_allclose(added, expected, atol=0.02 * np.abs(expected).max())


def test_friction_is_in_the_table_over_speed(as_built):
    """X-Rotate: 6.28 Nm rising to 10.66 Nm at 0.3 rad/s, over the torque per ampere."""
    tables = machine_tables(as_built, {'x_rotate': (0.0, 1.5)}, {'x_rotate': 3.0})
    table = table_over(tables, 'x_rotate', 'speed_rad_s')
    constant = force_constant(as_built.description.motors['x_rotate'])
    speeds = np.array([1e-6, 0.15, 0.3, 2.0, -0.15])
    found = np.interp(speeds, table.at, table.current) * constant
    np.testing.assert_allclose(found, [6.284, 8.4745, 10.6646, 10.6646, -8.4745], rtol=2e-3)
    assert np.interp(0.0, table.at, table.current) == 0.0


def test_cogging_that_is_compensated_no_longer_disturbs(as_built):
    """Y-Linear with strong cogging: the table takes most of what the cogging adds."""
    cogging = with_cogging(as_built, 60.0, 20.0)
    experiment = load_experiment('slow_velocity_y_linear')
    blind = compensate(as_built, cogging, experiment, 'tables')
    knowing = compensate(cogging, cogging, experiment, 'tables')
    error = [one.runs[CASES[2]]['y_linear'].rms_following_error for one in (blind, knowing)]
    assert error[1] < 0.25 * error[0]


def test_a_jump_needs_any_current_and_is_refused(as_built):
    with pytest.raises(UserError, match='jump'):
        motion_tables(as_built, load_experiment('step_y_linear'), Timing())


def test_a_run_that_blows_up_has_no_figures(as_built):
    wild = as_built.with_overlay(Overlay(pmac={'y_rotate': {'Ixx30': 4000000}}))
    found = behave(wild, load_experiment('step_y_rotate'), Timing())
    assert not found['y_rotate'].alive
    assert found['y_rotate'].rms_following_error == np.inf


@pytest.mark.slow
def test_the_command_writes_tables_that_a_run_takes(tmp_path, capsys):
    out = tmp_path / 'out'
    arguments = ['--model', 'as_built', '--experiment', 'full_stroke_y_rotate', '--out', str(out)]
    assert main(['feedforward', *arguments, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert json.loads((out / 'feedforward.json').read_text()) == found
    model = Variant.of(load_model(str(out / 'model.yaml')))
    again = behave(model, load_experiment('full_stroke_y_rotate'), Timing())['y_rotate']
    told = found['runs'][CASES[2]]['y_rotate']['rms_following_error']
    assert again.rms_following_error == pytest.approx(told, rel=1e-6)
    assert main(['feedforward', *arguments]) == 1
    assert '--force' in capsys.readouterr().err
