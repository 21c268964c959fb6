# SPDX-License-Identifier: Apache-2.0
"""Experiments of a machine's own axes: beside the shipped ones, within strokes, as a command."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import (
    check_units,
    commanded_positions,
    load_experiment,
    shipped_experiments,
    suits,
)
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.cli.main import main
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model
from waferbot_twin.tuning.own_experiments import own_experiments

TIMING = Timing()
OWN = {'lift': 'm', 'turn': 'rad', 'flange': 'rad'}


def commanded(text, model, units=USUAL_UNITS):
    """Return the commanded positions (n, axes) of an experiment, m or rad."""
    parameters = servo_parameters(model.of_axes('pmac'), 'test', model.layout)
    path = commanded_positions(load_experiment(text), parameters, TIMING.servo_hz, units)
    return path / parameters[0]['counts_per_unit']


def test_those_of_the_shipped_machine_are_the_shipped_ones():
    """To nine digits, all that move one axis alone and the step of all."""
    model = load_model('rigid')
    made = own_experiments(USUAL_UNITS, {})
    shipped = [
        name for name in shipped_experiments() if name not in ('constant', 'wafer_exchange')
    ]
    assert sorted(made) == sorted([*shipped, 'full_strokes'])
    for name in shipped:
        if name.startswith('multisine') or name.startswith('swept'):
            continue  # 8 s each: their numbers are those of the others' code
        expected = commanded(name, model)
        found = commanded(made[name], model)
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() <= 1e-7 * np.abs(expected).max(), name


def test_they_suit_the_axes_and_keep_to_their_strokes():
    made = own_experiments(OWN, {'lift': 0.05, 'turn': -0.4})
    assert len(made) == 6 * 3 + 2
    for name, text in made.items():
        assert not suits(load_experiment(text), USUAL_UNITS), name
        check_units(load_experiment(text), OWN)
    data = {name: load_experiment(text).document.data for name, text in made.items()}
    assert data['full_strokes']['program'][1]['linear'] == {
        'lift_m': 0.05,
        'turn_rad': -0.4,
        'flange_rad': pytest.approx(np.pi / 2, abs=1e-5),
    }
    assert data['slow_velocity_lift']['motion']['lift']['distance_m'] == 0.05
    assert data['slow_velocity_flange']['motion']['flange'] == {
        **load_experiment('slow_velocity_x_rotate').motion['x_rotate'][0].values
    }
    # What is no way is not made smaller with it.
    glide, sines = data['multisine_turn']['motion']['turn']
    assert glide['distance_rad'] == -0.4
    assert sines['amplitude_rad'] == 1.2e-3
    for strokes, said in (
        ({'wrist': 1.0}, 'has no such axis; it has lift, turn, flange'),
        ({'lift': 0.0}, 'give how far it may go'),
        ({'lift': np.nan}, 'give how far it may go'),
    ):
        with pytest.raises(UserError, match=said):
            own_experiments(OWN, strokes)


@pytest.mark.slow
def test_the_command_writes_what_the_machine_runs(tmp_path, capsys):
    model, folder = tmp_path / 'gantry.yaml', tmp_path / 'experiments'
    bandwidths = ('y_linear=25', 'x_rotate=20', 'y_rotate=10')
    arguments = ['commission', 'gantry', '--out', str(model), '--experiments', str(folder)]
    arguments += [part for one in bandwidths for part in ('--bandwidth', one)]
    assert main([*arguments, '--stroke', 'y_linear=-0.06', '--stroke', 'y_rotate=0.2']) == 0
    assert f'20 experiments: {folder}/step.yaml' in capsys.readouterr().err
    loaded = load_model(str(model))
    units = dict.fromkeys(loaded.layout.axes, 'm')
    path = commanded(folder / 'full_strokes.yaml', loaded, units)
    assert path.min(axis=0) == pytest.approx([-0.06, 0.0, 0.0], abs=1e-5)
    assert path.max(axis=0) == pytest.approx([0.0, 0.3, 0.2], abs=1e-5)
    for name in ('step', 'full_strokes', 'random_x_rotate'):
        twin = Twin.of(loaded, TIMING, load_experiment(folder / f'{name}.yaml'))
        twin.advance(TIMING.ticks(0.5))
        assert not twin.servo_state['killed'].any(), name
    assert main([*arguments[:4], *arguments[6:], '--stroke', 'y_linear=1', '--force']) == 1
    assert '--stroke is for --experiments' in capsys.readouterr().err
    assert main([*arguments, '--stroke', 'y_linear=far', '--force']) == 1
    assert 'give AXIS=LENGTH' in capsys.readouterr().err


def test_a_machine_with_one_of_the_shipped_axes_gets_experiments_of_that_one(tmp_path):
    model, folder = tmp_path / 'stage.yaml', tmp_path / 'experiments'
    arguments = ['commission', 'ball_screw_stage', '--bandwidth', 'y_linear=25']
    assert main([*arguments, '--out', str(model), '--experiments', str(folder)]) == 0
    written = {file.stem: load_experiment(file).document.data for file in folder.glob('*.yaml')}
    assert len(written) == 6 + 2
    assert list(written['step']['motion']) == ['y_linear']
    assert not [name for name in written if 'rotate' in name]
    twin = Twin.of(load_model(str(model)), TIMING, load_experiment(folder / 'full_strokes.yaml'))
    twin.advance(TIMING.ticks(0.3))
    assert not twin.servo_state['killed'].any()
