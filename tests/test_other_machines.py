# SPDX-License-Identifier: Apache-2.0
"""Worked examples that are not ours, from a description to its diagnosis: over ROS, tuned, exported."""

from __future__ import annotations

import json

import numpy as np
import pytest
from harness import output_of

from waferbot_twin.recording.reader import read_recording

BANDWIDTHS = {
    'ball_screw_stage': ('y_linear=25',),
    'scara': ('y_linear=15', 'x_rotate=8', 'y_rotate=8'),
}
TOPICS = ('encoders', 'phase_currents', 'current_command', 'phase_voltages', 'servo_state')

pytestmark = [pytest.mark.slow, pytest.mark.long(100)]


# One as long as the stage's steps: up at full speed, a rest, and down again.
STROKE = {
    'name': 'stroke',
    'duration_s': 1.0,
    'program': [
        {'dwell_s': 0.02},
        {'linear': {'y_linear_m': 0.1}, 'acceleration_time_s': 0.1, 's_curve_time_s': 0.02},
        {'dwell_s': 0.1},
        {'linear': {'y_linear_m': 0.0}, 'acceleration_time_s': 0.1, 's_curve_time_s': 0.02},
    ],
}


@pytest.fixture(scope='module')
def commissioned(tmp_path_factory):
    """Give a function that makes the model of an example, once."""
    folder = tmp_path_factory.mktemp('models')

    def make(name):
        file = folder / f'{name}.yaml'
        if not file.exists():
            more = [part for one in BANDWIDTHS[name] for part in ('--bandwidth', one)]
            output_of('commission', name, *more, '--out', file)
        return file

    return make


@pytest.mark.parametrize('name', list(BANDWIDTHS))
def test_it_runs_over_ros_as_in_one_process_and_with_its_own_fmu(name, commissioned, tmp_path):
    pytest.importorskip('fmpy')
    model, fmu = commissioned(name), tmp_path / 'plant.fmu'
    output_of('export-fmu', '--model', model, '--out', fmu)
    what = ('run', '--model', model, '--experiment', 'step', '--duration', '0.03')
    ways = {
        'here': ('--engine', 'inprocess'),
        'ros': (),
        'fmu': ('--plant', fmu),
    }
    runs = {}
    for way, how in ways.items():
        said = output_of(*what, *how, '--out', tmp_path / way)
        assert '0 missing of' in said
        runs[way] = read_recording(tmp_path / way)
    for way in ('ros', 'fmu'):
        for topic in TOPICS:
            assert len(runs[way][topic]) == len(runs['here'][topic])
            assert (runs[way][topic] == runs['here'][topic]).all(), (way, topic)
    assert np.abs(runs['here']['servo_state']['following_error']).max() > 0.0


def test_a_scara_is_tuned_at_every_bend_of_its_elbow(commissioned, tmp_path):
    out = tmp_path / 'tuned'
    output_of(
        'tune', '--model', commissioned('scara'), '--axis', 'x_rotate', '--experiment',
        'step_x_rotate', '--generations', '6', '--poses', 'x_rotate=0', 'y_rotate=-1:1:3',
        '--out', out,
    )  # fmt: skip
    found = json.loads((out / 'tune.json').read_text())
    margins = [row for row in found['margins'] if row['gains'] == 'after']
    assert {row['y_rotate'] for row in margins} == {-1.0, 0.0, 1.0}
    assert all(row['stable'] for row in margins)
    assert min(abs(row['gain_db']) for row in margins) >= 6.0
    assert min(row['phase_deg'] for row in margins) >= 35.0
    output_of(
        'run',
        '--engine',
        'inprocess',
        '--model',
        out / 'tuned.yaml',
        '--experiment',
        'step_x_rotate',
    )


def test_a_ball_screw_stage_is_diagnosed(commissioned, tmp_path):
    model = commissioned('ball_screw_stage')
    hidden = ('--effect', 'coulomb_friction:y_linear,friction=25', '--model', model)
    stroke = tmp_path / 'stroke.yaml'
    stroke.write_text(json.dumps(STROKE), 'utf-8')
    for seed, experiment in enumerate((stroke, 'step_y_linear')):
        out = tmp_path / f'log{seed}'
        output_of('synthesize', *hidden, '--experiment', experiment, '--seed', seed, '--out', out)
    out = tmp_path / 'diagnosis'
    output_of(
        'diagnose',
        tmp_path / 'log0',
        '--validate',
        tmp_path / 'log1',
        '--model',
        model,
        '--out',
        out,
    )
    report = json.loads((out / 'report.json').read_text())
    names = [(cause['effect'], cause['axis']) for cause in report['causes']]
    assert ('coulomb_friction', 'y_linear') in names
    assert report['gain']['axes']['y_linear']['improvement_percent'] > 50.0
