# SPDX-License-Identifier: Apache-2.0
"""What the plant tells of its parts: forces of springs and cables against their elements, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_plant import loads, plant
from waferbot_plant.plant import load_machine


@pytest.fixture(scope='module')
def machine():
    return load_machine('flexible')


def noted(machine, state, parameters):
    borne, row = loads.begin(3), np.zeros(loads.width(3))
    loads.take(state, parameters, borne, row)
    return loads.Loads.of_rows(np.array([0]), row[np.newaxis])


def test_forces_are_those_of_the_elements(machine) -> None:
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    random = np.random.default_rng(3)
    size = len(machine.coordinates)
    position, velocity = random.normal(0.0, 1e-5, size), random.normal(0.0, 1e-4, size)
    state[0]['position'][:size], state[0]['velocity'][:size] = position, velocity
    found = noted(machine, state, parameters)
    for place, element in enumerate(machine.assembly.springs):
        e = sum(ratio * position[row] for row, ratio in element.terms) - element.rest
        rate = sum(ratio * velocity[row] for row, ratio in element.terms)
        force = element.stiffness * e + element.damping * rate
        assert found.spring_least[0, place] == pytest.approx(force, rel=1e-12)
        assert found.spring_most[0, place] == found.spring_least[0, place]
    assert not found.spring_least[0, len(machine.assembly.springs) :].any()
    (cable,) = machine.assembly.cables
    e = sum(ratio * position[row] for row, ratio in cable.terms) - cable.rest
    rate = sum(ratio * velocity[row] for row, ratio in cable.terms)
    tension = cable.stiffness * e + cable.damping * rate
    assert found.cable_least[0, 0] == pytest.approx(tension, rel=1e-12)
    assert found.temperature.tolist() == [[25.0, 25.0, 25.0]]


def test_cable_hangs_the_counterweight_and_goes_slack_with_what_carries_it(machine) -> None:
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    weight = 9.81 * machine.description.bodies['counterweight'].mass
    assert noted(machine, state, parameters).cable_least[0, 0] == pytest.approx(weight, rel=1e-9)
    row = machine.coordinates.index('counterweight')
    (cable,) = machine.assembly.cables
    ratio = dict(cable.terms)[row]
    state[0]['position'][row] -= 2.0 * weight / cable.stiffness / ratio
    assert noted(machine, state, parameters).cable_least[0, 0] == 0.0


def test_extremes_are_kept_until_they_are_taken(machine) -> None:
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    row = machine.coordinates.index('x_rotate_bearing_z')
    place = [element.name for element in machine.assembly.springs].index('x_rotate_bearing_z')
    borne, told = loads.begin(3), np.zeros((2, loads.width(3)))
    stiffness = machine.assembly.springs[place].stiffness
    for moment in (0.0, 7.0, -4.0, 1.0):
        state[0]['position'][row] = moment / stiffness
        loads.note(state, parameters, borne)
    loads.take(state, parameters, borne, told[0])
    loads.take(state, parameters, borne, told[1])
    found = loads.Loads.of_rows(np.array([0, 180]), told)
    static = -stiffness * machine.assembly.springs[place].rest
    assert found.spring_least[:, place] - static == pytest.approx([-4.0, 1.0])
    assert found.spring_most[:, place] - static == pytest.approx([7.0, 1.0])


def test_rows_that_nobody_wrote_are_left_out() -> None:
    rows = np.full((3, loads.width(3)), np.nan)
    rows[1] = 2.0
    found = loads.Loads.of_rows(np.array([0, 180, 360]), rows)
    assert found.tick.tolist() == [180]
    assert found.spring_most.shape == (1, loads.SPRINGS)


def test_looking_changes_nothing(machine) -> None:
    parameters = machine.parameters()
    one, other = machine.resting_state(parameters), machine.resting_state(parameters)
    borne, row = loads.begin(3), np.zeros(loads.width(3))
    voltage = np.linspace(-20.0, 20.0, 9)
    for tick in range(400):
        plant.advance(one, parameters, voltage)
        plant.advance(other, parameters, voltage)
        loads.note(other, parameters, borne)
        if tick % 180 == 0:
            loads.take(other, parameters, borne, row)
    assert one.tobytes() == other.tobytes()
