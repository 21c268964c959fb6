# SPDX-License-Identifier: Apache-2.0
"""FMUs validated and simulated by FMPy, beside the plant and the twin themselves."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.foreign_plant import ForeignPlant
from waferbot_plant.signals import counts, lines, positions, terminals, voltages
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.fmi.blocks import BLOCKS
from waferbot_twin.fmi.export import export
from waferbot_twin.models import load_model
from waferbot_twin.recording.reader import read_recording

TIMING = Timing()
MASS = 'bodies.carriage.mass_kg'


def model(name='as_built'):
    return Variant.of(load_model(name))


@pytest.fixture(scope='module')
def fmu(tmp_path_factory):
    """Give a function that exports an FMU once."""
    made = {}

    def exported(kind='plant', fmi='3', parameters=(MASS,)):
        key = kind, fmi, parameters
        if key not in made:
            file = tmp_path_factory.mktemp('fmu') / f'{kind}{fmi}.fmu'
            export(model(), kind, parameters, fmi, file)
            made[key] = file
        return made[key]

    return exported


@pytest.fixture(scope='module')
def run():
    """Signals of 0.05 s of the steps on the machine as built."""
    loaded = load_model('as_built')
    twin = Twin.of(loaded, TIMING, load_experiment('step'))
    return twin.advance(TIMING.ticks(0.05))


@pytest.fixture(scope='module')
def exchange():
    """Signals of 2 s of the wafer exchange on the machine as built: all axes move."""
    twin = Twin.of(load_model('as_built'), TIMING, load_experiment('wafer_exchange'))
    return twin.advance(TIMING.ticks(2.0))


@pytest.mark.parametrize('fmi', ['3', '2'])
@pytest.mark.parametrize('kind', list(BLOCKS))
def test_fmpy_finds_nothing_wrong_with_it(fmu, kind, fmi):
    parameters = (MASS,) if kind in ('plant', 'twin') else ()
    assert validate_fmu(str(fmu(kind, fmi, parameters))) == []


@pytest.mark.parametrize('fmi', ['3', '2'])
def test_its_description_has_units_and_parameters(fmu, fmi):
    description = fmpy.read_model_description(str(fmu('plant', fmi)))
    variables = {variable.name: variable for variable in description.modelVariables}
    assert variables['y_linear_voltage_1'].unit == 'V'
    assert variables['x_rotate_velocity'].unit == 'rad/s'
    assert variables[MASS].unit == 'kg'
    assert variables[MASS].causality == 'parameter'
    assert float(variables[MASS].start) == pytest.approx(
        model().machine['bodies']['carriage']['mass_kg']['value']
    )
    units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    assert (units['V'].kg, units['V'].m, units['V'].s, units['V'].A) == (1, 2, -3, -1)


@pytest.mark.slow
@pytest.mark.parametrize(('fmi', 'seconds'), [('3', 2.0), ('2', 0.4)])
def test_recorded_voltages_give_the_recorded_signals(fmu, exchange, fmi, seconds):
    """FMPy's own simulation, driven by what the amplifiers put out; it takes half a minute a second."""
    run, ticks = exchange, TIMING.ticks(seconds)
    names = [variable.name for variable in (*voltages(), *terminals())]
    data = np.zeros(ticks, [('time', 'f8'), *((name, 'f8') for name in names)])
    data['time'] = np.arange(ticks) * TIMING.tick_s
    for place, variable in enumerate(voltages()):
        data[variable.name] = run.voltage[:ticks, place]
    outputs = [variable.name for variable in (*counts(), *lines(), *positions())]
    found = fmpy.simulate_fmu(
        str(fmu('plant', fmi)), stop_time=(ticks - 1) * TIMING.tick_s, input=data, output=outputs,
        output_interval=TIMING.tick_s, step_size=TIMING.tick_s, validate=False,
    )  # fmt: skip
    assert len(found) == ticks
    for place, variable in enumerate(lines()):
        mine, theirs = found[variable.name][:ticks], run.line_current[:ticks, place]
        assert np.abs(mine - theirs).max() <= 1e-12 * np.abs(theirs).max()
    for place, variable in enumerate(counts()):
        np.testing.assert_array_equal(found[variable.name][::2], run.counts[: ticks // 2, place])
    slow = np.array([tick for tick in run.slow_ticks if tick < ticks])
    for place, variable in enumerate(positions()):
        mine, theirs = found[variable.name][slow], run.joint_position[: len(slow), place]
        assert np.abs(mine - theirs).max() <= 1e-12 * np.abs(theirs).max()


@pytest.mark.slow
@pytest.mark.parametrize('fmi', ['3', '2'])
def test_a_run_with_it_as_the_plant_is_the_native_run(fmu, exchange, tmp_path, fmi):
    """All of 2 s, in which the loop is closed round it."""
    run = exchange
    out = tmp_path / 'run'
    arguments = [
        'run',
        '--engine',
        'inprocess',
        '--model',
        'as_built',
        '--plant',
        str(fmu('plant', fmi)),
        '--experiment',
        'wafer_exchange',
    ]
    assert main([*arguments, '--duration', '2', '--out', str(out)]) == 0
    recording = read_recording(out)
    ticks = TIMING.ticks(2.0)
    np.testing.assert_allclose(
        recording['phase_voltages']['voltage'], run.voltage[:ticks], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(recording['encoders']['counts'], run.counts[: ticks // 2])
    np.testing.assert_allclose(
        recording['servo_state']['output'], run.servo_state[: ticks // 8, 6:9], rtol=1e-9
    )


def test_blocks_in_a_row_are_the_twin(run):
    """PMAC, Copley and plant one after another, tick by tick, against the compiled loop."""
    block = BLOCKS['twin'](model(), TIMING)
    commanded = np.zeros((900, 3))
    twin = Twin.of(load_model('as_built'), TIMING, load_experiment('step'))
    per_unit = twin.servo_parameters['counts_per_unit'][0]
    commanded = twin.commanded / per_unit
    currents = np.zeros((900, 6))
    for tick in range(900):
        currents[tick] = block.values()[4:10]
        block.step(commanded[tick // 8])
    np.testing.assert_allclose(currents, run.line_current[:900], rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_a_parameter_changes_the_machine(fmu):
    def settle(**start):
        found = fmpy.simulate_fmu(
            str(fmu()), stop_time=0.02, output=['y_linear_position'], output_interval=0.001,
            step_size=TIMING.tick_s, start_values=start, validate=False,
        )  # fmt: skip
        return found['y_linear_position'][-1]

    plain = settle()
    assert settle(**{MASS: float(fmpy_start(fmu()))}) == plain
    heavy = settle(**{MASS: 30.0})
    assert heavy < plain  # it falls where nothing holds it any more
    assert not np.isclose(heavy, plain, rtol=1e-6)


def fmpy_start(file):
    description = fmpy.read_model_description(str(file))
    return next(one.start for one in description.modelVariables if one.name == MASS)


def without_checkout(file, folder, end):
    """Simulate an FMU in a Python without our packages on its path, which ends by a statement."""
    code = (
        'import os, sys, fmpy;'
        "assert not any('waferbot' in name for name in sys.modules);"
        f'r = fmpy.simulate_fmu({str(file)!r}, stop_time=0.001, step_size=1/18000,'
        " output_interval=1/18000, output=['y_linear_counts'], validate=False);"
        f'import waferbot_plant; print(waferbot_plant.__file__, len(r), flush=True); {end}'
    )
    environment = {key: value for key, value in os.environ.items() if key != 'PYTHONPATH'} | {
        'NUMBA_DISABLE_JIT': '1'
    }
    return subprocess.run(
        [sys.executable, '-c', code], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=280, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_it_runs_where_there_is_no_checkout(fmu, tmp_path):
    """In a Python that has the packages of its requirements, without ours on its path."""
    done = without_checkout(fmu(), tmp_path, 'os._exit(0)')
    assert done.returncode == 0, done.stderr
    where, rows = done.stdout.split()[-2:]
    assert '/resources/' in where
    assert int(rows) == 19


@pytest.mark.slow
def test_an_importer_that_is_a_python_itself_ends_in_order(fmu, tmp_path):
    done = without_checkout(fmu(), tmp_path, 'pass')
    assert done.returncode == 0, done.stderr


def test_a_step_that_is_no_whole_number_of_ticks_is_an_error(fmu):
    plant = ForeignPlant(fmu(), {}, TIMING)
    plant.step(0, np.zeros(9), 0)
    plant._timing = replace(TIMING, current_loop_hz=12000)
    with pytest.raises(UserError, match=r'plant3\.fmu failed at'):
        plant.step(1, np.zeros(9), 0)
    plant.close()


def test_an_fmu_with_other_names_is_mapped_and_what_is_missing_is_named(fmu):
    with pytest.raises(UserError, match="no input 'my_voltage'"):
        ForeignPlant(fmu(), {'y_linear_voltage_1': 'my_voltage'}, TIMING)
    plant = ForeignPlant(fmu(), {'y_linear_counts': 'x_rotate_counts'}, TIMING)
    assert plant.values()[0] == plant.values()[1]
    plant.close()
    with pytest.raises(UserError, match="no input 'y_linear_voltage_1'"):
        ForeignPlant(fmu('copley', '3', ()), {}, TIMING)


WITH_AN_ARRAY = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="stage" instantiationToken="{an-array}">
<CoSimulation modelIdentifier="stage"/>
<ModelVariables>
<Float64 name="u" valueReference="1" causality="input" start="0 0"><Dimension start="2"/></Float64>
<Float64 name="y" valueReference="2" causality="output"><Dimension start="2"/></Float64>
</ModelVariables>
<ModelStructure><Output valueReference="2"/></ModelStructure>
</fmiModelDescription>
"""


@pytest.mark.parametrize(
    ('ours', 'theirs'), [('y_linear_voltage_1', 'u'), ('y_linear_counts', 'y')]
)
def test_an_array_is_no_signal_of_an_axis(tmp_path, ours, theirs):
    """FMI 3.0 has arrays; one of them for one voltage would fail in the first tick, or before it."""
    with zipfile.ZipFile(tmp_path / 'stage.fmu', 'w') as archive:
        archive.writestr('modelDescription.xml', WITH_AN_ARRAY)
    nothing = {variable.name: None for variable in voltages()} | {
        variable.name: 0 for variable in (*counts(), *lines())
    }
    with pytest.raises(UserError, match=f"'{theirs}' \\(it is an array\\)"):
        ForeignPlant(tmp_path / 'stage.fmu', nothing | {ours: theirs}, TIMING)


def test_an_output_that_cannot_be_read_is_told_as_the_fault_of_the_fmu(fmu):
    plant = ForeignPlant(fmu(), {}, TIMING)
    (getter, present, references), *others = plant._outputs
    plant._outputs = [(getter, present, [10**6] * len(references)), *others]
    with pytest.raises(UserError, match=r'plant3\.fmu gives no outputs'):
        plant.values()
    plant.close()


def test_what_is_no_fmu_is_refused_in_one_line(tmp_path, capsys):
    file = tmp_path / 'broken.fmu'
    for content in (b'', b'PK\x03\x04'):
        file.write_bytes(content)
        assert (
            main(['run', '--engine', 'inprocess', '--plant', str(file), '--duration', '0.01']) == 1
        )
        error = capsys.readouterr().err
        assert 'broken.fmu' in error
        assert 'Traceback' not in error
    with zipfile.ZipFile(file, 'w') as archive:
        archive.writestr('modelDescription.xml', '<fmiModelDescription fmiVersion="3.0"/>')
    assert main(['run', '--engine', 'inprocess', '--plant', str(file), '--duration', '0.01']) == 1
    assert main(['run', '--engine', 'inprocess', '--plant', str(tmp_path / 'gone.fmu')]) == 1
    assert 'no such file' in capsys.readouterr().err
    assert main(['export-fmu', '--out', str(tmp_path / 'plant.zip')]) == 1
    assert '.fmu' in capsys.readouterr().err


def test_the_same_model_gives_the_same_identity(fmu, tmp_path):
    about = export(model(), 'plant', (MASS,), '3', tmp_path / 'again.fmu')
    assert fmpy.read_model_description(str(fmu())).instantiationToken == about['identity']
