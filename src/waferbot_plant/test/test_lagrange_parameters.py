# SPDX-License-Identifier: Apache-2.0
"""Making and checking the parameter record of the mathematical plant."""

import dataclasses

import numpy as np
import pytest
from lagrange_machines import random_machine

from waferbot_lockstep.errors import UserError
from waferbot_plant import lagrange
from waferbot_plant.lagrange import RigidBody, derivation
from waferbot_plant.lagrange import parameters as module

SEED = 20250304


@pytest.fixture
def machine():
    return random_machine(np.random.default_rng(SEED))


def test_frames_at_the_zero_pose_are_those_of_the_derivation():
    kept = (module._FRAME_1, module._FRAME_2, module._FRAME_3)
    zero = {derivation.theta2: 0, derivation.theta3: 0}
    for transform, frame in zip(derivation.link_transforms(), kept, strict=True):
        assert np.array_equal(np.array(transform[:3, :3].subs(zero), dtype=float), frame)


def test_centres_and_tensors_by_hand(machine):
    """
    In base axes x, y, z: frame 2 reads [z, -y, x], frame 3 reads [z, x, y], from their origins.

    A tensor's element follows its two axes, with the sign of their product.
    """
    machine = dataclasses.replace(
        machine, x_rotate_at_m=(7.0, 0.2, 0.1), y_rotate_at_m=(0.3, 7.0, 0.15)
    )
    p = machine.parameters()[0]
    body = lagrange.combine([machine.x_rotate, machine.rotor])
    x, y, z = np.asarray(body.centre_of_gravity_m) - [0.3, 0.2, 0.1]
    np.testing.assert_allclose(p['x_rotate_centre_of_gravity'], [z, -y, x], rtol=1e-15)
    i = np.asarray(body.inertia_kg_m2)
    expected = [
        [i[2, 2], -i[2, 1], i[2, 0]],
        [-i[2, 1], i[1, 1], -i[1, 0]],
        [i[2, 0], -i[1, 0], i[0, 0]],
    ]
    np.testing.assert_allclose(p['x_rotate_inertia'], expected, rtol=1e-14)
    x, y, z = np.asarray(machine.y_rotate.centre_of_gravity_m) - [0.3, 0.2, 0.15]
    np.testing.assert_allclose(p['y_rotate_centre_of_gravity'], [z, x, y], rtol=1e-15)
    assert p['x_rotate_offset'] == 0.3
    assert p['y_rotate_offset'] == pytest.approx(0.05)


def test_combine_is_the_sum_over_particles():
    """Join bodies that are each a particle (a vanishing tensor): the textbook sums."""
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    masses, places = random.uniform(0.1, 3.0, 7), random.normal(0.0, 1.0, (7, 3))
    body = lagrange.combine(
        RigidBody(m, tuple(place), ((0.0,) * 3,) * 3)
        for m, place in zip(masses, places, strict=True)
    )
    centre = np.average(places, axis=0, weights=masses)
    second = np.cov(places.T, aweights=masses, ddof=0) * masses.sum()
    assert body.mass_kg == pytest.approx(masses.sum())
    np.testing.assert_allclose(body.centre_of_gravity_m, centre, rtol=1e-13)
    np.testing.assert_allclose(
        body.inertia_kg_m2, np.trace(second) * np.eye(3) - second, rtol=1e-12, atol=1e-13
    )


def test_combine_refuses_no_mass():
    with pytest.raises(UserError, match='must have mass'):
        lagrange.combine([])


def test_payload_is_on_the_y_rotate_axis_unless_said_otherwise(machine):
    record = lagrange.parameters_from_base_frame(
        carriage=machine.carriage,
        x_rotate=machine.x_rotate,
        y_rotate=machine.y_rotate,
        counterweight_mass_kg=1.0,
        drive=machine.drive,
        cable=machine.cable,
        y_rotate_at_m=(0.4, 0.0, 0.1),
    )
    frame = np.zeros(1, lagrange.PAYLOAD_FRAME)
    zero = np.zeros(3)
    lagrange.payload_frame(zero, zero, zero, record, frame)
    assert np.array_equal(frame[0]['position'], [0.4, 0.0, 0.1])


@pytest.mark.parametrize(
    ('field', 'value', 'message'),
    [
        ('carriage_mass', 0.0, 'carriage_mass: must be greater than zero'),
        ('x_rotate_mass', -1.0, 'x_rotate_mass: must be greater than zero'),
        ('y_rotate_mass', np.nan, 'y_rotate_mass: must be finite'),
        ('counterweight_mass', -1.0, 'counterweight_mass: must not be negative'),
        ('motor_inertia', -1e-6, 'motor_inertia: must not be negative'),
        ('gear_ratio', 0.0, 'gear_ratio: must be greater than zero'),
        ('drive_pulley_radius', 0.0, 'drive_pulley_radius: must be greater than zero'),
        ('driven_pulley_radius', -0.1, 'driven_pulley_radius: must be greater than zero'),
        ('gravity', np.inf, 'gravity: must be finite'),
        ('x_rotate_inertia', np.diag([1.0, 1.0, 3.0]), 'x_rotate_inertia: no body has these'),
        ('y_rotate_inertia', np.diag([1.0, 1.0, -0.1]), 'y_rotate_inertia: must be positive def'),
        (
            'y_rotate_inertia',
            np.eye(3) + np.eye(3, k=1) / 2,
            'y_rotate_inertia: must be symmetric',
        ),
    ],
)
def test_record_of_an_impossible_machine_is_refused(machine, field, value, message):
    record = machine.parameters()
    lagrange.check(record)
    record[0][field] = value
    with pytest.raises(UserError, match=message):
        lagrange.check(record)


def test_other_arrays_are_refused(machine):
    with pytest.raises(UserError, match=r'one lagrange\.PARAMETERS record'):
        lagrange.check(np.zeros(2, lagrange.PARAMETERS))
    with pytest.raises(UserError, match=r'one lagrange\.PARAMETERS record'):
        lagrange.check(np.zeros(1))


def test_shapes_are_checked_by_name(machine):
    with pytest.raises(UserError, match='x_rotate_at_m: must be three numbers'):
        dataclasses.replace(machine, x_rotate_at_m=(0.0, 0.0)).parameters()
    flat = dataclasses.replace(machine.y_rotate, inertia_kg_m2=(1.0, 1.0, 1.0))
    with pytest.raises(UserError, match='y_rotate: inertia_kg_m2: must be three rows'):
        dataclasses.replace(machine, y_rotate=flat).parameters()
