# SPDX-License-Identifier: Apache-2.0
"""The real `ros2` of an installation: launch, run, parameters, actions; skipped where there is none."""

from __future__ import annotations

import importlib.util
import re
import signal
import subprocess

import numpy as np
import pytest
from harness import PATIENCE_S, ROS2, Program, user_environment

from waferbot_lockstep.contract import CONTRACT_TOPICS
from waferbot_msgs.msg import Encoders
from waferbot_twin.recording.reader import read_recording

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all(map(importlib.util.find_spec, ('ros2cli', 'ros2launch'))),
        reason='this Python has no ros2cli and ros2launch',
    ),
]


@pytest.fixture
def ros2(domain):
    """Return a function that runs `ros2` with some words to its end, in the test's domain."""

    def run(*words):
        return subprocess.run(
            [*ROS2, *words],
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            env={**user_environment(), 'ROS_DOMAIN_ID': str(domain)},
            stdin=subprocess.DEVNULL,
        )

    return run


@pytest.fixture
def launch(domain, tmp_path):
    """Start launch files as `ros2 launch` does; ended by SIGINT, as by Ctrl-C."""
    programs = []

    def start(*words):
        log = tmp_path / f'launch{len(programs)}.log'
        command = [*ROS2, 'launch', 'waferbot_twin', *words]
        programs.append(Program(command, log, {'ROS_DOMAIN_ID': str(domain)}))
        return programs[-1]

    yield start
    for program in programs:
        if program.process.poll() is None:
            program.signal(signal.SIGINT)
        program.wait()


def until_tick(client, tick):
    newest = []
    client.node.create_subscription(Encoders, 'encoders', newest.append, 1)
    client.spin_until(lambda: newest and newest[-1].tick >= tick, f'tick {tick}')


def test_a_launched_twin_is_recorded_until_it_is_interrupted(
    launch, connect, domain, tmp_path, recorded
):
    out = tmp_path / 'run'
    launched = launch('twin.launch.py', 'experiment:=step', f'record:={out}')
    until_tick(connect(domain), 2000)
    launched.signal(signal.SIGINT)
    launched.wait()
    assert launched.output.count('process has finished cleanly') == 4, launched.output
    assert re.search(r'0 missing of \d+', launched.output), launched.output
    recording, whole = read_recording(out), recorded('inprocess')
    assert recording.summary['complete'] == 'true'
    for topic in CONTRACT_TOPICS:
        count = min(len(recording[topic]), len(whole[topic]))
        assert count > 10
        np.testing.assert_array_equal(recording[topic][:count], whole[topic][:count])


def test_a_launched_twin_runs_an_experiment_on_request(launch, ros2):
    launch('twin.launch.py')
    kind, goal = 'waferbot_msgs/action/RunExperiment', '{experiment: step_y_linear}'
    sent = ros2('action', 'send_goal', '/run_experiment', kind, goal)
    assert 'success: true' in sent.stdout, sent.stdout + sent.stderr
    assert 'SUCCEEDED' in sent.stdout
    described = ros2('param', 'describe', '/pmac', 'y_linear.Ixx30').stdout
    assert 'Proportional gain' in described
    assert 'Min value: -8388608' in described
    assert ros2('topic', 'echo', '--once', '/servo_state').stdout.startswith('header:')


def test_nodes_by_ros2_run_without_their_parameter_files_say_what_they_need(ros2):
    done = ros2('run', 'waferbot_pmac', 'pmac', '--ros-args', '-p', 'y_linear.Ixx3O:=1')
    assert done.returncode != 0
    assert 'y_linear.Ixx3O' in done.stdout + done.stderr
