# SPDX-License-Identifier: Apache-2.0
"""What holds the machine, by hand; its frequencies, against Table 6.7 and plain eigenvalues."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import plant_machines as machines
import pytest
import scipy.linalg

from waferbot_lockstep.errors import UserError
from waferbot_plant import modes, motors, plant, statics
from waferbot_plant.plant import config_folder, load_machine

TABLE_6_7 = {
    'cable': 37.44,
    'counterweight_bearing_x': 265.29,
    'counterweight_bearing_y': 197.25,
    'counterweight_bearing_z': 140.58,
    'payload_bearing_x': 1179.05,
    'payload_bearing_y': 254.36,
    'payload_bearing_z': 235.70,
    'x_rotate_bearing_radial': 433.18,
    'x_rotate_bearing_y': 77.35,
    'x_rotate_bearing_z': 76.28,
    'x_rotate_shaft_torsion': 1629.27,
    'x_rotate_shaft_bending': 349.86,
    'gearbox': 19.74,
    'belt': 19.74,
}

GRAVITY = 9.81


@pytest.mark.parametrize('connection', TABLE_6_7)
def test_first_frequency_of_table_6_7(connection: str) -> None:
    """Thirteen rows (gearbox and belt are one), each within 1 %, through the part equations."""
    frequencies = modes.first_frequencies(load_machine('rigid').description)
    assert frequencies[connection] == pytest.approx(TABLE_6_7[connection], rel=0.01)


def test_rule_of_ten_bandwidths_picks_the_simplified_model() -> None:
    description = load_machine('rigid').description
    picked = modes.pick_simplified(description, 30.0)
    simplified = load_machine('simplified').description.connections
    assert picked == {
        name: 'flexible' if part.flexible else 'rigid' for name, part in simplified.items()
    }
    assert len([state for state in picked.values() if state == 'rigid']) == 4


def test_switches_are_written_as_a_description_that_loads(tmp_path: Path) -> None:
    machine = load_machine('rigid')
    path = tmp_path / 'own.yaml'
    base = str(config_folder() / 'machine.yaml')
    modes.write_switches(path, base, modes.pick_simplified(machine.description, 10.0))
    assert load_machine(path).coordinates == (
        'y_linear', 'x_rotate_bearing_y', 'x_rotate_bearing_z',
        'x_rotate', 'y_rotate', 'counterweight', 'y_rotate_motor',
    )  # fmt: skip
    with pytest.raises(UserError, match='exists'):
        modes.write_switches(path, base, {})


def test_coupled_modes_are_the_eigenvalues_of_the_equations() -> None:
    """M from MuJoCo, K from the description: the same frequencies; shapes are orthogonal in M."""
    machine = load_machine('flexible')
    found = modes.coupled_modes(machine)
    twin = machines.MujocoTwin(machine)
    size = len(machine.coordinates)
    home = np.zeros(size)
    twin.acceleration(home, home, home)
    full = np.zeros((twin.model.nv, twin.model.nv))
    twin.full_mass_matrix(full)
    mass = twin.projection.T @ full @ twin.projection
    squares = scipy.linalg.eigh(statics.elastic_stiffness(machine), mass, eigvals_only=True)
    expected = np.sqrt(np.maximum(squares[3:], 0.0)) / (2.0 * math.pi)
    assert [mode.frequency_hz for mode in found] == pytest.approx(expected, rel=1e-3)
    shapes = np.array([[mode.shape[name] for name in machine.coordinates] for mode in found])
    products = shapes @ mass @ shapes.T
    scale = np.sqrt(np.outer(np.diag(products), np.diag(products)))
    assert np.abs(products / scale - np.eye(len(found))).max() < 1e-6
    for mode in found:
        assert sum(mode.energy.values()) == pytest.approx(1.0)
        assert 0.0 < mode.damping_ratio < 0.1


def test_free_vibration_has_the_modal_frequency() -> None:
    """The cable mode, seen in the time response of the whole machine."""
    machine = load_machine('flexible')
    cable = next(
        mode for mode in modes.coupled_modes(machine) if mode.energy.get('cable', 0) > 0.5
    )
    parameters = machine.parameters()
    parameters[0]['friction_resistance'] = 0.0
    state = machine.initial_state(parameters)
    s = state[0]
    s['terminals_open'][:] = 1
    for axis, force in statics.holding_forces(machine, parameters, {}).items():
        coordinate = machine.description.motors[axis].coordinate
        s['external_force'][machine.coordinates.index(coordinate)] = force
    shape = np.array([cable.shape[name] for name in machine.coordinates])
    position = s['position'][: len(shape)]
    position += 1e-5 * shape
    record = []
    mass = np.zeros((len(shape), len(shape)))
    plant.mass_matrix(state, parameters, mass)
    for _ in range(18000):
        plant.advance(state, parameters, np.zeros(9))
        record.append(shape @ mass @ position)
    signal = np.array(record)
    crossings = np.nonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))[0]
    fine = crossings + signal[crossings] / (signal[crossings] - signal[crossings + 1])
    frequency = 18000.0 * (len(fine) - 1) / (fine[-1] - fine[0])
    assert frequency == pytest.approx(cable.frequency_hz, rel=1e-4)


@pytest.mark.parametrize(
    'model', ['rigid', pytest.param('simplified', marks=pytest.mark.slow), 'flexible']
)
@pytest.mark.parametrize('angle', [0.0, 0.4, -1.1])
def test_holding_forces_by_hand(model: str, angle: float) -> None:
    """
    Y-Linear holds what the counterweight does not; X-Rotate holds the offset of its loads.

    That offset counts with the cosine of their angle, which is the angle of the axis and what
    shaft and guides give under the change of moment since home.
    """
    machine = load_machine(model)
    parameters = machine.parameters()
    bodies = machine.description.bodies
    moment = sum(
        bodies[name].mass * bodies[name].centre_of_gravity[2]
        for name in ('x_rotate_load', 'y_rotate_load')
    )
    assert moment > 1.0
    forces = statics.holding_forces(machine, parameters, {'x_rotate': angle})
    unbalanced = sum(
        body.mass if name != 'counterweight' else -body.mass for name, body in bodies.items()
    )
    assert forces['y_linear'] == pytest.approx(unbalanced * GRAVITY, rel=1e-9, abs=1e-9)
    turned = angle
    if model == 'flexible':
        change = moment * GRAVITY * (1.0 - math.cos(angle))
        for name in ('payload_bearing_x', 'x_rotate_shaft_torsion'):
            turned -= change / machine.description.connections[name].stiffness
    assert forces['x_rotate'] == pytest.approx(-moment * GRAVITY * math.cos(turned), rel=1e-6)
    currents = statics.holding_currents(machine, parameters, {'x_rotate': angle})
    constant = math.sqrt(3.0) / 2.0 * machine.description.motors['x_rotate'].back_emf
    assert currents['x_rotate'] == pytest.approx(forces['x_rotate'] / constant, rel=1e-12)


def test_reactions_at_home_by_hand() -> None:
    """Cable tension, guide moments (5.20), (5.21) and the overhang on the X-Rotate bearing."""
    machine = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    found = statics.reactions(machine, state, parameters)
    bodies = machine.description.bodies
    payload = [body for name, body in bodies.items() if name != 'counterweight']
    load = [bodies[name] for name in ('x_rotate_rotor', 'x_rotate_load', 'y_rotate_load')]

    def moment(members, axis: int, at: float) -> float:
        return sum(body.mass * GRAVITY * (body.centre_of_gravity[axis] - at) for body in members)

    assert found['cable'] == pytest.approx(bodies['counterweight'].mass * GRAVITY, rel=1e-9)
    assert found['payload_bearing_z'] == pytest.approx(-moment(payload, 0, 0.0), rel=1e-9)
    assert found['payload_bearing_x'] == pytest.approx(moment(payload, 2, 0.0), rel=1e-9)
    assert found['payload_bearing_y'] == pytest.approx(0.0, abs=1e-9)
    joints = machine.description.joints
    assert found['x_rotate_bearing_z'] == pytest.approx(
        -moment(load, 0, joints['x_rotate'].at[0]), rel=1e-9
    )
    carried = sum(body.mass for body in load)
    assert found['x_rotate_bearing_radial'] == pytest.approx(-carried * GRAVITY, rel=1e-9)
    counterweight = [bodies['counterweight']]
    assert found['counterweight_bearing_z'] == pytest.approx(
        -moment(counterweight, 0, joints['counterweight_guide'].at[0]), rel=1e-9
    )
    assert found['counterweight_bearing_x'] == pytest.approx(
        moment(counterweight, 2, 0.0), rel=1e-9
    )


@pytest.mark.parametrize('model', ['rigid', 'flexible'])
def test_held_state_stays_where_it_is(model: str) -> None:
    """With the holding currents kept up by R i, nothing moves, even without friction."""
    machine = load_machine(model)
    parameters = machine.parameters()
    parameters[0]['friction_resistance'] = 0.0
    where = {'y_linear': 0.12, 'x_rotate': 0.5, 'y_rotate': -0.8}
    state = machine.initial_state(parameters, where, holding=True)
    start = state[0]['position'].copy()
    voltage = np.zeros(9)
    for motor in range(3):
        across = parameters[0]['resistance'][motor] * state[0]['winding_current'][motor]
        if parameters[0]['winding'][motor] == motors.DELTA:  # terminal 2 as the reference
            across = np.array([across[0], 0.0, -across[1]])
        voltage[3 * motor : 3 * motor + 3] = across
    for _ in range(180):
        plant.advance(state, parameters, voltage)
    assert np.abs(state[0]['velocity']).max() < 1e-7
    assert np.abs(state[0]['position'] - start).max() < 1e-9


def test_unknown_axis_and_unheld_machine_are_refused() -> None:
    machine = load_machine('rigid')
    with pytest.raises(UserError, match="did you mean 'x_rotate'"):
        machine.initial_state(machine.parameters(), {'x_rotat': 0.1})
    bare = load_machine(machines.write_single_mass())
    with pytest.raises(UserError, match='held neither by a motor'):
        bare.initial_state(bare.parameters(), holding=True)
