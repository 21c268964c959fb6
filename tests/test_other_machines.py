# SPDX-License-Identifier: Apache-2.0
"""Worked examples that are not ours, from a description to its diagnosis: over ROS, tuned, exported."""

from __future__ import annotations

import json

import numpy as np
import pytest

from waferbot_twin.recording.reader import read_recording

BANDWIDTHS = {
    'ball_screw_stage': ('y_linear=25',),
    'scara': ('y_linear=15', 'x_rotate=8', 'y_rotate=8'),
}
TOPICS = ('encoders', 'phase_currents', 'current_command', 'phase_voltages', 'servo_state')

pytestmark = [pytest.mark.slow, pytest.mark.long]


@pytest.fixture
def told(start):
    """Give a function that runs a command and returns what it said."""

    def run(*arguments):
        program = start('waferbot_twin', *map(str, arguments))
        assert program.wait(280.0) == 0, program.output
        return program.output

    return run


@pytest.fixture
def commissioned(told, tmp_path):
    """Give a function that makes the model of an example."""

    def make(name):
        file = tmp_path / f'{name}.yaml'
        more = [part for one in BANDWIDTHS[name] for part in ('--bandwidth', one)]
        told('commission', name, *more, '--out', file)
        return file

    return make


@pytest.mark.parametrize('name', list(BANDWIDTHS))
def test_it_runs_over_ros_as_in_one_process_and_with_its_own_fmu(
    name, commissioned, told, tmp_path
):
    pytest.importorskip('fmpy')
    model, fmu = commissioned(name), tmp_path / 'plant.fmu'
    told('export-fmu', '--model', model, '--out', fmu)
    what = ('run', '--model', model, '--experiment', 'step', '--duration', '0.03')
    ways = {
        'here': ('--engine', 'inprocess'),
        'ros': (),
        'fmu': ('--plant', fmu),
    }
    runs = {}
    for way, how in ways.items():
        said = told(*what, *how, '--out', tmp_path / way)
        assert '0 missing of' in said
        runs[way] = read_recording(tmp_path / way)
    for way in ('ros', 'fmu'):
        for topic in TOPICS:
            assert len(runs[way][topic]) == len(runs['here'][topic])
            assert (runs[way][topic] == runs['here'][topic]).all(), (way, topic)
    assert np.abs(runs['here']['servo_state']['following_error']).max() > 0.0


def test_a_scara_is_tuned_at_every_bend_of_its_elbow(commissioned, told, tmp_path):
    out = tmp_path / 'tuned'
    told(
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
    told(
        'run',
        '--engine',
        'inprocess',
        '--model',
        out / 'tuned.yaml',
        '--experiment',
        'step_x_rotate',
    )


def test_a_ball_screw_stage_is_diagnosed(commissioned, told, tmp_path):
    model = commissioned('ball_screw_stage')
    hidden = ('--effect', 'coulomb_friction:y_linear,friction=25', '--model', model)
    for seed, experiment in enumerate(('full_stroke_y_linear', 'step_y_linear')):
        out = tmp_path / f'log{seed}'
        told('synthesize', *hidden, '--experiment', experiment, '--seed', seed, '--out', out)
    out = tmp_path / 'diagnosis'
    told(
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
