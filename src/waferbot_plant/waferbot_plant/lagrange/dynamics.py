# SPDX-License-Identifier: Apache-2.0
"""
The rigid mechanism in numbers: M(q) q_ddot + h(q, q_dot) = Q, energies, payload frame.

Arrays, all float64. Axes in the order y_linear, x_rotate, y_rotate.

    position              (3,)    d1, theta2, theta3                     m, rad, rad
    velocity              (3,)                                           m/s, rad/s, rad/s
    acceleration          (3,)                                           m/s^2, rad/s^2, rad/s^2
    generalised_force     (3,)    along the three coordinates            N, Nm, Nm
    parameters            (1,)    of ``parameters.PARAMETERS``
    frame                 (1,)    of ``PAYLOAD_FRAME``

Signs: d1 positive upwards; theta2 positive about +x of the base; theta3 positive about z3, which
is +y of the base at theta2 = 0.

Assumptions: rigid links, inextensible cables and belt, no friction, massless cables, pulleys and
belt. Results go to arrays that the caller hands over; nothing is allocated.
"""

import numpy as np

from waferbot_lockstep.compiled import compiled

from .generated import (
    kinetic_and_potential_energy,
    mass_matrix_and_bias,
    payload_kinematics,
)

PAYLOAD_FRAME = np.dtype(
    [
        ('position', 'f8', (3,)),  # m, origin of frame 4
        ('rotation', 'f8', (3, 3)),  # frame 4 to base: columns are its axes
        ('velocity', 'f8', (3,)),  # m/s
        ('angular_velocity', 'f8', (3,)),  # rad/s
        ('acceleration', 'f8', (3,)),  # m/s^2, without gravity: what the wafer does, not feels
        ('angular_acceleration', 'f8', (3,)),  # rad/s^2
    ],
    align=True,
)
"""Motion of the payload (wafer) frame 4, all in axes of the base frame."""


@compiled
def mass_matrix(position, parameters, mass_matrix):
    """
    Write the mass matrix M(q) into ``mass_matrix`` (3, 3): symmetric, positive definite.

    Units: kg, kg m, kg m^2. It contains the counterweight (by (2.2), its mass adds to the first
    diagonal element) and the Y-Rotate motor (by (2.3) to (2.8), its inertia times the square of
    the ratio R_G r2/r1 adds to the third).
    """
    m_11, m_12, m_13, m_22, m_23, m_33, _, _, _ = mass_matrix_and_bias(
        position, position, parameters
    )
    mass_matrix[0, 0] = m_11
    mass_matrix[0, 1] = m_12
    mass_matrix[0, 2] = m_13
    mass_matrix[1, 0] = m_12
    mass_matrix[1, 1] = m_22
    mass_matrix[1, 2] = m_23
    mass_matrix[2, 0] = m_13
    mass_matrix[2, 1] = m_23
    mass_matrix[2, 2] = m_33


@compiled
def bias(position, velocity, parameters, bias):
    """
    Write h(q, q_dot) into ``bias`` (3,): the generalised force that holds zero acceleration.

    N, Nm, Nm. Coriolis, centrifugal and gravity terms together; at zero velocity it is the gravity
    load that the motors hold.
    """
    _, _, _, _, _, _, h_1, h_2, h_3 = mass_matrix_and_bias(position, velocity, parameters)
    bias[0] = h_1
    bias[1] = h_2
    bias[2] = h_3


