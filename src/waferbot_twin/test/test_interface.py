# SPDX-License-Identifier: Apache-2.0
"""`import waferbot`: what scripts and notebooks use."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import waferbot as wb
from waferbot_twin.cli.diagnose import exit_code
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.plan import make_plan
from waferbot_twin.response import simulated_responses

WITHOUT_ROS = """
import sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in ('rclpy', 'rosbag2_py', 'launch'):
            raise ImportError(name)
sys.meta_path.insert(0, NoRos())
import waferbot as wb
run = wb.simulate(wb.load_model('rigid'), 'step', duration_s=0.01)
print(len(run.to_dataframe()))
"""


@pytest.fixture(scope='module')
def rigid():
    return wb.load_model('rigid')


@pytest.fixture(scope='module')
def run(rigid):
    return wb.simulate(rigid, 'step', duration_s=0.6)


def test_it_works_without_ros():
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS], capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 10


def test_everything_public_is_documented():
    for name in wb.__all__:
        assert getattr(wb, name).__doc__, name


def test_a_saved_model_is_the_same_model(rigid, tmp_path):
    again = wb.load_model(rigid.save(tmp_path / 'again.yaml'))
    assert again.variant.machine == rigid.variant.machine
    assert again.variant.pmac == rigid.variant.pmac
    assert again.variant.copley == rigid.variant.copley


def test_a_run_has_the_signals_of_the_engine(run):
    plan = make_plan('rigid', 'step', 0.6)
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    frame = run.to_dataframe()
    for axis in simulated_responses(twin, twin.advance(plan.ticks)):
        np.testing.assert_array_equal(frame.index, axis.servo_time)
        np.testing.assert_array_equal(frame[f'{axis.axis}_commanded_{axis.unit}'], axis.commanded)
        np.testing.assert_array_equal(
            frame[f'{axis.axis}_following_error_{axis.unit}'], axis.following_error
        )
        np.testing.assert_allclose(
            frame[f'{axis.axis}_position_{axis.unit}'],
            np.interp(axis.servo_time, axis.encoder_time, axis.position),
            atol=2e-9,
        )
        at_servo = np.searchsorted(axis.tick_time, axis.servo_time)
        np.testing.assert_array_equal(frame[f'{axis.axis}_current_a'], axis.current[at_servo])


def test_a_copy_of_the_signals_can_be_changed(run):
    frame = run.to_dataframe()
    frame['y_linear_current_a'] = 0.0
    assert run.signals['y_linear_current_a'].abs().max() > 0.0


def test_a_saved_run_is_a_log_with_the_same_motion(run, rigid, tmp_path):
    (log,) = wb.load_logs(run.save(tmp_path / 'run'))
    frame = log.to_dataframe(rigid)
    moved = run.to_dataframe()['y_linear_position_m']
    at = np.searchsorted(frame.index, moved.index[:-2])
    delay = frame.index[
        1
    ]  # readings are published one cycle of the encoders after they were taken
    shifted = np.interp(moved.index[:-2] + delay, frame.index, frame['y_linear_m'])
    np.testing.assert_allclose(shifted, moved.to_numpy()[:-2], atol=2e-9)
    assert frame['y_linear_commanded_m'].iloc[at[-1]] == pytest.approx(
        run.signals['y_linear_commanded_m'].iloc[-3]
    )


@pytest.mark.parametrize(
    ('what', 'said'),
    [
        (lambda: wb.load_model('rigit'), 'rigid'),
        (lambda: wb.load_logs('no_such_log'), 'no_such_log does not exist'),
        (lambda: wb.simulate(wb.load_model('rigid'), 'step', -1.0), 'duration_s is -1'),
        (lambda: wb.diagnose(wb.load_model('rigid'), []), 'give one log at least'),
        (lambda: wb.diagnose(wb.load_model('rigid'), [], without=['frictoin']), 'frictoin'),
    ],
)
def test_what_is_wrong_is_said(what, said):
    with pytest.raises(wb.UserError, match=said):
        what()


def test_a_synthetic_log_tells_its_truth_apart(rigid, tmp_path):
    made = wb.synthesize(
        rigid, ['coulomb_friction:x_rotate,friction=1.25'], tmp_path / 'log', 'step', seed=3
    )
    assert made.to_dataframe().to_dict('records') == [
        {'cause': 'coulomb_friction:x_rotate', 'parameter': 'friction', 'value': 1.25}
    ]
    assert made.log.name == 'log'
    by_name = Variant.of(load_model('rigid'))
    assert made.truth['model'] == by_name.name == 'rigid'


def test_a_parameter_is_identified_and_the_model_has_it(rigid, tmp_path):
    hidden = ['wrong_proportional_gain:y_linear,ratio=0.8']
    made = wb.synthesize(rigid, hidden, tmp_path / 'log', 'step', seed=5)
    result = wb.identify(rigid, [made.log], ['pmac.y_linear.Ixx30'])
    (row,) = result.to_dataframe().to_dict('records')
    assert row['parameter'] == 'pmac.y_linear.Ixx30'
    assert row['identified']
    assert row['value'] == pytest.approx(0.8 * row['start'], abs=1.0)
    assert row['low95'] <= row['value'] <= row['high95']
    assert result.identified_model.variant.i_variable('y_linear', 'Ixx30') == row['value']
    assert (result.save(tmp_path / 'report') / 'identified.yaml').exists()


@pytest.mark.parametrize(
    ('conditions', 'unexplained', 'causes', 'improvement', 'code'),
    [
        ([], 1, 1, -50.0, 0),
        (['unexplained'], 1, 0, 0.0, 3),
        (['unexplained'], 0, 1, -50.0, 0),
        (['cause'], 0, 1, 20.0, 4),
        (['loss'], 0, 1, -0.5, 0),
        (['loss'], 0, 1, -1.5, 5),
        (['loss', 'cause', 'unexplained'], 1, 1, -1.5, 3),
    ],
)
def test_exit_codes(conditions, unexplained, causes, improvement, code):
    result = SimpleNamespace(
        unexplained=pd.DataFrame(index=range(unexplained)),
        causes=pd.DataFrame(index=range(causes)),
        gains=pd.DataFrame({'improvement_percent': [30.0, improvement]}),
    )
    assert exit_code(result, conditions) == code
