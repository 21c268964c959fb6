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
    'scara_four_axes': ('lift=15', 'shoulder=8', 'elbow=8', 'wrist=12'),
    'gantry': ('y_linear=25', 'x_rotate=20', 'y_rotate=10'),
    'puma_560': (
        *('waist=8', 'shoulder=8', 'elbow=10'),
        *('wrist_roll=12', 'wrist_bend=12', 'flange=12'),
    ),
}
TOPICS = ('encoders', 'phase_currents', 'current_command', 'phase_voltages', 'servo_state')

pytestmark = [pytest.mark.slow, pytest.mark.long(300), pytest.mark.timeout(3600)]


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

# All axes of the gantry slide: it is commanded in m.
SLIDES = {
    'name': 'slides',
    'duration_s': 0.6,
    'motion': {
        axis: {'kind': 'step', 'start_s': 0.02, 'amplitude_m': 1e-4}
        for axis in ('y_linear', 'x_rotate', 'y_rotate')
    },
}
SMOOTH = {'acceleration_time_s': 0.1, 's_curve_time_s': 0.02}
TRAVELS = {
    'name': 'travels',
    'duration_s': 2.0,
    'program': [
        {'dwell_s': 0.05},
        {'linear': {'x_rotate_m': 0.2, 'y_rotate_m': 0.15}, **SMOOTH},
        {'linear': {'y_linear_m': 0.05}, **SMOOTH},
        {'dwell_s': 0.1},
        {'linear': {'x_rotate_m': 0.0, 'y_rotate_m': 0.0, 'y_linear_m': 0.0}, **SMOOTH},
    ],
}
SLOW = {
    'name': 'slow',
    'duration_s': 1.5,
    'program': [
        {'dwell_s': 0.05},
        {
            'linear': {'x_rotate_m': -0.1, 'y_rotate_m': 0.08, 'y_linear_m': 0.04},
            'move_time_s': 0.4,
            **SMOOTH,
        },
        {'dwell_s': 0.1},
        {
            'linear': {'x_rotate_m': 0.0, 'y_rotate_m': 0.0, 'y_linear_m': 0.0},
            'move_time_s': 0.4,
            **SMOOTH,
        },
    ],
}

# All six axes of the arm at once, each its own way.
TURNS = {
    'name': 'turns',
    'duration_s': 0.6,
    'motion': {
        axis: {'kind': 'step', 'start_s': 0.002, 'amplitude_counts': 200 * (place + 1)}
        for place, axis in enumerate(
            ('waist', 'shoulder', 'elbow', 'wrist_roll', 'wrist_bend', 'flange')
        )
    },
}
OWN = {'gantry': SLIDES, 'puma_560': TURNS}
"""Experiments of examples that the shipped ones do not suit."""


def written(folder, experiment):
    """Return the file of an experiment."""
    file = folder / f'{experiment["name"]}.yaml'
    file.write_text(json.dumps(experiment), 'utf-8')
    return file


@pytest.fixture(scope='module')
def commissioned(tmp_path_factory):
    """Give a function that makes the model of an example, once; its experiments are beside it."""
    folder = tmp_path_factory.mktemp('models')

    def make(name):
        file = folder / f'{name}.yaml'
        if not file.exists():
            more = [part for one in BANDWIDTHS[name] for part in ('--bandwidth', one)]
            output_of('commission', name, *more, '--out', file, '--experiments', folder / name)
        return file

    return make


@pytest.mark.parametrize('name', list(BANDWIDTHS))
def test_it_runs_over_ros_as_in_one_process_and_with_its_own_fmu(name, commissioned, tmp_path):
    pytest.importorskip('fmpy')
    model, fmu = commissioned(name), tmp_path / 'plant.fmu'
    output_of('export-fmu', '--model', model, '--out', fmu)
    experiment = model.parent / name / 'step.yaml'
    if name in OWN:
        experiment = written(tmp_path, OWN[name])
    what = ('run', '--model', model, '--experiment', experiment, '--duration', '0.03')
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


@pytest.mark.parametrize(
    ('name', 'axis', 'force_n', 'motions'),
    [
        ('ball_screw_stage', 'y_linear', 25, (STROKE, 'step_y_linear')),
        ('gantry', 'x_rotate', 15, (TRAVELS, SLOW)),
    ],
)
def test_hidden_friction_is_diagnosed(name, axis, force_n, motions, commissioned, tmp_path):
    model = commissioned(name)
    hidden = ('--effect', f'coulomb_friction:{axis},friction={force_n}', '--model', model)
    for seed, motion in enumerate(motions):
        experiment = motion if isinstance(motion, str) else written(tmp_path, motion)
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
    assert ('coulomb_friction', axis) in names
    assert report['gain']['axes'][axis]['improvement_percent'] > 50.0


def test_what_a_gantry_does_is_told_in_metres(commissioned, tmp_path):
    model, run = commissioned('gantry'), tmp_path / 'run'
    slides = written(tmp_path, SLIDES)
    output_of(
        'run', '--model', model, '--experiment', slides, '--delivery', 'channel', '--out', run
    )
    found = json.loads(output_of('metrics', run, '--json'))
    for axis in SLIDES['motion']:
        assert found[axis]['unit'] == 'm'
        assert abs(found[axis]['step'] - 1e-4) < 1e-6
    for table in (output_of('metrics', run), output_of('compare', run, '--model', model)):
        assert all(title in table for title in ('Ram', 'Bridge', 'Carriage'))
        assert not any(axis in table for axis in SLIDES['motion'])
    picture = tmp_path / 'run.svg'
    output_of('plot', run, '--out', picture)
    drawn = picture.read_text()
    assert 'position [µm]' in drawn
    assert 'rad]' not in drawn.replace('tilt [rad]', '')


def test_a_gantry_is_tuned(commissioned, tmp_path):
    out, experiment = tmp_path / 'tuned', dict(SLIDES)
    experiment['motion'] = {'y_rotate': SLIDES['motion']['y_rotate']}
    output_of(
        'tune', '--model', commissioned('gantry'), '--experiment', written(tmp_path, experiment),
        '--generations', '6', '--out', out,
    )  # fmt: skip
    margins = json.loads((out / 'tune.json').read_text())['margins']
    after = [row for row in margins if row['gains'] == 'after']
    assert len(after) == 1  # at home: the poses of the shipped machine are in rad
    assert all(row['stable'] for row in after)
    assert min(row['phase_deg'] for row in after) >= 35.0
