# SPDX-License-Identifier: Apache-2.0
"""Runs with compensation tables: against settings of the servo that do the same, and replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_twin.engines import inprocess
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model, recorded_model
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.replay import replay_in_process

HEADER = 'axis,over,at,current_a\n'
PER_AMPERE = 32768.0 / 40.0  # DAC units


def run(pmac, experiment='wafer_exchange', seconds=0.4):
    """Return the signals of a run on the rigid machine with these settings of the PMAC."""
    plan = make_plan('rigid', experiment, seconds)
    model = plan.model.with_settings('pmac', pmac)
    return Twin.of(model, plan.timing, plan.experiment).advance(plan.ticks)


def test_a_constant_table_is_the_bias_of_the_output():
    bias = load_model('rigid').of_axes('pmac')['y_linear']['Ixx29']
    with_bias = run({'y_linear': {'Ixx29': bias + 410}})
    table = HEADER + f'y_linear,position_m,0,{410 / PER_AMPERE}\n'
    np.testing.assert_array_equal(run({'compensation': table}).counts, with_bias.counts)
    assert (with_bias.counts != run({}).counts).any()


def test_a_jump_over_speed_is_the_friction_feedforward():
    current = 400 / PER_AMPERE
    table = HEADER + ''.join(
        f'y_linear,speed_m_s,{at},{value}\n'
        for at, value in ((-1, -current), (-1e-12, -current), (1e-12, current), (1, current))
    )
    by_table = run({'compensation': table})
    by_variable = run({'y_linear': {'Ixx68': 400}})
    np.testing.assert_array_equal(by_table.current_command, by_variable.current_command)
    assert (by_table.current_command != run({}).current_command).any()


def test_a_run_with_tables_is_replayed_to_the_last_bit(tmp_path):
    lines = [
        'y_linear,position_m,0,0.5', 'y_linear,position_m,0.3,1.5',
        'x_rotate,speed_rad_s,-3,-1', 'x_rotate,speed_rad_s,3,1',
        'y_rotate,time_s:wafer_exchange,0,0.1', 'y_rotate,time_s:wafer_exchange,0.3,-0.2',
    ]  # fmt: skip
    plan = make_plan('rigid', 'wafer_exchange', 0.4)
    settings = {'compensation': HEADER + '\n'.join(lines) + '\n'}
    plan = replace(plan, model=plan.model.with_settings('pmac', settings))
    inprocess.run(plan, tmp_path / 'run', False, lambda done, total: None)
    recording = read_recording(tmp_path / 'run')
    model = recorded_model(recording)
    assert model.compensation[2].over == 'time_s:wafer_exchange'
    for difference in replay_in_process(recording, model, 'pmac'):
        assert difference.largest == 0.0
    without = model.with_settings('pmac', {'compensation': ''})
    assert all(
        difference.largest > 0.01 for difference in replay_in_process(recording, without, 'pmac')
    )


def test_a_model_names_its_tables_from_its_own_folder(tmp_path):
    (tmp_path / 'tables.csv').write_text(HEADER + 'y_linear,position_m,0,0.5\n', 'utf-8')
    file = tmp_path / 'mine.yaml'
    file.write_text('/**/pmac: {ros__parameters: {compensation: tables.csv}}\n', 'utf-8')
    model = load_model(str(file))
    assert model.compensation[0].axis == 'y_linear'
    assert 'y_linear,position_m' in model.text  # whole, for a recording
    (tmp_path / 'tables.csv').unlink()
    with pytest.raises(UserError, match=r'tables\.csv'):
        load_model(str(file))
