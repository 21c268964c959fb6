# SPDX-License-Identifier: Apache-2.0
"""The shipped machine is what calibration made, within real parts' ranges; the search is repeatable."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.marked_yaml import read
from waferbot_plant import motors, plant
from waferbot_plant.modes import first_frequencies
from waferbot_plant.plant import config_folder, load_machine
from waferbot_twin.calibration.as_built import (
    RING_RADIUS_M,
    as_built_bias,
    as_built_machine,
    with_ring,
)
from waferbot_twin.calibration.evaluation import Evaluation, Residual, servo_record
from waferbot_twin.calibration.machines import describe
from waferbot_twin.calibration.nominal import candidate
from waferbot_twin.calibration.part_data import machine_overlay
from waferbot_twin.calibration.search import STAGES, Stage, search
from waferbot_twin.calibration.values import Unknown, calibrated
from waferbot_twin.cli.main import main
from waferbot_twin.models import load_model
from waferbot_twin.thesis import thesis

AS_BUILT_STAGES = ('as_built_payload', 'as_built_y_rotate')


@pytest.mark.parametrize('name', STAGES)
def test_shipped_values_are_within_the_bounds_of_real_parts(name: str) -> None:
    values = calibrated(name)
    stage = STAGES[name]
    assert set(values) == {unknown.name for unknown in stage.unknowns}
    for unknown in stage.unknowns:
        assert unknown.low <= values[unknown.name] <= unknown.high, unknown.name


def leaves(value, key=()):
    """Key and value of every quantity of an overlay."""
    if isinstance(value, dict) and 'value' in value:
        yield key, value['value']
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from leaves(inner, (*key, name))
    else:
        yield key, value


def numbers(value) -> list[float]:
    if isinstance(value, dict):
        return [number for name in sorted(value) for number in numbers(value[name])]
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [float(value)]


def test_shipped_description_is_what_calibration_makes() -> None:
    """machine.yaml holds every value of the overlay, to the digits that it prints."""
    data = read(config_folder() / 'machine.yaml').data
    for key, wanted in leaves(machine_overlay(calibrated())):
        found = data
        for name in key:
            found = found[name]
        found = found['value'] if isinstance(found, dict) and 'value' in found else found
        assert numbers(found) == pytest.approx(numbers(wanted), rel=2e-4, abs=1e-9), key


def test_parts_make_table_6_7() -> None:
    found = first_frequencies(load_machine('flexible').description)
    for name, wanted in thesis()['first_frequencies_hz'].items():
        assert found[name] == pytest.approx(wanted, rel=2e-3), name


def test_candidate_and_shipped_description_are_the_same_machine() -> None:
    """Stiffness set directly in the search, made by part data in the description: same values."""
    for damping in ('improved', 'calculated'):
        searched = describe(calibrated(), damping)
        shipped = load_machine('flexible', damping=damping).description
        for name, part in shipped.connections.items():
            assert searched.connections[name].stiffness == pytest.approx(part.stiffness, rel=2e-3)
            assert searched.connections[name].loss_factor == pytest.approx(
                part.loss_factor, rel=1e-3
            )
        output = [
            sum(
                float(friction.resistances[0])
                for friction in description.frictions.values()
                if friction.coordinate == 'y_rotate'
            )
            for description in (searched, shipped)
        ]
        assert output[0] == pytest.approx(output[1], rel=1e-3)


def test_shipped_gains_are_those_of_the_tuning_values() -> None:
    wanted = servo_record(candidate(calibrated()).variables)[0]
    shipped = servo_record({})[0]
    for name in ('Ixx30', 'Ixx31', 'Ixx32', 'Ixx33', 'Ixx29'):
        assert shipped[name] == pytest.approx(wanted[name], rel=2e-3, abs=2.0), name


def test_gains_make_the_natural_frequency_and_damping_that_they_are_named_for() -> None:
    """The servo law's force per position and speed, over the moving mass, gives wn and z back."""
    values = calibrated()
    built = candidate(values)
    servo = servo_record(built.variables)[0]
    parameters = built.rigid.parameters()
    state = built.rigid.initial_state(parameters)
    mass = np.zeros((3, 3))
    plant.mass_matrix(state, parameters, mass)
    for place, axis in enumerate(AXES):
        motor = built.rigid.description.motors[axis]
        force = motors.force_constant(motor)
        force *= abs(built.rigid.assembly.placing[motor.coordinate][1])
        amperes_per_count = (
            servo['Ixx30'][place]
            * servo['Ixx08'][place]
            * 2.0**-19
            * servo['amplifier_peak_current'][place]
            / 32768.0
        )
        stiffness = force * amperes_per_count * servo['counts_per_unit'][place]
        wn = math.sqrt(stiffness / mass[place, place])
        z = 0.5 * wn * servo['Ixx31'][place] / 128.0 / 2250.0
        assert wn == pytest.approx(values[f'{axis}_natural_frequency_rad_s'], rel=1e-3)
        assert z == pytest.approx(values[f'{axis}_damping_ratio'], rel=2e-3)


