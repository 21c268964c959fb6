# SPDX-License-Identifier: Apache-2.0
"""
Machines whose axes have names of their own: the shipped machine under other names is the same machine.

It has as many axes and encoders as before, in other messages, so every signal must have the same bits.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from harness import called, waferbot

from waferbot_lockstep.contract import CONTRACT_TOPICS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source
from waferbot_twin.engines.inprocess import SignalRecorder, Signals
from waferbot_twin.models import load_model
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.recording.writer import RecordingWriter

NAMES = {
    'y_linear': 'lift',
    'x_rotate': 'pitch',
    'y_rotate': 'yaw',
    'y_rotate_load': 'yaw_load',
    'y_rotate_motor': 'yaw_motor',
}
OWN = Layout(('lift', 'pitch', 'yaw'), ('lift', 'pitch', 'yaw_load', 'yaw_motor'))
STEP = {
    'name': 'steps',
    'duration_s': 0.02,
    'motion': {
        axis: {'kind': 'step', 'start_s': 0.002, 'amplitude_counts': 800} for axis in SHIPPED.axes
    },
}


def renamed(mapping, names):
    """Return a mapping with other names of axes and encoders as keys."""
    return {names.get(key, key): value for key, value in mapping.items()}


def model_and_experiment(folder, names):
    """Write the shipped model under other names, and an experiment that steps all its axes."""
    model = load_model('rigid')
    machine = yaml.safe_load(whole_text(description_source(model.description)))
    for section in ('axes', 'titles', 'motors', 'encoders', 'current_sensors', 'controllers'):
        if section in machine:
            machine[section] = renamed(machine[section], names)
    folder.mkdir()
    (folder / 'machine.yaml').write_text(yaml.safe_dump(machine, sort_keys=False), 'utf-8')
    parameters = {node: renamed(values, names) for node, values in model.parameters.items()}
    parameters['plant']['description'] = str(folder / 'machine.yaml')
    own = dataclasses.replace(model, parameters=parameters)
    (folder / 'model.yaml').write_text(own.text, 'utf-8')
    experiment = {**STEP, 'motion': renamed(STEP['motion'], names)}
    (folder / 'experiment.yaml').write_text(json.dumps(experiment), 'utf-8')
    return ('--model', folder / 'model.yaml', '--experiment', folder / 'experiment.yaml')


@pytest.fixture(scope='module')
def machines(tmp_path_factory):
    """The options that run the shipped machine, and the same under other names."""
    folder = tmp_path_factory.mktemp('machines')
    return model_and_experiment(folder / 'usual', {}), model_and_experiment(folder / 'own', NAMES)


@pytest.fixture(scope='module')
def runs(machines, tmp_path_factory):
    """Both machines, each run in this process."""
    folder, found = tmp_path_factory.mktemp('runs'), []
    for place, what in enumerate(machines):
        out = folder / str(place)
        done = called('run', '--engine', 'inprocess', *what, '--out', out)
        assert done.returncode == 0, done.stderr
        found.append(read_recording(out))
    return found


def same_values(one, other):
    """Check that all values of the contract's topics have the same bits."""
    for topic in CONTRACT_TOPICS:
        for name in ('tick', 'stamp_sec', 'stamp_nanosec', *values_of(one[topic])):
            assert one[topic][name].tobytes() == other[topic][name].tobytes(), (topic.name, name)
        assert (one[topic]['valid'] == other[topic]['valid']).all()


def values_of(array):
    """Return the names of what messages hold for each place."""
    return [name for name in array.dtype.names if array.dtype[name].shape]


def test_the_shipped_machine_under_other_names_has_the_same_bits(runs):
    usual, own = runs
    assert (usual.layout, own.layout) == (SHIPPED, OWN)
    same_values(usual, own)
    assert np.abs(own['servo_state']['following_error']).max() > 0.0
    assert all(
        name.startswith('waferbot_msgs/msg/Axes')
        for topic, name in own.types.items()
        if topic.strip('/') in {one.name for one in CONTRACT_TOPICS}
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    'how',
    [
        ('--engine', 'composed'),
        (),
        ('--copley-per-axis',),
        ('--delivery', 'channel'),
        ('--compose', 'plant,copley'),
    ],
    ids=lambda how: ' '.join(how) or 'processes',
)
def test_over_ros_they_are_those_of_one_process(how, machines, runs, tmp_path):
    done = waferbot('run', *map(str, machines[1]), *how, '--out', str(tmp_path / 'run'))
    assert done.returncode == 0, done.stderr
    over_ros = read_recording(tmp_path / 'run')
    assert over_ros.layout == OWN
    same_values(runs[1], over_ros)