@compiled
def forward_dynamics(position, velocity, generalised_force, parameters, acceleration):
    """
    Write into ``acceleration`` what ``generalised_force`` gives: q_ddot = M^-1 (Q - h).

    All three equations are solved together, as their accelerations are coupled; M = L D L^T is
    factorised in place, which for a positive definite matrix needs no pivoting.
    """
    m_11, m_12, m_13, m_22, m_23, m_33, h_1, h_2, h_3 = mass_matrix_and_bias(
        position, velocity, parameters
    )
    l_21 = m_12 / m_11
    l_31 = m_13 / m_11
    d_22 = m_22 - l_21 * m_12
    e_32 = m_23 - l_21 * m_13
    l_32 = e_32 / d_22
    d_33 = m_33 - l_31 * m_13 - l_32 * e_32

    y_1 = generalised_force[0] - h_1
    y_2 = generalised_force[1] - h_2 - l_21 * y_1
    y_3 = generalised_force[2] - h_3 - l_31 * y_1 - l_32 * y_2

    a_3 = y_3 / d_33
    a_2 = y_2 / d_22 - l_32 * a_3
    acceleration[0] = y_1 / m_11 - l_21 * a_2 - l_31 * a_3
    acceleration[1] = a_2
    acceleration[2] = a_3


@compiled
def inverse_dynamics(position, velocity, acceleration, parameters, generalised_force):
    """Write into ``generalised_force`` what ``acceleration`` needs: Q = M q_ddot + h."""
    m_11, m_12, m_13, m_22, m_23, m_33, h_1, h_2, h_3 = mass_matrix_and_bias(
        position, velocity, parameters
    )
    a_1 = acceleration[0]
    a_2 = acceleration[1]
    a_3 = acceleration[2]
    generalised_force[0] = m_11 * a_1 + m_12 * a_2 + m_13 * a_3 + h_1
    generalised_force[1] = m_12 * a_1 + m_22 * a_2 + m_23 * a_3 + h_2
    generalised_force[2] = m_13 * a_1 + m_23 * a_2 + m_33 * a_3 + h_3


@compiled
def energies(position, velocity, parameters):
    """
    Return kinetic and potential energy in J (2.21 to 2.24).

    The potential energy counts from the base frame's origin and includes the counterweight at the
    height that the cable gives it (2.1).

    The Y-Rotate motor enters the kinetic energy as J_3M theta_M_dot^2 / 2 only, as in the thesis.
    That is exact if (a) the motor's mass and its inertia as of a body locked to the X-Rotate body
    are counted in the X-Rotate body, and (b) its shaft is parallel to z3. For then link 2 turns
    about z2, at right angles to the shaft: the cross term J_3M theta_M_dot (omega_2 . z3) of a
    spinning rotor on a turning carrier is zero at every pose.
    """
    return kinetic_and_potential_energy(position, velocity, parameters)


@compiled
def payload_frame(position, velocity, acceleration, parameters, frame):
    """Write the motion of the payload frame into ``frame`` (2.9, 2.12, 2.13, 2.17)."""
    payload_kinematics(position, velocity, acceleration, parameters, frame)


@compiled
def generalised_forces(motor_forces, parameters, generalised_force):
    """
    Write into ``generalised_force`` what the motors do, by virtual work (2.30 to 2.34).

    ``motor_forces`` (3,): linear motor N, X-Rotate motor Nm, Y-Rotate motor Nm at its own shaft;
    the last is multiplied by R_G r2/r1, as power is conserved through gearbox and belt.
    """
    generalised_force[0] = motor_forces[0]
    generalised_force[1] = motor_forces[1]
    generalised_force[2] = motor_forces[2] * _drive_ratio(parameters)


@compiled
def motor_angle(theta3, parameters):
    """Angle (or, given a rate, rate) of the Y-Rotate motor's shaft, rad (2.3, 2.6)."""
    return theta3 * _drive_ratio(parameters)


@compiled
def counterweight_height(d1, parameters):
    """Height of the counterweight's centre of gravity over the base, m, at d1 in m (2.1)."""
    p = parameters[0]
    return (
        2.0 * p['cable_pulley_height']
        - p['carriage_cable_mount_height']
        - p['counterweight_cable_mount_height']
        - p['cable_length']
        + np.pi * p['cable_pulley_radius']
        - d1
    )


@compiled
def _drive_ratio(parameters):
    """Turns of the motor per turn of the payload: R_G r2/r1."""
    p = parameters[0]
    return p['gear_ratio'] * p['driven_pulley_radius'] / p['drive_pulley_radius']
