# SPDX-License-Identifier: Apache-2.0
"""Gearbox, belt, lip seal and shaft bearings, equations (5.32) to (5.42)."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh
from scipy.spatial import ConvexHull

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts import belt, gearbox, lip_seal, y_rotate_bearings
from waferbot_plant.parts.belt import Belt
from waferbot_plant.parts.gearbox import Gearbox
from waferbot_plant.parts.lip_seal import LipSeal
from waferbot_plant.parts.y_rotate_bearings import YRotateBearings

BELT = Belt(
    specific_stiffness_n_per_m=9.0e6,
    width_m=0.010,
    length_m=0.8,
    tooth_pitch_m=0.005,
    drive_pulley_teeth=22,
    driven_pulley_teeth=66,
    span_pretension_n=120.0,
    loss_factor=0.01,
)
GEARBOX = Gearbox(
    ratio=16.0,
    torsional_rigidity_nm_per_arcmin=0.6,
    no_load_speed_rpm=(1000.0, 3000.0),
    no_load_torque_nm=(0.02, 0.036),
    input_inertia_kg_m2=1.3e-5,
)


def test_rigidity_in_radians():
    """0.6 Nm turn the output by one arc minute, a 21600th of a turn."""
    arcmin = 2.0 * math.pi / 21600.0
    assert gearbox.torsional_stiffness_nm_per_rad(GEARBOX) == pytest.approx(0.6 / arcmin)


def test_no_load_friction_passes_through_both_points():
    friction = gearbox.no_load_friction(GEARBOX)
    assert friction.coulomb_nm == pytest.approx(0.012)
    for speed, torque in ((1000.0, 0.02), (3000.0, 0.036)):
        assert friction.torque_nm(speed * 2.0 * math.pi / 60.0) == pytest.approx(torque)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'ratio': 0.0}, 'ratio is 0.0'),
        ({'torsional_rigidity_nm_per_arcmin': -1.0}, 'torsional_rigidity'),
        ({'no_load_torque_nm': (0.036, 0.02)}, 'falls with'),
        ({'no_load_torque_nm': (0.01, 0.036)}, 'negative at rest'),
        ({'no_load_speed_rpm': (3000.0, 1000.0)}, 'must rise'),
        ({'no_load_speed_rpm': (3000.0,)}, 'two of each'),
    ],
)
def test_bad_gearboxes_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(GEARBOX, **change)


def test_axial_stiffness_by_hand():
    """Two spans of 0.4 m, each 9e6*0.01/0.4 = 225 kN/m."""
    assert belt.axial_stiffness_n_per_m(BELT) == pytest.approx(450e3, rel=1e-12)


def test_belt_length_is_that_of_a_rope_drawn_tight():
    """Convex hull of the two pitch circles, sampled densely: its perimeter is the belt."""
    distance = belt.centre_distance_m(BELT)
    angles = np.linspace(0.0, 2.0 * math.pi, 40000, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.vstack(
        [
            BELT.drive_pulley_radius_m * circle,
            BELT.driven_pulley_radius_m * circle + [distance, 0.0],
        ]
    )
    assert ConvexHull(points).area == pytest.approx(0.8, rel=1e-7)


def sine_of_lean():
    """Return the sine of the angle between a span and the line of centres."""
    difference = BELT.driven_pulley_radius_m - BELT.drive_pulley_radius_m
    return difference / belt.centre_distance_m(BELT)


def test_teeth_in_mesh_fill_the_angle_of_wrap():
    """The wraps of both pulleys make a full turn; the small one's from the lean of the spans."""
    small, large = belt.teeth_in_mesh(BELT, driven=False), belt.teeth_in_mesh(BELT, driven=True)
    assert small / 22 + large / 66 == pytest.approx(1.0, rel=1e-12)
    sine = sine_of_lean()
    assert small == pytest.approx(22 * (math.pi - 2 * math.asin(sine)) / (2 * math.pi), rel=1e-12)
    equal = dataclasses.replace(BELT, drive_pulley_teeth=40, driven_pulley_teeth=40)
    assert belt.teeth_in_mesh(equal, driven=True) == pytest.approx(20.0, rel=1e-12)


def test_mesh_stiffness_and_shaft_force():
    assert belt.mesh_stiffness_n_per_m(6.0, 2.0e5) == pytest.approx(1.2e6)
    sine = sine_of_lean()
    expected = 240.0 * math.sqrt(1.0 - sine**2)
    assert belt.shaft_force_n(BELT) == pytest.approx(expected, rel=1e-12)


def test_teeth_that_give_are_a_chain_of_three_springs():
    """One newton on the rim of a pulley, the other held: solved for the ends of the cords."""
    soft = dataclasses.replace(BELT, tooth_stiffness_n_per_m=2.0e5, virtual_teeth_share=0.8)
    small, large = (0.8 * belt.teeth_in_mesh(BELT, driven) * 2.0e5 for driven in (False, True))
    cords = belt.axial_stiffness_n_per_m(BELT)
    matrix = np.array(
        [[small, -small, 0.0], [-small, small + cords, -cords], [0.0, -cords, cords + large]]
    )
    moved = np.linalg.solve(matrix, [1.0, 0.0, 0.0])[0]
    assert belt.stiffness_n_per_m(soft) == pytest.approx(1.0 / moved, rel=1e-12)
    assert belt.drive_stiffness_nm_per_rad(soft, 2000.0) < belt.drive_stiffness_nm_per_rad(
        BELT, 2000.0
    )


