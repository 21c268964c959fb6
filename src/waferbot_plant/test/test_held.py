# SPDX-License-Identifier: Apache-2.0
"""Held coordinates and tied pairs, against the machine without those freedoms."""

from __future__ import annotations

import numpy as np
import pytest
from test_integrator import run

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, modes, plant, statics
from waferbot_plant.plant import Machine, load_machine

AXES = ('y_linear', 'x_rotate', 'y_rotate')
CHOICES = {
    'all': None,
    'joints': ['payload_bearing_x', 'payload_bearing_z', 'x_rotate_bearing_y'],
    'one of two in series': ['x_rotate_shaft_bending', 'gearbox'],
    'drive': ['gearbox', 'belt'],
    'cable': ['cable'],
}


def switches(machine: Machine, names: list[str] | None, state: str) -> dict[str, str]:
    """Return switches that set the named connections, or all."""
    return dict.fromkeys(names or machine.description.connections, state)


def axes_after(machine: Machine, ticks: int, parameters: np.ndarray) -> np.ndarray:
    """Return the axes' positions at every tick of a driven run, each over its largest."""
    state = machine.initial_state(parameters, {}, holding=True)
    record = np.zeros((ticks, len(machine.coordinates)))
    run(state, parameters, ticks, np.array([60.0, 60.0, 20.0]), record)
    places = [machine.assembly.placing[machine.description.axes[axis]] for axis in AXES]
    return np.array([ratio * record[:, place] for place, ratio in places])


@pytest.mark.parametrize('choice', CHOICES)
@pytest.mark.parametrize('friction', [True, False])
def test_held_moves_as_rigid_does(choice: str, friction: bool) -> None:
    """Driven hard with and without friction, stick and slip included: to rounding."""
    names = CHOICES[choice]
    flexible = load_machine('flexible')
    held = load_machine('flexible', switches(flexible, names, 'held'))
    rigid = load_machine('flexible', switches(flexible, names, 'rigid'))
    assert held.coordinates == flexible.coordinates
    assert len(rigid.coordinates) < len(held.coordinates) or choice == 'one of two in series'
    found = []
    for machine in (held, rigid):
        parameters = machine.parameters()
        if not friction:
            parameters[0]['friction_resistance'] = 0.0
        found.append(axes_after(machine, 4000, parameters))
    scale = np.abs(found[1]).max(axis=1, keepdims=True)
    assert (scale[:, 0] > 1e-3).all()
    difference = (np.abs(found[0] - found[1]) / scale).max()
    print('relative difference', difference)
    assert difference < 1e-9


def test_held_coordinates_do_not_move_by_a_bit_and_followers_keep_their_ratio() -> None:
    machine = load_machine('flexible', 'held')
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {}, holding=True)
    record = np.zeros((3000, len(machine.coordinates)))
    run(state, parameters, 3000, np.array([60.0, 60.0, 20.0]), record)
    place = machine.coordinates.index
    free = {'y_linear', 'x_rotate', 'y_rotate', 'y_rotate_motor', 'counterweight'}
    for name in set(machine.coordinates) - free:
        assert not record[:, place(name)].any()
    assert np.abs(record[:, place('counterweight')] + record[:, place('y_linear')]).max() < 1e-15
    ratio = machine.description.transmissions['y_rotate_drive'].ratio
    twist = record[:, place('y_rotate')] - ratio * record[:, place('y_rotate_motor')]
    assert np.abs(record[:, place('y_rotate')]).max() > 0.05
    assert np.abs(twist).max() < 1e-14


def test_every_choice_of_held_has_the_same_dtype_and_can_be_made_while_it_runs() -> None:
    """Setting the parameters of the flexible machine is the same as loading it held."""
    flexible = load_machine('flexible')
    held = load_machine('flexible', 'held')
    assert held.parameter_dtype == flexible.parameter_dtype
    assert held.state_dtype == flexible.state_dtype
    parameters = flexible.parameters()
    connected = [bool(element.connections) for element in flexible.assembly.springs]
    parameters[0]['spring_held'][: len(connected)] = connected
    parameters[0]['cable_held'] = 1
    found = axes_after(flexible, 500, parameters), axes_after(held, 500, held.parameters())
    assert found[0].tobytes() == found[1].tobytes()
    by_coordinate = flexible.parameters()
    for element in flexible.assembly.springs:
        if element.connections and len(element.terms) == 1:
            by_coordinate[0]['held'][element.terms[0][0]] = 1
    place = [element.name for element in flexible.assembly.springs].index('y_rotate_drive')
    by_coordinate[0]['spring_held'][place] = by_coordinate[0]['cable_held'][0] = 1
    assert axes_after(flexible, 500, by_coordinate).tobytes() == found[0].tobytes()