def test_what_is_told_of_it_has_its_names(runs, tmp_path):
    path = runs[1].path
    for command in ('metrics', 'info'):
        told = called(command, path)
        assert told.returncode == 0, told.stderr
    table = called('metrics', path).stdout
    assert all(title in table for title in ('Lift', 'Pitch', 'Yaw'))
    drawn = called('plot', path, '--out', tmp_path / 'run.svg')
    assert drawn.returncode == 0, drawn.stderr
    for node in ('plant', 'pmac', 'copley'):
        replayed = called('replay', path, '--node', node)
        assert replayed.returncode == 0, replayed.stderr
        assert 'identical' in replayed.stdout
        assert 'yaw' in replayed.stdout


def test_a_recording_that_does_not_name_its_axes_says_so(tmp_path):
    """As one made by other tools: messages alone."""
    layout = Layout(('lift', 'elbow'), ('lift', 'elbow'))
    signals = Signals(0, 16, Timing(), layout)
    named = {'axes': list(layout.axes), 'encoders': list(layout.encoders)}
    for folder, run in (('bare', {}), ('whole', {'run.json': json.dumps(named)})):
        with RecordingWriter(tmp_path / folder, run, False) as writer:
            recorder = SignalRecorder(writer, Timing(), standard_topics=False, layout=layout)
            recorder.write(signals)
            writer.close({})
    with pytest.raises(UserError, match='axes of its own, and does not say which'):
        read_recording(tmp_path / 'bare')
    whole = read_recording(tmp_path / 'whole')
    assert whole.layout == layout
    assert whole['phase_voltages']['voltage'].shape == (16, 6)


def test_what_is_of_another_machine_is_not_laid_over_a_model(runs, tmp_path):
    usual, own = (run.path for run in runs)
    for command in (
        ('replay', own, '--model', 'rigid', '--node', 'plant'),
        ('diagnose', own, '--model', 'rigid', '--out', tmp_path / 'diagnosis'),
        ('compare', own, '--model', 'rigid'),
        ('compare', own, usual),
    ):
        done = called(*command)
        assert done.returncode != 0
        assert done.stderr.count('\n') <= 3
        assert 'Traceback' not in done.stderr
    told = called('replay', own, '--model', 'rigid', '--node', 'pmac').stderr
    assert 'a machine with axes lift, pitch, yaw; the model has y_linear' in told


def test_an_experiment_of_another_machine_is_refused_with_its_line(machines, tmp_path):
    (_, model, *_), (*_, experiment) = machines[1], machines[0]
    done = called('run', '--engine', 'inprocess', '--model', model, '--experiment', experiment)
    assert done.returncode != 0
    assert 'motion.y_linear: the machine has no axis y_linear (it has: lift' in done.stderr


def test_a_setting_of_an_axis_that_the_machine_lacks_is_refused_with_its_line(machines, tmp_path):
    text = Path(machines[1][1]).read_text()
    file = tmp_path / 'model.yaml'
    file.write_text(text.replace('    pitch:\n', '    x_rotate:\n', 1), 'utf-8')
    done = called('run', '--engine', 'inprocess', '--model', file)
    assert done.returncode != 0
    assert 'x_rotate: pmac has no such parameter' in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ('axes', 'words'),
    [
        ('[lift, yaw, pitch]', 'was started for axes lift, yaw, pitch'),
        ('[lift, pitch, yaw, grip]', 'was started for axes lift, pitch, yaw, grip'),
    ],
)
def test_a_node_for_another_machine_ends_and_says_so(machines, start, domain, axes, words):
    """With as many axes in another order nothing else would notice; with more, lengths would."""
    plant = start(
        'waferbot_plant.node', '--ros-args', '-p', 'start_paused:=true',
        '-p', f'description:={Path(machines[1][1]).parent / "machine.yaml"}',
        ROS_DOMAIN_ID=str(domain),
    )  # fmt: skip
    encoders = axes.replace('yaw', 'yaw_load, yaw_motor')
    pmac = start(
        'waferbot_pmac.node', '--ros-args', '-p', f'machine_axes:={axes}',
        '-p', f'machine_encoders:={encoders}', '-p', f'units:={" ".join(["rad"] * len(axes.split()))}',
        ROS_DOMAIN_ID=str(domain),
    )  # fmt: skip
    assert pmac.process.wait(60.0) == 1, pmac.output
    assert words in pmac.output
    assert 'the plant is a machine with axes lift, pitch, yaw' in pmac.output
    assert plant.process.wait(60.0) == 1, plant.output
