# SPDX-License-Identifier: Apache-2.0
"""Properties of the mathematical plant that any Lagrangian system has, and cases done by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lagrange_machines import random_machine, random_state
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from waferbot_plant import lagrange
from waferbot_plant.lagrange import (
    CableGeometry,
    RigidBody,
    YRotateDrive,
    generated,
    parameters_from_base_frame,
)

SEED = 20250303
STEP = 1e-30  # of the complex-step derivative: exact to rounding, no difference is taken

seeds = st.integers(0, 2**32 - 1)


def _draw(seed: int):
    random = np.random.default_rng(seed)
    return random_machine(random), *random_state(random)


def _samples(count: int):
    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    for _ in range(count):
        yield random_machine(random).parameters(), *random_state(random)


def _mass_matrix(position, parameters):
    m11, m12, m13, m22, m23, m33, *_ = generated.mass_matrix_and_bias.py_func(
        position, np.zeros(3), parameters
    )
    return np.array([[m11, m12, m13], [m12, m22, m23], [m13, m23, m33]])


def _bias(position, velocity, parameters):
    h = np.zeros(3)
    lagrange.bias(position, velocity, parameters, h)
    return h


def _mass_matrix_slope(position, direction, parameters):
    """Differentiate M along ``direction``, by complex step."""
    return _mass_matrix(position + 1j * STEP * direction, parameters).imag / STEP


def test_mass_matrix_is_symmetric_positive_definite():
    matrix = np.zeros((3, 3))
    for parameters, position, _, _ in _samples(1000):
        lagrange.mass_matrix(position, parameters, matrix)
        assert np.array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix)[0] > 0.0


@settings(deadline=None, max_examples=100, derandomize=True)
@given(seeds)
def test_kinetic_energy_is_half_v_m_v(seed):
    machine, position, velocity, _ = _draw(seed)
    parameters = machine.parameters()
    kinetic, _ = lagrange.energies(position, velocity, parameters)
    matrix = np.zeros((3, 3))
    lagrange.mass_matrix(position, parameters, matrix)
    assert kinetic == pytest.approx(velocity @ matrix @ velocity / 2, rel=1e-12)


@settings(deadline=None, max_examples=100, derandomize=True)
@given(seeds)
def test_gravity_load_is_the_gradient_of_the_potential_energy(seed):
    machine, position, _, _ = _draw(seed)
    parameters = machine.parameters()
    gradient = [
        generated.kinetic_and_potential_energy.py_func(
            position + 1j * STEP * unit, np.zeros(3), parameters
        )[1].imag
        / STEP
        for unit in np.eye(3)
    ]
    load = _bias(position, np.zeros(3), parameters)
    np.testing.assert_allclose(load, gradient, rtol=0.0, atol=1e-12 * np.max(np.abs(gradient)))


def test_coriolis_terms_are_the_christoffel_symbols_of_the_mass_matrix():
    """
    h(q, v) - h(q, 0) = C v with C_ij = sum_k (M_ij,k + M_ik,j - M_jk,i) v_k / 2.

    M comes from the code under test, its slopes from complex steps. dM/dt - 2 C must be
    skew-symmetric, with dM/dt from one step along v: the Coriolis forces do no work.
    """
    for parameters, position, velocity, _ in _samples(200):
        slope = np.array([_mass_matrix_slope(position, unit, parameters) for unit in np.eye(3)])
        coriolis = (
            np.einsum('kij,k->ij', slope, velocity)
            + np.einsum('jik,k->ij', slope, velocity)
            - np.einsum('ijk,k->ij', slope, velocity)
        ) / 2
        forces = _bias(position, velocity, parameters) - _bias(position, np.zeros(3), parameters)
        scale = np.max(np.abs(slope)) * velocity @ velocity
        np.testing.assert_allclose(coriolis @ velocity, forces, rtol=0.0, atol=1e-12 * scale)
        rate = _mass_matrix_slope(position, velocity, parameters)
        skew = rate - 2 * coriolis
        np.testing.assert_allclose(skew, -skew.T, rtol=0.0, atol=1e-12 * np.max(np.abs(rate)))
        power = velocity @ (rate @ velocity / 2 - forces)
        assert abs(power) < 1e-11 * scale * np.max(np.abs(velocity))


@settings(deadline=None, max_examples=50, derandomize=True)
@given(seeds)
def test_time_reversed_motion_needs_the_same_force(seed):
    machine, position, velocity, acceleration = _draw(seed)
    parameters = machine.parameters()
    forwards, backwards = np.zeros(3), np.zeros(3)
    lagrange.inverse_dynamics(position, velocity, acceleration, parameters, forwards)
    lagrange.inverse_dynamics(position, -velocity, acceleration, parameters, backwards)
    np.testing.assert_allclose(
        backwards, forwards, rtol=1e-12, atol=1e-12 * np.max(np.abs(forwards))
    )


def test_forward_dynamics_undoes_inverse_dynamics():
    force, acceleration = np.zeros(3), np.zeros(3)
    worst = 0.0
    for parameters, position, velocity, wanted in _samples(1000):
        lagrange.inverse_dynamics(position, velocity, wanted, parameters, force)
        lagrange.forward_dynamics(position, velocity, force, parameters, acceleration)
        worst = max(worst, np.max(np.abs(acceleration - wanted)) / np.max(np.abs(wanted)))
    print(f'biggest relative difference {worst:.3g}')
    assert worst < 1e-11


def test_energy_balance_over_a_motion():
    """
    Integrate freely, and under forces with their work as a fourth state.

    The integrator works to 1e-13 relative, so stored energy minus work is constant to about that.
    """
    acceleration = np.zeros(3)
    for index, (parameters, position, velocity, amplitude) in enumerate(_samples(6)):
        amplitude = amplitude * (index % 2)

        def slope(time, state, parameters=parameters, amplitude=amplitude):
            force = amplitude * np.sin(7.0 * time + np.array([0.0, 1.0, 2.0]))
            lagrange.forward_dynamics(state[:3], state[3:6], force, parameters, acceleration)
            return np.concatenate([state[3:6], acceleration, [force @ state[3:6]]])

        start = np.concatenate([position, velocity, [0.0]])
        end = solve_ivp(slope, (0.0, 2.0), start, method='DOP853', rtol=1e-13, atol=1e-13).y[:, -1]
        before = sum(lagrange.energies(position, velocity, parameters))
        kinetic, potential = lagrange.energies(end[:3], end[3:6], parameters)
        drift = (kinetic + potential - end[6] - before) / (abs(kinetic) + abs(potential))
        print(f'sample {index}: relative drift {drift:.3g}')
        assert abs(drift) < 1e-11


@settings(deadline=None, max_examples=50, derandomize=True)
@given(seeds)
def test_payload_frame_is_the_derivative_of_its_own_motion(seed):
    """Velocity, acceleration and spin must be the time derivatives of position and orientation."""
    machine, position, velocity, acceleration = _draw(seed)
    parameters = machine.parameters()
    complex_frame = np.dtype(
        [
            (name, 'c16', lagrange.PAYLOAD_FRAME[name].shape)
            for name in lagrange.PAYLOAD_FRAME.names
        ]
    )
    frame = np.zeros(1, complex_frame)
    dt = 1j * STEP
    generated.payload_kinematics.py_func(
        position + dt * velocity, velocity + dt * acceleration, acceleration, parameters, frame
    )
    f = frame[0]
    for quantity, rate in (
        ('position', 'velocity'),
        ('velocity', 'acceleration'),
        ('angular_velocity', 'angular_acceleration'),
    ):
        np.testing.assert_allclose(f[quantity].imag / STEP, f[rate].real, rtol=1e-12, atol=1e-11)
    rotation = f['rotation'].real
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    spin = f['rotation'].imag / STEP @ rotation.T
    omega = [spin[2, 1], spin[0, 2], spin[1, 0]]
    np.testing.assert_allclose(f['angular_velocity'].real, omega, rtol=1e-12, atol=1e-12)


# Cases by hand.

G = 9.81
NO_OFFSET = (0.0, 0.0, 0.0)
BALL = np.diag([0.01, 0.01, 0.01])
DRIVE = YRotateDrive(
    motor_inertia_kg_m2=2e-4,
    gear_ratio=16.0,
    drive_pulley_radius_m=0.02,
    driven_pulley_radius_m=0.06,
)
CABLE = CableGeometry(
    pulley_height_m=1.5,
    carriage_mount_height_m=0.1,
    counterweight_mount_above_centre_of_gravity_m=0.2,
    cable_length_m=2.0,
    pulley_radius_m=0.1,
)


def _machine(
    carriage=3.0,
    x_rotate=(14.0, NO_OFFSET, BALL),
    y_rotate=(9.0, NO_OFFSET, BALL),
    counterweight=20.0,
    **more,
):
    return parameters_from_base_frame(
        carriage=RigidBody(carriage, NO_OFFSET, BALL),
        x_rotate=RigidBody(*x_rotate),
        y_rotate=RigidBody(*y_rotate),
        counterweight_mass_kg=counterweight,
        **{'drive': DRIVE, 'cable': CABLE, 'gravity_m_s2': G} | more,
    )


def _force(parameters, position=(0, 0, 0), velocity=(0, 0, 0), acceleration=(0, 0, 0)):
    force = np.zeros(3)
    lagrange.inverse_dynamics(
        np.array(position, float),
        np.array(velocity, float),
        np.array(acceleration, float),
        parameters,
        force,
    )
    return force


def test_y_linear_alone_moves_the_total_mass_against_the_unbalanced_weight():
    parameters = _machine()
    acceleration = np.zeros(3)
    lagrange.forward_dynamics(
        np.zeros(3), np.zeros(3), np.array([100.0, 0, 0]), parameters, acceleration
    )
    payload, counterweight = 3.0 + 14.0 + 9.0, 20.0
    expected = (100.0 - (payload - counterweight) * G) / (payload + counterweight)
    np.testing.assert_allclose(acceleration, [expected, 0.0, 0.0], rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize('angle', [0.0, 0.4, np.pi / 2, -2.0])
def test_pendulum_about_x(angle):
    """
    A load hanging l below the X-Rotate axis: m l^2 + I, restoring moment m g l sin(theta).

    Height of its centre of gravity is d1 - l cos(theta): from that the reaction along d1.
    """
    m, length, i_xx, rate, alpha = 14.0, 0.25, 0.3, 1.5, 2.0
    parameters = _machine(x_rotate=(m, (0.2, -length, 0.0), np.diag([i_xx, 0.2, 0.25])))
    force = _force(parameters, (0.0, angle, 0.0), (0.0, rate, 0.0), (0.0, alpha, 0.0))
    inertia = i_xx + m * length**2 + BALL[0, 0]
    weight_moment = m * G * length * np.sin(angle)
    rise = length * (alpha * np.sin(angle) + rate**2 * np.cos(angle))
    assert force[1] == pytest.approx(inertia * alpha + weight_moment, rel=1e-13, abs=1e-12)
    assert force[0] == pytest.approx((26.0 - 20.0) * G + m * rise, rel=1e-13)


def test_load_that_hangs_is_stable_and_load_that_stands_is_not():
    """The sign of the potential energy; Appendix B as printed has it the other way round."""
    for height, sign in ((-0.2, -1.0), (0.2, 1.0)):
        parameters = _machine(x_rotate=(14.0, (0.0, height, 0.0), BALL))
        acceleration = np.zeros(3)
        lagrange.forward_dynamics(
            np.array([0.0, 0.01, 0.0]),
            np.zeros(3),
            np.array([6.0 * G, 0.0, 0.0]),
            parameters,
            acceleration,
        )
        assert np.sign(acceleration[1]) == sign


def test_gravity_moments_when_the_load_is_turned_upright():
    """
    X-Rotate at 90 degrees, Y-Rotate load of mass m with its centre of gravity at [a, b, c].

    The turn takes y to z and z to -y: the centre of gravity goes to [a, -c, b], the Y-Rotate axis
    to z. Moments of the weight [0, -m g, 0] about x: b m g, about z: -a m g; the motors hold the
    opposite.
    """
    m, (a, b, c) = 9.0, (0.05, 0.12, -0.03)
    force = _force(_machine(y_rotate=(m, (a, b, c), BALL)), position=(0.3, np.pi / 2, 0.0))
    np.testing.assert_allclose(force, [(26.0 - 20.0) * G, -b * m * G, a * m * G], rtol=1e-13)


def test_bar_across_the_y_rotate_axis_strives_outwards():
    """
    Bar along z on link 3, turned by theta3, while link 2 turns about x.

    T = (I_x cos^2 + I_z sin^2) w^2 / 2, so the motor must give Q3 = -dT/dtheta3.
    """
    i_x, i_z, angle, rate = 0.4, 0.1, 0.7, 3.0
    parameters = _machine(y_rotate=(9.0, NO_OFFSET, np.diag([i_x, 0.35, i_z])))
    force = _force(parameters, (0.0, 0.0, angle), (0.0, rate, 0.0))
    expected = -(i_z - i_x) * np.sin(angle) * np.cos(angle) * rate**2
    assert force[2] == pytest.approx(expected, rel=1e-13)


def test_disc_on_the_y_rotate_axis_has_no_gyroscopic_force_on_the_drives():
    disc = np.diag([0.2, 0.35, 0.2])
    parameters = _machine(counterweight=26.0, y_rotate=(9.0, NO_OFFSET, disc))
    np.testing.assert_allclose(_force(parameters, (0, 0.3, 0.8), (0, 2.0, 50.0)), 0.0, atol=1e-12)


def test_drive_multiplies_inertia_by_the_square_of_its_ratio_and_torque_by_it():
    ratio = 16.0 * 0.06 / 0.02
    parameters = _machine()
    assert _force(parameters, acceleration=(0, 0, 1.0))[2] == pytest.approx(0.01 + 2e-4 * ratio**2)
    assert lagrange.motor_angle(0.5, parameters) == pytest.approx(0.5 * ratio)
    force = np.zeros(3)
    lagrange.generalised_forces(np.array([7.0, 5.0, 0.1]), parameters, force)
    np.testing.assert_allclose(force, [7.0, 5.0, 0.1 * ratio], rtol=1e-15)


@settings(deadline=None, max_examples=50, derandomize=True)
@given(st.floats(-1.0, 1.0))
def test_cable_keeps_its_length(d1):
    """Both straight parts and the half turn over the pulley make up the cable (2.1)."""
    cable = CABLE
    counterweight = lagrange.counterweight_height(d1, _machine())
    payload_side = cable.pulley_height_m - (d1 + cable.carriage_mount_height_m)
    other_side = cable.pulley_height_m - (
        counterweight + cable.counterweight_mount_above_centre_of_gravity_m
    )
    length = payload_side + np.pi * cable.pulley_radius_m + other_side
    assert length == pytest.approx(cable.cable_length_m, rel=1e-14)


@settings(deadline=None, max_examples=50, derandomize=True)
@given(seeds)
def test_energies_are_those_of_the_bodies_in_the_base_frame(seed):
    """Sum over bodies, particles of the description's own frame turned by scipy's rotations."""
    machine, position, velocity, _ = _draw(seed)
    parameters = machine.parameters()
    d1, theta2, theta3 = position
    x_rotate_at = np.array(machine.x_rotate_at_m)
    y_rotate_at = np.array(machine.y_rotate_at_m)
    hinge = y_rotate_at - x_rotate_at
    turn_2 = Rotation.from_rotvec([theta2, 0.0, 0.0]).as_matrix()
    turn_3 = turn_2 @ Rotation.from_rotvec([0.0, theta3, 0.0]).as_matrix()
    omega_2 = np.array([velocity[1], 0.0, 0.0])
    omega_3 = omega_2 + turn_2 @ [0.0, velocity[2], 0.0]
    lift, up = np.array([0.0, velocity[0], 0.0]), np.array([0.0, 1.0, 0.0])
    kinetic = machine.counterweight_mass_kg * velocity[0] ** 2 / 2
    kinetic += machine.drive.motor_inertia_kg_m2 * (machine.drive_ratio * velocity[2]) ** 2 / 2
    potential = (
        machine.counterweight_mass_kg
        * machine.gravity_m_s2
        * lagrange.counterweight_height(d1, parameters)
    )
    for body, turn, omega, at in (
        (machine.carriage, np.eye(3), np.zeros(3), x_rotate_at),
        (machine.x_rotate, turn_2, omega_2, x_rotate_at),
        (machine.rotor, turn_2, omega_2, x_rotate_at),
        (machine.y_rotate, turn_3, omega_3, y_rotate_at),
    ):
        arm = turn @ (np.asarray(body.centre_of_gravity_m) - at)
        speed = lift + np.cross(omega, arm)
        if at is y_rotate_at:
            arm = arm + turn_2 @ hinge
            speed = speed + np.cross(omega_2, turn_2 @ hinge)
        tensor = turn @ np.asarray(body.inertia_kg_m2) @ turn.T
        kinetic += body.mass_kg * speed @ speed / 2 + omega @ tensor @ omega / 2
        # The plant's base frame has its origin on the X-Rotate axis.
        potential += body.mass_kg * machine.gravity_m_s2 * up @ (arm + d1 * up)
    ours = lagrange.energies(position, velocity, parameters)
    assert ours[0] == pytest.approx(kinetic, rel=1e-12)
    scale = machine.gravity_m_s2 * 100.0
    assert ours[1] == pytest.approx(potential, rel=1e-12, abs=1e-12 * scale)