def test_shipped_as_built_machine_is_what_calibration_makes() -> None:
    wanted = as_built_machine(calibrated(*AS_BUILT_STAGES)).description
    shipped = load_machine('as_built').description
    assert shipped.encoder_delay == wanted.encoder_delay > 1
    assert set(shipped.frictions) == set(wanted.frictions)
    for name, friction in wanted.frictions.items():
        assert shipped.frictions[name].resistances == pytest.approx(friction.resistances, rel=1e-4)
        assert shipped.frictions[name].speeds == pytest.approx(friction.speeds)
    for name, damper in wanted.dampers.items():
        assert shipped.dampers[name].damping == pytest.approx(damper.damping, rel=1e-4)
    for name, connection in wanted.connections.items():
        assert shipped.connections[name].stiffness == pytest.approx(connection.stiffness, rel=1e-4)
        assert shipped.connections[name].loss_factor == connection.loss_factor
    for name, body in wanted.bodies.items():
        assert shipped.bodies[name].mass == pytest.approx(body.mass, rel=1e-4)
        assert shipped.bodies[name].centre_of_gravity == pytest.approx(body.centre_of_gravity)
        assert shipped.bodies[name].inertia == pytest.approx(body.inertia, rel=1e-3, abs=1e-6)
    for axis, motor in wanted.motors.items():
        assert shipped.motors[axis].back_emf == pytest.approx(motor.back_emf, rel=1e-4)


def test_as_built_model_has_the_nominal_gains_and_a_bias_of_its_own() -> None:
    nominal = load_model('flexible').of_axes('pmac')
    own = load_model('as_built').of_axes('pmac')
    bias = as_built_bias(as_built_machine(calibrated(*AS_BUILT_STAGES)))
    for axis in AXES:
        assert {**own[axis], 'Ixx29': None} == {**nominal[axis], 'Ixx29': None}
        assert own[axis]['Ixx29'] == pytest.approx(bias[axis]['Ixx29'], abs=1.0)


def test_ring_of_the_as_built_load() -> None:
    """The load's mass, first moment and inertia about the origin grow by just those of the ring."""
    load = load_machine('flexible').description.bodies['x_rotate_load']
    made = with_ring(load, 0.0, 3.0)
    mass, centre = made['mass_kg']['value'], np.array(made['centre_of_gravity_m']['value'])
    moments = np.array([made['inertia_kg_m2']['value'][name] for name in ('xx', 'yy', 'zz')])
    ring_centre = load.centre_of_gravity * [1.0, 1.0, 0.0]  # on the axis of X-Rotate

    def about_origin(mass, centre, moments):
        return moments + mass * (centre @ centre - centre**2)

    assert mass == pytest.approx(load.mass + 3.0)
    assert mass * centre == pytest.approx(load.mass * load.centre_of_gravity + 3.0 * ring_centre)
    assert about_origin(mass, centre, moments) == pytest.approx(
        about_origin(load.mass, load.centre_of_gravity, np.diag(load.inertia))
        + about_origin(3.0, ring_centre, 3.0 * RING_RADIUS_M**2 * np.array([1.0, 0.5, 0.5]))
    )


def bowl(values) -> Evaluation:
    """A toy: thesis 0.04 s, ours (x^2 + y^2 + 0.04)."""
    ours = values['x'] ** 2 + values['y'] ** 2 + 0.04
    return Evaluation([Residual('y_rotate', 'flexible', 'rise_time', 0.04, ours)])


def test_search_is_repeatable_and_improves() -> None:
    unknowns = (Unknown('x', -1.0, 1.0), Unknown('y', -1.0, 1.0))
    stage = Stage('bowl', unknowns, bowl, 40, 20)
    # Near enough that some of the first population cost less than the 12 tolerances that are the most.
    start = {'x': 0.3, 'y': -0.2, 'other': 7.0}
    first, second = search(stage, start), search(stage, start)
    assert first == second
    assert first['other'] == 7.0
    assert bowl(first).cost < 1e-3 < bowl(start).cost
    assert search(stage, start, 0) == start


def test_search_tells_every_candidate() -> None:
    unknowns = (Unknown('x', -1.0, 1.0), Unknown('y', -1.0, 1.0))
    told: list[tuple[int, int]] = []
    search(
        Stage('bowl', unknowns, bowl, 40, 20),
        {'x': 0.3, 'y': -0.2},
        3,
        lambda done, total: told.append((done, total)),
    )
    assert told == [(done, 80) for done in range(1, 81)]


@pytest.mark.slow
def test_two_processes_find_the_same_values_to_the_last_bit() -> None:
    stage = dataclasses.replace(STAGES['y_rotate'], population=8)
    start = calibrated()
    one, two = (search(stage, start, 2, workers=workers) for workers in (1, 2))
    assert one == two


def test_cost_of_rows() -> None:
    """Nothing to speak of within 0.8 tolerances, then one per tolerance; not a number is worst."""
    near = Evaluation([Residual('x_rotate', 'rigid', 'rise_time', 0.01, 0.0104)])
    far = Evaluation([Residual('x_rotate', 'rigid', 'rise_time', 0.01, 0.0115)])
    none = Evaluation([Residual('x_rotate', 'rigid', 'rise_time', 0.01, math.nan)])
    assert near.cost == pytest.approx(0.03 * 0.8**2)
    assert far.cost == pytest.approx(3.0 - 0.8 + 0.03 * 9.0)
    assert none.cost == pytest.approx(12.0 - 0.8 + 0.03 * 9.0)
    overshoot = Residual('x_rotate', 'rigid', 'overshoot_percent', 44.5, 46.5)
    assert overshoot.tolerances == pytest.approx(1.0)


def test_calibrate_command(tmp_path, capsys) -> None:
    out = tmp_path / 'calibration'
    arguments = ['calibrate', '--evaluate', '--stage', 'y_rotate', '--json']
    assert main([*arguments, '--out', str(out)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result['y_rotate']['rows']) == 12
    assert sorted(path.name for path in out.glob('[!.]*')) == [
        'as_built_overlay.yaml', 'as_built_pmac.yaml', 'calibrated.yaml', 'machine_overlay.yaml',
        'pmac.yaml',
    ]  # fmt: skip
    assert main([*arguments, '--out', str(out)]) == 1
    assert '--force' in capsys.readouterr().err
    load_machine('flexible', overlays=[out / 'machine_overlay.yaml'])
