# SPDX-License-Identifier: Apache-2.0
"""The compiled multibody dynamics against MuJoCo, textbook motion and energy."""

from __future__ import annotations

import math

import numpy as np
import pinocchio_twin
import plant_machines as machines
import pytest

from waferbot_plant import modes, plant, statics
from waferbot_plant.assembly import home_mass_matrix_and_weight
from waferbot_plant.plant import load_machine


@pytest.mark.parametrize('model', ['rigid', 'flexible'])
def test_acceleration_agrees_with_mujoco(model: str) -> None:
    """1000 random states and forces, masses and springs included; another engine, same numbers."""
    seed = 20240501
    print('seed', seed)
    random = np.random.default_rng(seed)
    machine = load_machine(model)
    twin = machines.MujocoTwin(machine)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    size = len(machine.coordinates)
    result = np.zeros(size)
    worst = 0.0
    for _ in range(1000):
        scale = np.array(
            [
                1.0 if name in machines.axes_and_motors(machine) else 0.01
                for name in machine.coordinates
            ]
        )
        position = state[0]['position'][:size] = scale * random.uniform(-1.0, 1.0, size)
        velocity = state[0]['velocity'][:size] = scale * random.uniform(-3.0, 3.0, size)
        force = random.uniform(-50.0, 50.0, size)
        plant.acceleration(state, parameters, force, result)
        expected = twin.acceleration(position, velocity, force)
        worst = max(worst, np.abs(result - expected).max() / np.abs(expected).max())
    print('worst relative difference', worst)
    assert worst < 1e-9


@pytest.mark.parametrize(
    'model', ['rigid', pytest.param('simplified', marks=pytest.mark.slow), 'flexible']
)
def test_acceleration_agrees_with_pinocchio(model: str) -> None:
    """1000 random states and forces at a third engine; springs and dampers added by matrices."""
    seed = 20240502
    print('seed', seed)
    random = np.random.default_rng(seed)
    machine = load_machine(model)
    twin = pinocchio_twin.PinocchioTwin(machine)
    stiffness, damping = statics.elastic_stiffness(machine), modes.damping_matrix(machine)
    rest = np.zeros(len(machine.coordinates))
    for element in (*machine.assembly.springs, *machine.assembly.cables):
        for place, ratio in element.terms:
            rest[place] += element.stiffness * element.rest * ratio
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    size = len(machine.coordinates)
    free = machines.axes_and_motors(machine)
    scale = np.array([1.0 if name in free else 1e-4 for name in machine.coordinates])
    if 'counterweight' in machine.coordinates:  # keep the cable taut: the matrices take it so
        for name in ('y_linear', 'counterweight'):
            scale[machine.coordinates.index(name)] = 1e-5
    result = np.zeros(size)
    worst = 0.0
    for _ in range(1000):
        position = scale * random.uniform(-1.0, 1.0, size)
        velocity = scale * random.uniform(-3.0, 3.0, size)
        state[0]['position'][: len(position)], state[0]['velocity'][: len(velocity)] = (
            position,
            velocity,
        )
        force = random.uniform(-50.0, 50.0, size)
        plant.acceleration(state, parameters, force, result)
        elastic = rest - stiffness @ position - damping @ velocity
        expected = twin.acceleration(position, velocity, force + elastic)
        worst = max(worst, np.abs(result - expected).max() / np.abs(expected).max())
    print('worst relative difference', worst)
    assert worst < 1e-9


@pytest.mark.slow
def test_any_tree_agrees_with_mujoco() -> None:
    """Forty random trees of six freedoms: branches, slides and hinges in any direction."""
    seed = 99
    print('seed', seed)
    random = np.random.default_rng(seed)
    worst = 0.0
    result = np.zeros(6)
    for _ in range(40):
        machine = load_machine(machines.write(machines.random_tree(random, 6)))
        twin = machines.MujocoTwin(machine)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(5):
            position = state[0]['position'][:6] = random.uniform(-2.0, 2.0, 6)
            velocity = state[0]['velocity'][:6] = random.uniform(-3.0, 3.0, 6)
            force = random.uniform(-20.0, 20.0, 6)
            plant.acceleration(state, parameters, force, result)
            expected = twin.acceleration(position, velocity, force)
            worst = max(worst, np.abs(result - expected).max() / np.abs(expected).max())
    print('worst relative difference', worst)
    assert worst < 1e-9


