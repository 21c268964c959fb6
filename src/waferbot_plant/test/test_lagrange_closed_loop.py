# SPDX-License-Identifier: Apache-2.0
"""The mathematical plant under voltages: beside the multibody plant, its energy, what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, plant
from waferbot_plant.plant import Machine, load_machine

TICKS = 900


def driven(machine: Machine, open_from: int = TICKS) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (ticks, 3) and line currents (ticks, 6) under slow three-phase voltages."""
    parameters = machine.parameters()
    state = machine.resting_state(parameters)
    lines = 2.0 * np.pi / 3.0 * np.arange(3)
    counts, current = np.zeros(4, np.int64), np.zeros(6)
    positions, currents = [], []
    for tick in range(TICKS):
        voltage = np.concatenate(
            [amplitude * np.sin(2e-3 * tick - lines) for amplitude in (60.0, 50.0, 6.0)]
        )
        state[0]['terminals_open'] = tick >= open_from
        plant.advance(state, parameters, voltage)
        plant.measure(state, parameters, tick, counts, current)
        positions.append(state[0]['position'][:3].copy())
        currents.append(current.copy())
    return np.array(positions), np.array(currents)


@pytest.mark.parametrize('open_from', [TICKS, 300])
def test_both_plants_come_to_the_same_as_steps_get_shorter(open_from: int) -> None:
    """The multibody plant is of second order: a quarter of the step leaves a sixteenth of the error."""
    mathematical, _ = driven(load_machine('mathematical'), open_from)
    scale = np.ptp(mathematical, axis=0)
    errors = []
    for substeps in (1, 4):
        multibody, _ = driven(load_machine('rigid', overlays=[{'substeps': substeps}]), open_from)
        errors.append(np.abs(multibody - mathematical).max(axis=0) / scale)
    print(errors)
    assert np.all(errors[0] < 1e-3)
    assert np.all(errors[1] < errors[0] / 12.0)


def test_own_error_is_far_below(monkeypatch: pytest.MonkeyPatch) -> None:
    once, currents = driven(load_machine('mathematical'))
    often, often_currents = driven(load_machine('mathematical', overlays=[{'substeps': 4}]))
    assert np.abs(once - often).max() < 1e-9 * np.ptp(once)
    assert np.abs(currents - often_currents).max() < 1e-7 * np.ptp(currents)


def test_open_terminals_carry_nothing() -> None:
    positions, currents = driven(load_machine('mathematical'), 300)
    assert np.abs(currents[:299]).max() > 1.0
    assert np.abs(currents[300:]).max() < 1e-12
    assert np.ptp(positions[300:], axis=0).all()  # it coasts on


def test_energy_is_accounted_for() -> None:
    machine = load_machine('mathematical')
    parameters = machine.parameters()
    state = machine.resting_state(parameters)
    state[0]['external_force'][:3] = 30.0, 1.0, -0.5
    before = audit.books(machine, state, parameters)
    voltage = np.tile([20.0, -12.0, -8.0], 3)
    for _ in range(TICKS):
        plant.advance(state, parameters, voltage)
    after = audit.books(machine, state, parameters)
    supplied = sum(abs(value) for value in after.supplied.values())
    assert supplied > 1.0
    assert abs(audit.imbalance(before, after)) < 1e-8 * supplied


def test_a_wrong_mass_shows() -> None:
    machine = load_machine('mathematical')
    sound, _ = driven(machine)

    class Wrong(Machine):
        def parameters(self) -> Any:
            parameters = super().parameters()
            parameters[0]['lagrange'][0]['carriage_mass'] *= 1.01
            return parameters

    wrong, _ = driven(Wrong(machine.description, machine.assembly, machine.timing))
    assert np.abs(wrong[:, 0] - sound[:, 0]).max() > 1e-4 * np.ptp(sound[:, 0])


@pytest.mark.parametrize(
    ('name', 'overlay', 'what'),
    [
        ('flexible', {}, 'connections that give, frictions, dampers'),
        ('rigid', {'motors': {'y_linear': {'saturation_current_a': 30.0}}}, 'imperfect motors'),
        (
            'rigid',
            {'motors': {'x_rotate': {'heating': {'state': 'warming'}}}},
            'motors that warm up',
        ),
        ('planar_two_link_arm', {}, 'formulation lagrange is for the rigid'),
    ],
)
def test_what_the_equations_leave_out_is_refused(name: str, overlay: dict, what: str) -> None:
    machine = load_machine(name, overlays=[{'formulation': 'lagrange', **overlay}])
    with pytest.raises(UserError, match=what):
        machine.parameters()
