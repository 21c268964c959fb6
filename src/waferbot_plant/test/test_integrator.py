# SPDX-License-Identifier: Apache-2.0
"""The step as a whole: order, energy, stiffness limits, determinism."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest

from waferbot_lockstep.compiled import compiled
from waferbot_plant import audit, plant
from waferbot_plant.plant import advance, load_machine

MODELS = ['rigid', pytest.param('simplified', marks=pytest.mark.slow), 'flexible']


@compiled
def run(state, parameters, ticks, amplitude, record):
    """Advance under slow three-phase voltages; keep the position of every tick."""
    voltage = np.zeros(9)
    for tick in range(ticks):
        for terminal in range(9):
            motor = terminal // 3
            voltage[terminal] = amplitude[motor] * math.sin(
                1e-3 * (2 + motor) * tick - 2.0 * math.pi / 3.0 * (terminal % 3)
            )
        advance(state, parameters, voltage)
        for row in range(record.shape[1]):
            record[tick, row] = state[0]['position'][row]


def drive(model, ticks, amplitude=(8.0, 8.0, 3.0), **more):
    """Return (machine, parameters, state, record) of a driven run from a held start."""
    machine = load_machine(model, **more)
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {}, holding=True)
    record = np.zeros((ticks, len(machine.coordinates)))
    run(state, parameters, ticks, np.array(amplitude), record)
    return machine, parameters, state, record


@pytest.mark.parametrize('model', MODELS)
def test_energy_supplied_is_energy_stored_and_lost(model: str) -> None:
    """All losses on, driven hard for a second: the books balance to 1e-6 (here to 1e-8)."""
    machine, parameters, state, _ = drive(model, 18000, (60.0, 60.0, 20.0))
    first = machine.initial_state(parameters, {}, holding=True)
    before = audit.books(machine, first, parameters)
    after = audit.books(machine, state, parameters)
    supplied = sum(after.supplied.values())
    balance = audit.imbalance(before, after)
    print('balance over energy supplied', balance / supplied)
    assert supplied > 100.0
    assert abs(balance) < 1e-8 * supplied
    powers = audit.loss_powers(before, after, 1.0)
    assert min(powers.values()) > -1e-12
    assert powers['x_rotate copper'] > 1.0
    assert sum(powers.values()) == pytest.approx(supplied, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize('model', MODELS)
def test_energy_is_bounded_without_losses(model: str) -> None:
    """Ten seconds of free motion and vibration, nothing dissipated: bounded drift, order two."""
    drifts = []
    for substeps in (1, 2):
        machine = load_machine(model, overlays=[{'substeps': substeps}])
        parameters = machine.parameters()
        machines.remove_losses(parameters)
        state = machine.initial_state(parameters)
        state[0]['terminals_open'][:] = 1
        for name, speed in {'y_linear': 0.05, 'x_rotate': 2.0, 'y_rotate': 3.0}.items():
            state[0]['velocity'][machine.coordinates.index(name)] = speed
        if 'y_rotate_motor' in machine.coordinates:
            state[0]['velocity'][machine.coordinates.index('y_rotate_motor')] = 48 * 3.0
        stored = np.zeros(4)
        plant.energy(state, parameters, stored)
        start, drift = stored.sum(), []
        record = np.zeros((18000, len(machine.coordinates)))
        for _ in range(10):
            run(state, parameters, 18000, np.zeros(3), record)
            plant.energy(state, parameters, stored)
            drift.append(abs(stored.sum() - start))
        drifts.append(max(drift))
    print('drift over 10 s, J', drifts)
    assert drifts[0] < 2e-4
    assert drifts[1] < 0.5 * drifts[0]


def test_second_order_with_motors_springs_and_damping() -> None:
    """Halving the step quarters the difference to a fine solution; windings included."""
    ends = []
    for substeps in (8, 16, 32, 256):
        machine = load_machine('flexible', overlays=[{'substeps': substeps}])
        parameters = machine.parameters()
        parameters[0]['friction_resistance'] = 0.0
        state = machine.initial_state(parameters, {}, holding=True)
        record = np.zeros((300, len(machine.coordinates)))
        run(state, parameters, 300, np.array([8.0, 8.0, 3.0]), record)
        ends.append(np.concatenate([state[0]['position'], state[0]['winding_current'].ravel()]))
    scale = np.abs(ends[-1]) + 1e-9
    errors = [float((np.abs(end - ends[-1]) / scale).max()) for end in ends[:-1]]
    print('errors', errors)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_same_run_twice_is_the_same_to_the_last_bit() -> None:
    first = drive('flexible', 2000)
    second = drive('flexible', 2000)
    assert first[3].tobytes() == second[3].tobytes()
    assert first[2].tobytes() == second[2].tobytes()


def test_call_by_call_and_in_a_compiled_loop_are_the_same_to_the_last_bit() -> None:
    machine, parameters, state, _ = drive('flexible', 500)
    other = machine.initial_state(parameters, {}, holding=True)
    voltage = np.zeros(9)
    for tick in range(500):
        for terminal in range(9):
            motor = terminal // 3
            voltage[terminal] = (8.0, 8.0, 3.0)[motor] * math.sin(
                1e-3 * (2 + motor) * tick - 2.0 * math.pi / 3.0 * (terminal % 3)
            )
        plant.advance(other, parameters, voltage)
    assert state.tobytes() == other.tobytes()


def test_flexible_tends_to_rigid_as_it_stiffens() -> None:
    """
    A thousand and a million times stiffer, the axes move like those of the rigid model.

    Without friction, which the rigid model does not have.
    """
    names = ('y_linear', 'x_rotate', 'y_rotate')
    rigid, _, _, expected = drive('rigid', 900)
    expected = expected[:, [rigid.coordinates.index(name) for name in names]]
    differences = []
    for factor in (1.0, 1e3, 1e6):
        machine = load_machine('flexible')
        parameters = machine.parameters()
        for kind in ('spring', 'cable'):
            parameters[0][f'{kind}_stiffness'] *= factor
            parameters[0][f'{kind}_rest'] /= factor
        for place, element in enumerate(machine.assembly.springs):
            parameters[0]['spring_damping'][place] *= (
                math.sqrt(factor) if element.connections else 0.0
            )
        parameters[0]['cable_damping'] *= math.sqrt(factor)
        parameters[0]['friction_resistance'] = 0.0
        state = machine.initial_state(parameters)
        held = rigid.initial_state(rigid.parameters(), {}, holding=True)
        state[0]['winding_current'] = held[0]['winding_current']
        record = np.zeros((900, len(machine.coordinates)))
        run(state, parameters, 900, np.array([8.0, 8.0, 3.0]), record)
        moved = record[:, [machine.coordinates.index(name) for name in names]]
        differences.append(np.abs(moved - expected).max(axis=0) / np.abs(expected).max(axis=0))
    print('relative differences', differences)
    assert (differences[1] < 0.02 * np.maximum(differences[0], 1e-3)).all()
    assert (differences[2] < 1e-4).all()


def test_frozen_connection_is_a_removed_one() -> None:
    """Switching all connections rigid one by one gives the rigid model, but for its friction."""
    flexible = load_machine('flexible')
    switched = load_machine(
        'flexible',
        dict.fromkeys(flexible.description.connections, 'rigid'),
        overlays=[{'frictions': None}],
    )
    rigid = load_machine('rigid')
    assert switched.coordinates == rigid.coordinates
    assert switched.parameters().tobytes() == rigid.parameters().tobytes()
