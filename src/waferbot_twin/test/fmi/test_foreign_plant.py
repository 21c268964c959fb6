# SPDX-License-Identifier: Apache-2.0
"""
Somebody else's plant: a mass on a linear motor in C (`linear_motor.c`), with PMAC and Copley.

The same machine as a description is the truth: both solve the same equations, each with its own steps.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from fmpy.validation import validate_fmu

from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source
from waferbot_twin.cli.main import main
from waferbot_twin.recording.reader import read_recording

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        sys.platform != 'linux' or not shutil.which('cc'), reason='for a C compiler on Linux'
    ),
]

COUNTS_PER_M = 5.0e7  # as in linear_motor.c; fine, for a count more or less makes the PMAC jump
INPUTS = ('drive.u_a', 'drive.u_b', 'drive.u_c')
OUTPUTS = ('stage.x', 'stage.v', 'drive.i_a', 'drive.i_b')
NAMES = {
    **{f'y_linear_voltage_{place + 1}': name for place, name in enumerate(INPUTS)},
    'y_linear_counts': 'scale.counts',
    'y_linear_current_1': 'drive.i_a',
    'y_linear_current_2': 'drive.i_b',
    'y_linear_position': 'stage.x',
    'y_linear_velocity': 'stage.v',
}
"""Ours: theirs. The other axes have no motor, no encoder and nothing that flows."""


def model_description():
    reals = ''.join(
        f'<ScalarVariable name="{name}" valueReference="{place}" {causality} '
        f'variability="continuous"><Real{start}/></ScalarVariable>'
        for place, (name, causality, start) in enumerate(
            [(name, 'causality="input"', ' start="0"') for name in INPUTS]
            + [(name, 'causality="output" initial="calculated"', '') for name in OUTPUTS]
        )
    )
    outputs = ''.join(f'<Unknown index="{place}"/>' for place in range(4, 9))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="linear_motor" guid="{{a-mass-on-a-linear-motor}}">
<CoSimulation modelIdentifier="linear_motor" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{reals}
<ScalarVariable name="scale.counts" valueReference="7" causality="output" variability="discrete"
 initial="calculated"><Integer/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs><InitialUnknowns>{outputs}</InitialUnknowns></ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """A folder with the FMU, its names, and the machine as a description, commissioned."""
    made = tmp_path_factory.mktemp('foreign')
    library = made / 'linear_motor.so'
    source = Path(__file__).with_name('linear_motor.c')
    subprocess.run(['cc', '-O2', '-shared', '-fPIC', '-o', library, source, '-lm'], check=True)
    with zipfile.ZipFile(made / 'motor.fmu', 'w') as archive:
        archive.writestr('modelDescription.xml', model_description())
        archive.write(library, 'binaries/linux64/linear_motor.so')
    lacking = {
        f'{axis}_{what}': value
        for axis in ('x_rotate', 'y_rotate')
        for what, value in {
            **{f'voltage_{place}': None for place in (1, 2, 3)},
            'current_1': 0, 'current_2': 0,
        }.items()
    }  # fmt: skip
    lacking |= dict.fromkeys(
        ('x_rotate_counts', 'y_rotate_load_counts', 'y_rotate_motor_counts'), 0
    )
    (made / 'names.yaml').write_text(yaml.safe_dump(NAMES | lacking), 'utf-8')
    machine = yaml.safe_load(whole_text(description_source('single_mass')))
    del machine['frictions']
    machine['encoders']['y_linear']['counts_per_m'] = COUNTS_PER_M
    (made / 'mass.yaml').write_text(yaml.safe_dump(machine), 'utf-8')
    arguments = ['commission', made / 'mass.yaml', '--bandwidth', 'y_linear=20']
    assert main([str(one) for one in (*arguments, '--out', made / 'model.yaml')]) == 0
    return made


def test_fmpy_finds_nothing_wrong_with_it(folder):
    assert validate_fmu(str(folder / 'motor.fmu')) == []


@pytest.mark.parametrize('engine', ['inprocess', 'ros'])
def test_it_does_what_the_same_machine_does_as_a_description(folder, engine, tmp_path):
    """A step of 250 um: within 0.1 um of one another, the loop closed round each."""
    what = ['run', '--model', str(folder / 'model.yaml'), '--experiment', 'step_y_linear']
    what += ['--duration', '0.2', '--engine', engine]
    plant = ['--plant', str(folder / 'motor.fmu'), '--plant-map', str(folder / 'names.yaml')]
    runs = {}
    for name, more in (('ours', []), ('theirs', plant)):
        assert main([*what, *more, '--out', str(tmp_path / name)]) == 0
        runs[name] = read_recording(tmp_path / name)
    ours, theirs = (runs[name]['encoders']['counts'][:, 0] for name in ('ours', 'theirs'))
    assert len(ours) == len(theirs) == 1800
    assert ours.max() > 2.5e-4 * COUNTS_PER_M
    assert np.abs(ours - theirs).max() <= 1e-7 * COUNTS_PER_M
    currents = [runs[name]['phase_currents']['current'][:, :2] for name in ('ours', 'theirs')]
    rms = np.sqrt(np.mean(currents[0] ** 2))
    assert np.sqrt(np.mean((currents[0] - currents[1]) ** 2)) < 0.01 * rms
