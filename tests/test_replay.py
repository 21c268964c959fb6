# SPDX-License-Identifier: Apache-2.0
"""Replay of one block against the recorded signals of the others."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from harness import run_engine, waferbot

from waferbot_twin.models import load_model
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.replay import OUTPUTS, replay_in_process

NODES = ('plant', 'pmac', 'copley')
CHANGES = {
    'plant': {'plant': {'damping': 'calculated'}},
    'pmac': {'pmac': {'x_rotate': {'Ixx30': 150000}}},
    'copley': {'copley': {'x_rotate': {'proportional_gain': 5000}}},
}

pytestmark = pytest.mark.slow


def changed_model(folder, node):
    """Write a model that differs from `rigid` in one node only."""
    path = folder / f'changed_{node}.yaml'
    sections = {'plant': {'description': 'rigid'}}
    for name, settings in CHANGES[node].items():
        sections[name] = {**sections.get(name, {}), **settings}
    path.write_text(
        yaml.safe_dump({f'/**/{n}': {'ros__parameters': p} for n, p in sections.items()})
    )
    return path


@pytest.mark.parametrize('node', NODES)
def test_replay_of_the_same_model_is_exact(recorded, node):
    differences = replay_in_process(recorded('ros'), load_model('rigid'), node)
    assert differences
    for difference in differences:
        assert difference.first_tick is None
        assert difference.largest == 0.0


@pytest.mark.parametrize('node', NODES)
def test_replay_over_ros_is_exact(tmp_path_factory, node):
    folder = tmp_path_factory.mktemp('replay') / 'short'
    run_engine('inprocess', folder, duration_s=0.05)
    result = waferbot('replay', str(folder), '--node', node, '--engine', 'ros', '--json')
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told['identical'] is True
    assert all(difference['largest'] == 0.0 for difference in told['differences'])


@pytest.mark.parametrize('changed', ['pmac', 'copley'])
def test_the_block_with_another_gain_is_found(recorded, tmp_path, changed):
    model = str(changed_model(tmp_path, changed))
    disagreeing = set()
    for node in NODES:
        differences = replay_in_process(recorded('inprocess'), load_model(model), node)
        if any(difference.first_tick is not None for difference in differences):
            disagreeing.add(node)
            axes = {d.place for d in differences if d.first_tick is not None}
            assert axes == {'x_rotate'}
    assert disagreeing == {changed}


def test_the_changed_block_is_found_over_ros(tmp_path):
    run_engine('inprocess', tmp_path / 'short', duration_s=0.05)
    result = waferbot(
        'replay', str(tmp_path / 'short'), '--node', 'pmac', '--engine', 'ros', '--json',
        '--model', str(changed_model(tmp_path, 'pmac')),
    )  # fmt: skip
    assert result.returncode == 1, result.stderr
    told = json.loads(result.stdout)
    assert told['identical'] is False
    assert {d['place'] for d in told['differences'] if d['first_tick'] is not None} == {'x_rotate'}


@pytest.mark.parametrize('node', NODES)
def test_a_lost_answer_shifts_nothing(recorded, node):
    """What the node itself once said is only compared: a message of it that was lost is not."""
    recording = read_recording(recorded('inprocess').path)
    for topic in OUTPUTS[node]:
        recording.topics[topic.name] = np.delete(recording.topics[topic.name], [7, 500])
    differences = replay_in_process(recording, load_model('rigid'), node)
    assert [difference.first_tick for difference in differences] == [None] * len(differences)


def test_a_recording_with_a_hole_is_refused(recorded, tmp_path):
    recording = read_recording(recorded('inprocess').path)
    recording.topics['encoders'] = recording.topics['encoders'][[0, 1, 2, 4, 5]]
    with pytest.raises(Exception, match='encoders has a gap behind tick 4'):
        replay_in_process(recording, load_model('rigid'), 'pmac')