def test_let_go_while_it_runs_a_held_machine_is_flexible_from_there() -> None:
    machine = load_machine('flexible', 'held')
    flexible = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {}, holding=True)
    record = np.zeros((500, len(machine.coordinates)))
    run(state, parameters, 500, np.array([60.0, 60.0, 20.0]), record)
    parameters[0]['spring_held'] = parameters[0]['cable_held'] = 0
    other, free = state.copy(), flexible.parameters()
    for name in ('spring_stiffness', 'spring_damping', 'spring_rest'):
        free[0][name] = parameters[0][name]
    for each, own in ((state, parameters), (other, free)):
        run(each, own, 500, np.array([60.0, 60.0, 20.0]), record)
    assert state[0]['position'].tobytes() == other[0]['position'].tobytes()
    assert state[0]['position'][machine.coordinates.index('payload_bearing_z')] != 0.0


def test_energy_balances_with_everything_held() -> None:
    machine = load_machine('flexible', 'held')
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {}, holding=True)
    before = audit.books(machine, state, parameters)
    record = np.zeros((18000, len(machine.coordinates)))
    run(state, parameters, 18000, np.array([60.0, 60.0, 20.0]), record)
    after = audit.books(machine, state, parameters)
    supplied = sum(after.supplied.values())
    assert supplied > 100.0
    assert abs(audit.imbalance(before, after)) < 1e-6 * supplied
    losses = audit.loss_powers(before, after, 1.0)
    for friction in machine.description.frictions:
        assert losses[f'{friction} dry friction'] > 0.0


@pytest.mark.parametrize('positions', [{}, {'y_linear': 0.1, 'x_rotate': 0.7, 'y_rotate': 2.0}])
def test_statics_of_held_is_that_of_rigid(positions: dict[str, float]) -> None:
    held, rigid = load_machine('flexible', 'held'), load_machine('flexible', 'rigid')
    forces = [
        statics.holding_forces(machine, machine.parameters(), positions)
        for machine in (held, rigid)
    ]
    assert forces[0] == pytest.approx(forces[1], rel=1e-9, abs=1e-9)
    state = held.initial_state(held.parameters(), positions, holding=True)
    joints = [name for name in held.coordinates if 'bearing' in name or 'shaft' in name]
    assert not state[0]['position'][[held.coordinates.index(name) for name in joints]].any()


def test_modes_of_held_are_those_of_rigid() -> None:
    names = ['cable', 'payload_bearing_z', 'x_rotate_bearing_y', 'belt', 'gearbox']
    flexible = load_machine('flexible')
    held, rigid = (
        modes.coupled_modes(load_machine('flexible', switches(flexible, names, state)))
        for state in ('held', 'rigid')
    )
    assert [mode.frequency_hz for mode in held] == pytest.approx(
        [mode.frequency_hz for mode in rigid], rel=1e-9
    )
    assert [mode.damping_ratio for mode in held] == pytest.approx(
        [mode.damping_ratio for mode in rigid], rel=1e-6
    )


def test_acceleration_of_held_is_that_of_rigid() -> None:
    seed = np.random.SeedSequence().entropy
    print('seed', seed)
    random = np.random.default_rng(seed)
    held, rigid = load_machine('flexible', 'held'), load_machine('flexible', 'rigid')
    axes = dict(zip(AXES, random.uniform(-0.3, 0.3, 3), strict=True))
    found = []
    speeds, pushes = random.normal(0.0, 1.0, 3), random.normal(0.0, 30.0, 3)
    for machine in (held, rigid):
        parameters = machine.parameters()
        state = machine.initial_state(parameters, axes)
        force = np.zeros(len(machine.coordinates))
        result = np.zeros(len(machine.coordinates))
        for axis, speed, push in zip(AXES, speeds, pushes, strict=True):
            force[machine.coordinates.index(axis)] = push
            state[0]['velocity'][machine.coordinates.index(axis)] = speed
        if machine is held:
            ratio = machine.description.transmissions['y_rotate_drive'].ratio
            for follower, value in (
                ('counterweight', -speeds[0]), ('y_rotate_motor', speeds[2] / ratio),
            ):  # fmt: skip
                state[0]['velocity'][machine.coordinates.index(follower)] = value
        plant.acceleration(state, parameters, force, result)
        found.append([result[machine.coordinates.index(axis)] for axis in AXES])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_unknown_state_is_refused() -> None:
    with pytest.raises(UserError, match=r'cable.*held, rigid or flexible'):
        load_machine('flexible', {'cable': 'loose'})
