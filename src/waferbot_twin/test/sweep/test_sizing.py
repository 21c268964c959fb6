# SPDX-License-Identifier: Apache-2.0
"""Sizing: closed forms of losses and temperatures, an axis that is held, the thermal model itself."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.motors import force_constant
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.main import main
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.identification.named_parameters import at_path
from waferbot_twin.models import load_model
from waferbot_twin.sweep.evaluation import Task, check_measures, evaluate
from waferbot_twin.sweep.sizing import (
    copper_loss,
    heating_of,
    largest_shares,
    size,
    steady_temperature,
)

TIMING = Timing()


@pytest.fixture(scope='module')
def flexible():
    return Variant.of(load_model('flexible'))


def rows_of(rows):
    return {(row.part, row.what): row for row in rows}


def test_a_sine_of_current_loses_three_quarters_of_the_resistance_lead_to_lead(flexible):
    """Lines of amplitude I in a star of R/2 each: 3 R/2 I^2/2."""
    motor = flexible.description.motors['x_rotate']
    angle = np.linspace(0.0, 2.0 * np.pi, 3000, endpoint=False)
    lines = 5.0 * np.column_stack([np.sin(angle), np.sin(angle - 2.0 * np.pi / 3.0)])
    assert copper_loss(motor, lines) == pytest.approx(0.75 * motor.resistance * 25.0, rel=1e-12)


def test_the_steady_temperature_balances_loss_and_heat_to_the_air(flexible):
    heating = heating_of(flexible, 'x_rotate')
    assert heating is not None
    for loss in (0.0, 20.0, 100.0, 300.0):
        warm = steady_temperature(heating, loss)
        hot = loss * (1.0 + heating.coefficient * (warm - heating.resistance_at))
        assert (warm - heating.air) / heating.to_air == pytest.approx(hot, abs=1e-9)
    assert steady_temperature(heating, 1.1 / (heating.coefficient * heating.to_air)) == np.inf


@pytest.mark.slow
def test_the_thermal_model_of_the_plant_ends_where_sizing_says(flexible):
    """An arm that is held, with a winding of little heat capacity: 20 time constants of simulation."""
    quick = {
        'state': 'warming', 'winding_to_air_k_w': 0.2, 'winding_capacity_j_k': 0.25,
    }  # fmt: skip
    variant = flexible.with_overlay(Overlay({'motors': {'x_rotate': {'heating': quick}}}))
    held = replace(load_experiment('constant'), duration_s=1.0)
    rows = rows_of(size(variant, held, TIMING).rows)
    twin = Twin.of(variant.model(), TIMING, held)
    twin.advance(TIMING.ticks(1.0))
    reached = float(twin.plant_state[0]['winding_temperature'][1])
    assert rows['x_rotate', 'windings, repeated for ever'].value == pytest.approx(
        reached, rel=2e-3
    )


def test_an_axis_that_is_held_needs_the_torque_of_its_weight(flexible):
    held = replace(load_experiment('constant'), duration_s=0.2)
    rows = rows_of(size(flexible, held, TIMING).rows)
    twin = Twin.of(flexible.model(), TIMING, held)
    forces = twin.machine.resting_state(twin.plant_parameters)  # the static equilibrium
    motor = flexible.description.motors['x_rotate']
    winding = forces[0]['winding_current'][1]
    needed = rows['x_rotate', 'RMS torque'].value
    assert needed == pytest.approx(rows['x_rotate', 'peak torque'].value, rel=0.02)
    # Peak of the sine of the lines of a star whose windings carry these.
    amplitude = np.sqrt(2.0 / 3.0 * np.sum(np.square(winding)))
    assert needed == pytest.approx(force_constant(motor) * amplitude, rel=0.02)


@pytest.mark.slow
def test_the_command_says_what_is_above_its_limit(capsys):
    arguments = ['size', '--model', 'as_built', '--experiment', 'wafer_exchange', '--json']
    assert main([*arguments, '--fail-above']) == 1
    found = json.loads(capsys.readouterr().out)
    assert 'belt' in found['above']  # a span goes slack: docs/mechanism.md
    by = {(row['part'], row['what']): row for row in found['rows']}
    assert by['belt', 'tension of the slack span']['value'] < 0.0
    assert by['belt', 'tension of the slack span']['share'] > 1.0
    assert by['y_linear', 'RMS force']['share'] < 0.2
    assert main([*arguments[:-1]]) == 0
    assert 'above its limit: ' in capsys.readouterr().out


def test_a_run_that_ends_badly_sizes_nothing(flexible):
    weak = Variant.of(load_model('rigid')).with_overlay(
        Overlay(pmac={'y_linear': {'Ixx11': 10, 'Ixx12': 5}})
    )
    with pytest.raises(UserError, match='was killed'):
        size(weak, load_experiment('full_stroke_y_linear'), TIMING)


def test_the_largest_share_of_a_part_counts(flexible):
    rows = size(flexible, replace(load_experiment('constant'), duration_s=0.05), TIMING).rows
    shares = largest_shares(rows)
    assert shares['belt'] == max(row.share for row in rows if row.part == 'belt')


@pytest.mark.slow
def test_a_sweep_measures_what_parts_bear(flexible):
    measures = check_measures(
        ['load_percent.belt', 'winding_temperature_degc.x_rotate', 'load_percent.x_rotate'],
        flexible,
    )
    path = 'bodies.x_rotate_load.mass_kg'
    mass = at_path(path, flexible).start
    task = Task(flexible, (path,), 'step_y_rotate', measures)
    light, heavy = (evaluate(task, np.array([share * mass])) for share in (0.9, 1.01))
    assert light[1] == heavy[1] == ''
    expected = rows_of(size(flexible, load_experiment('step_y_rotate'), TIMING).rows)
    (same, _) = evaluate(task, np.array([mass]))
    assert same[1] == pytest.approx(expected['x_rotate', 'windings, repeated for ever'].value)
    assert light[0][1] < same[1] < heavy[0][1]  # it holds the weight
    assert same[2] == pytest.approx(100.0 * largest_shares(list(expected.values()))['x_rotate'])
    with pytest.raises(UserError, match="did you mean 'belt'"):
        check_measures(['load_percent.blet'], flexible)


def test_the_duty_of_a_motor_is_what_its_rows_are_of(flexible, tmp_path, capsys):
    """Force over speed of a move of 0.1 m at 0.2 m/s: its speed, the greatest force, the limits."""
    motion = tmp_path / 'move.yaml'
    motion.write_text(
        'name: move\ndescription: one axis\nduration_s: 0.8\nmotion:\n  y_linear:\n'
        '    - {kind: linear, start_s: 0.05, distance_m: 0.1, speed_m_per_s: 0.2,\n'
        '       acceleration_time_s: 0.1, s_curve_time_s: 0.02}\n',
        'utf-8',
    )
    found = size(flexible, load_experiment(motion), TIMING)
    rows = rows_of(found.rows)
    duty = next(one for one in found.duties if one.axis == 'y_linear')
    assert (duty.speed_unit, duty.unit) == ('m/s', 'N')
    assert len(duty.speed) == len(duty.force)
    assert np.max(duty.speed) == pytest.approx(0.2, rel=0.05)
    assert np.sum(duty.speed) / TIMING.current_loop_hz == pytest.approx(0.1, rel=0.01)
    assert np.max(np.abs(duty.force)) == pytest.approx(rows['y_linear', 'peak force'].value)
    assert duty.effective == pytest.approx(rows['y_linear', 'RMS force'].value)
    assert duty.continuous == pytest.approx(duty.effective / rows['y_linear', 'RMS force'].share)
    command = ['size', '--model', 'flexible', '--experiment', str(motion), '--out']
    folder = tmp_path / 'sizing'
    assert main([*command, str(folder), '--json']) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((folder / 'sizing.json').read_text())
    assert (folder / 'sizing.png').read_bytes().startswith(b'\x89PNG')
    assert main([*command, str(folder)]) == 1
    assert 'exists' in capsys.readouterr().err
