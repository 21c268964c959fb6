# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics against the forward dynamics, and against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_plant import plant
from waferbot_plant.assembly import assemble
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_plant.plant import Machine, load_machine


def test_its_forces_make_the_acceleration_that_was_asked_for():
    """On the rigid machine, without dry friction, at random motions of all axes."""
    description = replace(load_machine('as_built').description, frictions={})
    dynamics = InverseDynamics(description)
    machine = dynamics.machine
    random = np.random.default_rng(3)
    position, velocity, acceleration = random.normal(0.0, [[0.1, 0.8, 1.0]], (3, 40, 3))
    forces = dynamics.forces(position, velocity, acceleration)
    parameters = machine.parameters()
    size = len(machine.coordinates)
    rows = [
        machine.assembly.placing[coordinate] for coordinate in machine.description.axes.values()
    ]
    for sample in range(40):
        state = machine.initial_state(parameters)
        for (row, ratio), place in zip(rows, range(3), strict=True):
            state[0]['position'][row] = position[sample, place] / ratio
            state[0]['velocity'][row] = velocity[sample, place] / ratio
        pushed = np.zeros(size)
        for axis, force in zip(dynamics.axes, forces[sample], strict=True):
            row, ratio = machine.assembly.placing[machine.description.motors[axis].coordinate]
            pushed[row] += ratio * force
        found = np.zeros(size)
        plant.acceleration(state, parameters, pushed, found)
        for (row, ratio), place in zip(rows, range(3), strict=True):
            assert found[row] * ratio == pytest.approx(acceleration[sample, place], rel=1e-9)


def test_a_sliding_mass_needs_its_inertia_and_its_friction():
    """Example `single_mass`: m a + friction, at a constant speed friction alone, at rest nothing."""
    description = load_machine('single_mass').description
    dynamics = InverseDynamics(description)
    (axis,) = dynamics.axes
    (body,) = description.bodies.values()
    motion = np.array([[0.0], [0.0], [0.0], [0.0]])
    velocity = np.array([[0.0], [0.2], [-0.2], [0.0]])
    acceleration = np.array([[0.0], [0.0], [0.0], [3.0]])
    force = dynamics.forces(motion, velocity, acceleration)[:, 0]
    resistance = sum(
        np.interp(0.2, friction.speeds, friction.resistances)
        for friction in description.frictions.values()
    ) + sum(0.2 * damper.damping for damper in description.dampers.values())
    rest = force[0]
    assert force[1] - rest == pytest.approx(resistance, rel=1e-12)
    assert force[2] - rest == pytest.approx(-resistance, rel=1e-12)
    assert force[3] - rest == pytest.approx(3.0 * body.mass, rel=1e-9)
    assert axis in description.axes


@pytest.mark.parametrize(
    ('acceleration', 'speed', 'expected'),
    [
        (0.0, 0.2, 40.0 / 0.9),  # the motor lifts
        (0.0, -0.2, 40.0 * 0.8),  # the weight drives it down
        (-6.0, 0.2, -20.0 * 0.8),  # it brakes what goes up
        (-6.0, -0.2, -20.0 / 0.9),  # and pushes it down
    ],
)
def test_what_is_lost_on_the_way_to_the_load_is_in_the_force(acceleration, speed, expected):
    """A weight of 40 N, 10 kg, by a gear with efficiencies of 0.9 and, driven by its load, 0.8."""
    gear = {
        'coordinate': 'travel', 'speed_m_s': [0.0], 'force_n': [0.0],
        'per_motor_force': 0.1, 'per_motor_force_back': 0.25,
    }  # fmt: skip
    weight = {'kind': 'constant', 'coordinate': 'travel', 'force_n': -40.0}
    machine = load_machine(
        'single_mass',
        overlays=[{'frictions': {'guide': None, 'gear': gear}, 'disturbances': {'w': weight}}],
    )
    motion = [np.array([[one]]) for one in (0.01, speed, acceleration)]
    (force,) = InverseDynamics(machine.description).forces(*motion).ravel()
    assert force == pytest.approx(expected, rel=1e-9)


def test_the_current_is_what_an_imperfect_motor_needs():
    """With ripple, the current at a position makes the force that was asked for."""
    machine = load_machine(
        'as_built',
        overlays=[
            {'motors': {'x_rotate': {'ripple': [{'order': 6, 'cosine': 0.1, 'sine': 0.05}]}}}
        ],
    )
    dynamics = InverseDynamics(machine.description)
    at = np.linspace(0.0, 0.3, 50)
    force = np.full(50, 12.0)
    current = dynamics.current_of('x_rotate', force, at)
    motor = machine.description.motors['x_rotate']
    angle = 6.0 * motor.electrical_gain * at
    constant = 12.0 / dynamics.current_of('y_linear', np.array([12.0]), np.zeros(1))
    assert constant > 0.0
    expected = 1.0 + 0.1 * np.cos(angle) + 0.05 * np.sin(angle)
    np.testing.assert_allclose(current[0] * expected[0] / (current * expected), 1.0, rtol=2e-2)
    assert np.ptp(current) > 0.1 * current.mean()


def test_connections_that_give_are_rigid_in_it():
    one = InverseDynamics(load_machine('flexible').description)
    assert len(one.machine.coordinates) == len(
        Machine(
            (rigid := load_machine('flexible', switches='rigid')).description,
            assemble(rigid.description),
            rigid.timing,
        ).coordinates
    )


def test_an_axis_whose_output_is_locked_has_none():
    with pytest.raises(UserError, match=r'x_rotate drives is locked.*no inverse dynamics'):
        InverseDynamics(load_machine('locked_cycloidal_drive').description)
