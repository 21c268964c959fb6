# SPDX-License-Identifier: Apache-2.0
"""An axis that nobody drives any more is a failure: for every engine, the action, diagnostics."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import called, start_node, waferbot
from rclpy.action import ActionClient

from waferbot_msgs.action import RunExperiment
from waferbot_pmac.servo import MOTOR_KILLED
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording

ENGINES = ('inprocess', 'composed', 'ros')
KILLED = 'motor x_rotate was killed at tick '
CAUSE = 'by its fatal following error (Ixx11)'
ONLY_THIS = 2 << 21  # Ixx24: a fault of this motor kills no other

pytestmark = pytest.mark.slow


def unsuited_model(folder, node, axis, **settings):
    path = folder / 'unsuited.yaml'
    own = {'plant': {'description': 'rigid'}, node: {axis: settings}}
    path.write_text(
        yaml.safe_dump({f'/**/{name}': {'ros__parameters': own[name]} for name in own})
    )
    return str(path)


def failed_run(folder, engine, model):
    out = folder / engine
    result = waferbot(
        'run', '--engine', engine, '--model', model, '--duration', '0.1', '--out', str(out)
    )
    assert result.returncode == 1, result.stdout
    assert 'Traceback' not in result.stderr
    return out, result.stderr


def test_a_killed_motor_fails_the_run_of_every_engine_and_the_recording_is_whole(tmp_path):
    model = unsuited_model(tmp_path, 'pmac', 'x_rotate', Ixx11=16 * 20, Ixx24=ONLY_THIS)
    recordings = []
    for engine in ENGINES:
        out, said = failed_run(tmp_path, engine, model)
        assert f'waferbot: error: {KILLED}' in said
        assert CAUSE in said
        recording = read_recording(out)
        assert recording.closed
        assert recording.summary['complete'] == 'true'
        assert recording.ticks == 1800
        recordings.append(recording)
        told = json.loads(called('info', out, '--json').stdout)
        assert told['missing'] == 0
        assert told['failure'].startswith(KILLED)
    for other in recordings[1:]:
        assert differing_signals(recordings[0], other) == []
    state = recordings[0]['servo_state']
    killed = state['flags'] & MOTOR_KILLED > 0
    first = int(state['tick'][np.argmax(killed[:, 1])])
    assert f'{KILLED}{first} ' in told['failure']
    assert not killed[:, [0, 2]].any()


@pytest.mark.parametrize('engine', ['inprocess', 'composed'])
def test_an_amplifier_that_switches_off_fails_the_run(tmp_path, engine):
    model = unsuited_model(tmp_path, 'copley', 'y_linear', bus_voltage=59.0)
    _, said = failed_run(tmp_path, engine, model)
    assert 'the amplifier of y_linear switched off at tick 0 (0.0000 s): bus under-voltage' in said


def test_a_run_that_is_not_recorded_fails_as_well(tmp_path):
    model = unsuited_model(tmp_path, 'pmac', 'x_rotate', Ixx11=16 * 20)
    result = called('run', '--engine', 'inprocess', '--model', model, '--duration', '0.1')
    assert result.returncode == 1
    assert KILLED in result.stderr
    assert 'y_linear, y_rotate with it (Ixx24)' in result.stderr


def test_the_action_fails_and_diagnostics_and_log_say_why(start, connect, domain):
    nodes = {
        'plant': start_node(start, 'plant', domain),
        'copley': start_node(start, 'copley', domain),
        'pmac': start_node(start, 'pmac', domain, f'x_rotate.Ixx11:={16 * 20}'),
    }
    client = connect(domain)
    told = {}

    def on_diagnostics(array):
        told.update({status.name.split(':')[0]: status for status in array.status})

    client.node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    actions = ActionClient(client.node, RunExperiment, 'run_experiment')
    for _ in range(2):  # the second finds it killed
        answer = client.result_of(client.run_experiment(actions, 'step')).result
        assert not answer.success
        assert answer.message.startswith(KILLED)
        assert CAUSE in answer.message
    actions.destroy()
    client.spin_until(
        lambda: '/pmac' in told and told['/pmac'].level == DiagnosticStatus.ERROR, 'an error'
    )
    assert KILLED in told['/pmac'].message
    assert KILLED in nodes['pmac'].output
