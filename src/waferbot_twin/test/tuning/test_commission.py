# SPDX-License-Identifier: Apache-2.0
"""A model out of a description: against the closed form of the loop, and what cannot be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.models import load_model, load_model_or_machine
from waferbot_twin.response import simulated_responses
from waferbot_twin.tuning.commission import DAMPING_RATIO, commission

TIMING = Timing()
STEP_OF_THE_GANTRY = """name: step
duration_s: 0.6
motion: {{{}: {{kind: step, start_s: 0.02, amplitude_m: 2.0e-4}}}}
"""


def machine(name):
    return Variant.of(load_model_or_machine(name))


def stepped(variant, axis, experiment, duration_s=0.2):
    twin = Twin.of(variant.model(), TIMING, load_experiment(experiment))
    signals = twin.advance(TIMING.ticks(duration_s))
    assert not twin.servo_state['killed'].any()
    return next(one for one in simulated_responses(twin, signals) if one.axis == axis)


def test_a_single_mass_steps_as_the_loop_that_was_asked_for():
    """(2 z w s + w^2) / (s^2 + 2 z w s + w^2): D on the error, as velocity feedforward makes it."""
    hertz = 8.0
    free = machine('single_mass').with_overlay(
        Overlay({'frictions': dict.fromkeys(machine('single_mass').machine['frictions'])})
    )
    response = stepped(commission(free, {'y_linear': hertz}), 'y_linear', 'step_y_linear')
    omega = 2.0 * math.pi * hertz
    damped = 2.0 * DAMPING_RATIO * omega
    time, expected = signal.step(
        ([damped, omega**2], [1.0, damped, omega**2]), T=np.linspace(0.0, 0.17, 500)
    )
    start_s, height = response.step()
    found = np.interp(time + start_s, response.encoder_time, response.position) / height
    assert np.abs(found - expected).max() < 0.05


def test_settings_are_those_that_the_shipped_machine_has_by_hand():
    """Counts of an electrical cycle, Cp, Ci, encoders: docs of the drive, worked out once more."""
    shipped = machine('rigid')
    model = Variant.of(load_model('rigid'))
    found = commission(shipped, {'y_linear': 20.0, 'x_rotate': 20.0, 'y_rotate': 9.0})
    for axis, settings in found.copley.items():
        for name, value in settings.items():
            assert value == pytest.approx(model.amplifier_setting(axis, name), rel=2e-3), name
    for axis in ('y_linear', 'x_rotate'):
        for name in ('Ixx03', 'counts_per_unit', 'Ixx29', 'Ixx16', 'Ixx22'):
            assert found.i_variable(axis, name) == pytest.approx(
                model.i_variable(axis, name), rel=2e-2
            )


@pytest.mark.parametrize(
    ('name', 'bandwidths'),
    [
        ('ball_screw_stage', {'y_linear': 25.0}),
        ('scara', {'y_linear': 15.0, 'x_rotate': 8.0, 'y_rotate': 8.0}),
        ('gantry', {'y_linear': 25.0, 'x_rotate': 20.0, 'y_rotate': 10.0}),
    ],
)
def test_other_machines_follow_with_it(name, bandwidths):
    variant = commission(machine(name), bandwidths)
    for axis in bandwidths:
        response = stepped(
            variant,
            axis,
            STEP_OF_THE_GANTRY.format(axis) if name == 'gantry' else f'step_{axis}',
            0.6,
        )
        _, height = response.step()
        assert abs(response.position[-1] - response.commanded[-1]) < 0.5 * abs(height)
        assert np.abs(response.position - response.commanded[0]).max() < 2.0 * abs(height)


@pytest.mark.parametrize(
    ('bandwidths', 'overlay', 'said'),
    [
        ({}, {}, 'say the bandwidth of y_linear as well'),
        ({'y_linear': 20.0, 'x_rotate': 5.0}, {}, 'has no axis x_rotate'),
        ({'y_linear': 20.0}, {'motors': {'y_linear': None}}, 'has no motor'),
        ({'y_linear': 20.0}, {'encoders': {'y_linear': None}}, 'no encoder'),
    ],
)
def test_what_a_machine_lacks_is_told(bandwidths, overlay, said):
    variant = machine('ball_screw_stage').with_overlay(Overlay(overlay))
    with pytest.raises(UserError, match=said):
        commission(variant, bandwidths)


def test_the_command_writes_a_model_that_runs(tmp_path, capsys):
    file = tmp_path / 'stage.yaml'
    arguments = ['commission', 'ball_screw_stage', '--out', str(file)]
    assert main([*arguments, '--bandwidth', 'y_linear=25']) == 0
    assert 'Ixx30' in capsys.readouterr().out
    run = ['run', '--engine', 'inprocess', '--model', str(file), '--experiment', 'step_y_linear']
    assert main([*run, '--duration', '0.05']) == 0
    assert main([*arguments, '--bandwidth', 'y_linear=fast', '--force']) == 1
    assert 'give AXIS=HZ' in capsys.readouterr().err
    assert main([*arguments, '--bandwidth', 'y_linear=25']) == 1
    assert 'exists' in capsys.readouterr().err


def test_what_is_wrong_in_a_description_is_told_with_its_file_and_line(tmp_path, capsys):
    text = whole_text(description_source('ball_screw_stage'))
    file = tmp_path / 'stage.yaml'
    file.write_text(text.replace('pole_pairs:', 'poles:'), 'utf-8')
    (line,) = [place for place, one in enumerate(text.split('\n'), 1) if 'pole_pairs:' in one]
    arguments = ['commission', str(file), '--bandwidth', 'y_linear=25']
    assert main([*arguments, '--out', str(tmp_path / 'model.yaml')]) == 1
    assert f'{file}, line {line}: motors.y_linear.poles: unknown key' in capsys.readouterr().err