def test_mass_matrix_at_home_is_that_of_the_jacobians() -> None:
    """The compiled composite-body algorithm against M = sum of J' M J in plain NumPy."""
    machine = load_machine('rigid')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    size = len(machine.coordinates)
    matrix = np.zeros((size, size))
    plant.mass_matrix(state, parameters, matrix)
    assembly = machine.assembly
    expected, weight = home_mass_matrix_and_weight(
        list(assembly.links), assembly.placing, size, machine.description.gravity
    )
    expected[np.diag_indices(size)] += assembly.rotor_inertia
    assert matrix == pytest.approx(expected, rel=1e-12, abs=1e-12)
    plant.acceleration(state, parameters, np.zeros(size), result := np.zeros(size))
    assert matrix @ result == pytest.approx(weight, rel=1e-11, abs=1e-11)


def test_moving_mass_of_y_linear_by_hand() -> None:
    """Payload and counterweight, 40 kg each, move together."""
    machine = load_machine('rigid')
    parameters = machine.parameters()
    matrix = np.zeros((3, 3))
    plant.mass_matrix(machine.initial_state(parameters), parameters, matrix)
    payload = sum(
        body.mass for name, body in machine.description.bodies.items() if name != 'counterweight'
    )
    counterweight = machine.description.bodies['counterweight'].mass
    assert matrix[0, 0] == pytest.approx(payload + counterweight, rel=1e-14)


def test_falling_mass() -> None:
    """Without drive a mass on a slide falls by g t^2 / 2; the midpoint rule is exact for that."""
    machine = load_machine(machines.write_single_mass())
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    ticks = 1800
    for _ in range(ticks):
        plant.advance(state, parameters, np.zeros(9))
    time = ticks / 18000
    assert state[0]['position'][0] == pytest.approx(-0.5 * 9.81 * time**2, rel=1e-11)
    assert state[0]['velocity'][0] == pytest.approx(-9.81 * time, rel=1e-11)


def test_pendulum_period() -> None:
    """A physical pendulum swings with the period of the complete elliptic integral."""
    from scipy.special import ellipk

    machine = load_machine(machines.write_pendulum())
    body = machine.description.bodies['bob']
    length = -body.centre_of_gravity[1]
    inertia = body.inertia[2, 2] + body.mass * length**2
    amplitude = 1.2
    period = 4.0 * math.sqrt(inertia / (body.mass * 9.81 * length))
    period *= float(ellipk(math.sin(amplitude / 2) ** 2))
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['position'][0] = amplitude
    crossings = []
    voltage = np.zeros(9)
    for tick in range(int(2.2 * period * 18000)):
        before = state[0]['position'][0]
        plant.advance(state, parameters, voltage)
        after = state[0]['position'][0]
        if before > 0.0 >= after:
            crossings.append((tick + before / (before - after)) / 18000)
    assert crossings[1] - crossings[0] == pytest.approx(period, rel=1e-7)


def test_energy_drifts_by_the_square_of_the_step() -> None:
    """Free tumbling of the rigid machine: the drift stays bounded and falls with order two."""
    drifts = []
    for substeps in (1, 2, 4):
        machine = load_machine('rigid', overlays=[{'substeps': substeps}])
        parameters = machine.parameters()
        machines.remove_losses(parameters)
        state = machine.initial_state(parameters)
        state[0]['terminals_open'][:] = 1
        state[0]['velocity'][:3] = 0.1, 4.0, 7.0
        stored = np.zeros(4)
        plant.energy(state, parameters, stored)
        start = stored.sum()
        voltage = np.zeros(9)
        drift = 0.0
        for tick in range(36000):
            plant.advance(state, parameters, voltage)
            if tick % 100 == 0:
                plant.energy(state, parameters, stored)
                drift = max(drift, abs(stored.sum() - start))
        drifts.append(drift)
    print('drift, J', drifts)
    assert drifts[0] < 1e-4
    assert drifts[0] / drifts[1] == pytest.approx(4.0, rel=0.15)
    assert drifts[1] / drifts[2] == pytest.approx(4.0, rel=0.15)