def test_teeth_without_a_stiffness_do_not_give():
    assert belt.stiffness_n_per_m(BELT) == belt.axial_stiffness_n_per_m(BELT)
    hard = dataclasses.replace(BELT, tooth_stiffness_n_per_m=1e15)
    assert belt.stiffness_n_per_m(hard) == pytest.approx(450e3, rel=1e-8)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'tooth_stiffness_n_per_m': 0.0}, 'tooth_stiffness'),
        ({'tooth_stiffness_n_per_m': 1e5, 'virtual_teeth_share': 1.2}, 'at most 1'),
        ({'virtual_teeth_share': 0.8}, 'give both'),
    ],
)
def test_bad_teeth_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(BELT, **change)


@given(st.floats(1e-4, 1.0), st.floats(1e-4, 1.0), st.floats(0.005, 0.1), st.floats(0.005, 0.1))
def test_belt_frequency_is_the_eigenvalue_of_two_pulleys(first, second, drive, driven):
    """Equation (5.36): belt stretch r1 a1 - r2 a2, kinetic energies of both inertias."""
    stretch = np.array([drive, -driven])
    values = eigh(4.5e5 * np.outer(stretch, stretch), np.diag([first, second]), eigvals_only=True)
    found = belt.belt_frequency(4.5e5, first, second, drive, driven)
    assert found**2 == pytest.approx(values[1], rel=1e-8)


def test_drive_frequency_is_the_lowest_mode_of_motor_gearbox_belt_payload():
    """Three coordinates, the drive pulley nearly massless between gearbox and belt."""
    motor, pulley, payload, rigidity = 0.0128, 1e-9, 0.22, 2062.6
    matrix = rigidity * np.outer([1.0, -1.0, 0.0], [1.0, -1.0, 0.0])
    stretch = np.array([0.0, BELT.drive_pulley_radius_m, -BELT.driven_pulley_radius_m])
    matrix += belt.axial_stiffness_n_per_m(BELT) * np.outer(stretch, stretch)
    values = eigh(matrix, np.diag([motor, pulley, payload]), eigvals_only=True)
    found = belt.drive_frequency(BELT, rigidity, motor, payload)
    assert found**2 == pytest.approx(values[1], rel=1e-5)


def test_rigid_gearbox_leaves_equation_5_36():
    stiff = belt.drive_frequency(BELT, 1e12, 0.0128, 0.22)
    alone = belt.belt_frequency(
        belt.axial_stiffness_n_per_m(BELT),
        0.0128,
        0.22,
        BELT.drive_pulley_radius_m,
        BELT.driven_pulley_radius_m,
    )
    assert stiff == pytest.approx(alone, rel=1e-6)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'width_m': -0.01}, r'width_m is -0\.01'),
        ({'length_m': 0.3}, 'belt: length_m is 0.3; around pulleys of 22 and 66 teeth'),
        ({'drive_pulley_teeth': 22.5}, 'drive_pulley_teeth is 22.5'),
        ({'driven_pulley_teeth': 0}, 'driven_pulley_teeth is 0'),
    ],
)
def test_bad_belts_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(BELT, **change)


def test_lip_seal_drag_by_hand():
    assert lip_seal.drag_torque_nm(LipSeal(0.01, 0.4, 12.0)) == pytest.approx(0.048)
    with pytest.raises(UserError, match='shaft_radius_m'):
        LipSeal(0.0, 0.4, 12.0)


BEARINGS = YRotateBearings(
    duplex_to_centre_of_gravity_m=0.05,
    needle_to_centre_of_gravity_m=0.10,
    needle_to_belt_m=0.04,
    belt_angle_rad=0.4,
    duplex_friction_radius_m=0.018,
    needle_friction_radius_m=0.0115,
    duplex_friction_coefficient=0.0015,
    needle_friction_coefficient=0.0022,
)


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.0, 500.0), st.floats(-1.5, 1.5))
def test_loads_keep_the_shaft_in_balance(x, z, tension, angle):
    """Balance in space, needle bearing at the origin: forces across and moments about x and z."""
    bearings = dataclasses.replace(BEARINGS, belt_angle_rad=angle)
    found = y_rotate_bearings.static_loads(bearings, 9.5, x, z, tension)
    forces = {
        (x, 0.10, z): (0.0, -9.5 * 9.80665, 0.0),
        (0.0, 0.04, 0.0): (tension * math.sin(angle), 0.0, -tension * math.cos(angle)),
        (0.0, 0.15, 0.0): (-found.duplex_x_n, 0.0, -found.duplex_z_n),
        (0.0, 0.0, 0.0): (-found.needle_x_n, 9.5 * 9.80665, -found.needle_z_n),
    }
    force = sum(np.array(value) for value in forces.values())
    moment = sum(np.cross(place, value) for place, value in forces.items())
    assert force == pytest.approx(np.zeros(3), abs=1e-9)
    assert moment[[0, 2]] == pytest.approx(np.zeros(2), abs=1e-9)


def test_friction_torque_by_hand():
    found = y_rotate_bearings.static_loads(BEARINGS, 9.5, 0.0, 0.1034, 230.0)
    duplex = math.hypot(found.duplex_x_n, found.duplex_z_n)
    needle = math.hypot(found.needle_x_n, found.needle_z_n)
    expected = 0.0015 * duplex * 0.018 + 0.0022 * needle * 0.0115
    assert y_rotate_bearings.friction_torque_nm(BEARINGS, found) == pytest.approx(expected)
    with pytest.raises(UserError, match=r'duplex_to_centre_of_gravity_m is 0\.0'):
        dataclasses.replace(BEARINGS, duplex_to_centre_of_gravity_m=0.0)
