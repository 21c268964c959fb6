# SPDX-License-Identifier: Apache-2.0
"""
The Reference FMUs of the Modelica Association as plants in lock-step, beside FMPy's own simulation.

They have no motors: what they lack is mapped to nothing. The folder of a release, with 2.0 and 3.0 in
it, is named by WAFERBOT_REFERENCE_FMUS (https://github.com/modelica/Reference-FMUs).
"""

from __future__ import annotations

import os
from pathlib import Path

import fmpy
import numpy as np
import pytest
import yaml

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.foreign_plant import ForeignPlant
from waferbot_plant.signals import counts, lines, positions, voltages
from waferbot_twin.cli.main import main
from waferbot_twin.recording.reader import read_recording

FOLDER = Path(os.environ.get('WAFERBOT_REFERENCE_FMUS', 'nowhere'))
TIMING = Timing()
NOTHING = {variable.name: None for variable in voltages()} | {
    variable.name: 0 for variable in (*counts(), *lines())
}
NUMBERS = ('Real', 'Float64', 'Integer', 'Int32')

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason='no Reference FMUs: WAFERBOT_REFERENCE_FMUS names their folder'
)


def shown(name, fmi):
    """Return up to three outputs of a Reference FMU that are a number each."""
    description = fmpy.read_model_description(str(FOLDER / fmi / f'{name}.fmu'))
    return [
        one.name
        for one in description.modelVariables
        if one.causality == 'output' and one.type in NUMBERS and not one.dimensions
    ][:3]


@pytest.mark.parametrize('fmi', ['2.0', '3.0'])
@pytest.mark.parametrize(
    'name', ['Dahlquist', 'VanDerPol', 'BouncingBall', 'Feedthrough', 'Stair', 'Resource']
)
def test_a_reference_fmu_steps_as_fmpy_steps_it(name, fmi):
    file = FOLDER / fmi / f'{name}.fmu'
    outputs = shown(name, fmi)
    assert outputs
    names = NOTHING | {
        variable.name: theirs for variable, theirs in zip(positions(), outputs, strict=False)
    }
    plant = ForeignPlant(file, names, TIMING)
    ticks = TIMING.ticks(0.5)
    mine = np.zeros((ticks, 3))
    for tick in range(ticks):
        mine[tick] = plant.values()[10:13]
        plant.step(tick, np.zeros(9), 0)
    plant.close()
    theirs = fmpy.simulate_fmu(
        str(file), stop_time=(ticks - 1) * TIMING.tick_s, output=outputs,
        output_interval=TIMING.tick_s, fmi_type='CoSimulation',
    )  # fmt: skip
    for place, output in enumerate(outputs):
        np.testing.assert_array_equal(mine[:, place], theirs[output][:ticks])


@pytest.mark.parametrize(
    ('name', 'signal', 'said'),
    [
        ('StateSpace', ('y_linear_voltage_1', 'u'), "'u' \\(it is an array\\)"),
        ('StateSpace', ('y_linear_position', 'y'), "'y' \\(it is an array\\)"),
        ('Clocks', ('y_linear_position', 'y'), 'no FMU for co-simulation'),
    ],
)
def test_those_that_are_no_plant_are_refused_with_the_reason(name, signal, said):
    ours, theirs = signal
    with pytest.raises(UserError, match=said):
        ForeignPlant(FOLDER / '3.0' / f'{name}.fmu', NOTHING | {ours: theirs}, TIMING)


@pytest.mark.parametrize(('fmi', 'kind'), [('2.0', 'Real'), ('3.0', 'Float64')])
def test_feedthrough_shows_the_voltage_of_the_tick_before(fmi, kind, tmp_path, capsys):
    """The order of a tick in closed form, y[k + 1] = u[k]; volts for amperes trip the amplifier."""
    file = FOLDER / fmi / 'Feedthrough.fmu'
    description = fmpy.read_model_description(str(file))
    real = [one for one in description.modelVariables if one.type == kind]
    taken = next(one.name for one in real if one.causality == 'input')
    given = next(
        one.name for one in real if one.causality == 'output' and 'continuous' in one.name
    )
    names = NOTHING | {'y_linear_voltage_2': taken, 'y_linear_current_1': given}
    (tmp_path / 'names.yaml').write_text(yaml.safe_dump(names))
    arguments = ['run', '--engine', 'inprocess', '--plant', str(file), '--duration', '0.03']
    arguments += [
        '--experiment',
        'step_y_linear',
        '--plant-map',
        str(tmp_path / 'names.yaml'),
        '--out',
        str(tmp_path / 'run'),
    ]
    assert main(arguments) == 1
    assert 'over-current' in capsys.readouterr().err
    recording = read_recording(tmp_path / 'run')
    voltage = recording['phase_voltages']['voltage'][:, 1]
    current = recording['phase_currents']['current'][:, 0]
    assert np.abs(voltage).max() > 1.0
    np.testing.assert_array_equal(current[1:], voltage[:-1])
