# SPDX-License-Identifier: Apache-2.0
# Written by generate.py with sympy 1.14.0; do not edit.
# fmt: off
"""The equations of motion as plain code, from the symbolic derivation."""

from numpy import cos, pi, sin

from waferbot_lockstep.compiled import compiled


@compiled
def mass_matrix_and_bias(position, velocity, parameters):
    """
    Upper triangle of M and vector h of M q_ddot + h = Q (2.26), row by row.

    position (3,): m, rad, rad; velocity (3,): m/s, rad/s, rad/s; parameters (1,) of
    PARAMETERS. Neither M nor h depends on position[0].
    """
    p = parameters[0]
    I2zz = p['x_rotate_inertia'][2, 2]
    I3xx = p['y_rotate_inertia'][0, 0]
    I3xy = p['y_rotate_inertia'][0, 1]
    I3xz = p['y_rotate_inertia'][0, 2]
    I3yy = p['y_rotate_inertia'][1, 1]
    I3yz = p['y_rotate_inertia'][1, 2]
    I3zz = p['y_rotate_inertia'][2, 2]
    J3M = p['motor_inertia']
    a2 = p['y_rotate_offset']
    drive_radius = p['drive_pulley_radius']
    driven_radius = p['driven_pulley_radius']
    g = p['gravity']
    gear_ratio = p['gear_ratio']
    m1 = p['carriage_mass']
    m2 = p['x_rotate_mass']
    m3 = p['y_rotate_mass']
    mcw = p['counterweight_mass']
    r2x = p['x_rotate_centre_of_gravity'][0]
    r2y = p['x_rotate_centre_of_gravity'][1]
    r3x = p['y_rotate_centre_of_gravity'][0]
    r3y = p['y_rotate_centre_of_gravity'][1]
    r3z = p['y_rotate_centre_of_gravity'][2]
    theta2 = position[1]
    theta2_dot = velocity[1]
    theta3 = position[2]
    theta3_dot = velocity[2]
    x0 = m1 + m2 + m3
    x1 = sin(theta3)
    x2 = cos(theta2)
    x3 = m3*x2
    x4 = r3y*x3
    x5 = cos(theta3)
    x6 = r3x*x3
    x7 = sin(theta2)
    x8 = m2*r2y
    x9 = m3*r3z
    x10 = x7*(x8 - x9)
    x11 = a2*m3
    x12 = m2*r2x
    x13 = m3*x7
    x14 = r3x*x13
    x15 = r3y*x13
    x16 = r3x**2
    x17 = 2*r3x
    x18 = x11*x17
    x19 = 2*I3xy
    x20 = m3*r3y
    x21 = x17*x20
    x22 = 2*r3y*x11
    x23 = r3y**2
    x24 = r3x*x9
    x25 = r3y*x9
    x26 = theta2_dot**2
    x27 = x11*x26
    x28 = theta2_dot*theta3_dot
    x29 = 2*x28
    x30 = theta3_dot**2
    x31 = x26 + x30
    m_11 = mcw + x0
    m_12 = x1*x4 + x10 + x2*(-x11 - x12) - x5*x6
    m_13 = x1*x14 + x15*x5
    m_22 = (
        I2zz + I3yy + a2**2*m3 + m2*(r2x**2 + r2y**2) + m3*(r3z**2 + x16) + x1*(x1*(I3xx
        - I3yy + m3*(-x16 + x23)) - x22) + x5*(x1*(x19 - x21) + x18)
    )
    m_23 = x1*(I3xz - x24) + x5*(I3yz - x25)
    m_33 = I3zz + J3M*driven_radius**2*gear_ratio**2/drive_radius**2 + m3*x16 + m3*x23
    h_1 = (
        g*(-mcw + x0) + x1*(-x15*x31 + x29*x6) + x2*(x26*x8 - x26*x9) + x5*(x14*x31 +
        x29*x4) + x7*(x12*x26 + x27)
    )
    h_2 = (
        g*x10 + x1*(-I3yz*x30 + g*x4 + x1*(-4*I3xy*x28 +
        4*m3*r3x*r3y*theta2_dot*theta3_dot) - x18*x28 + x25*x30) + x19*x28 + x2*(-g*x11 -
        g*x12) - x21*x28 + x5*(I3xz*x30 - g*x6 + x1*(I3xx*x29 - I3yy*x29 +
        m3*(2*theta2_dot*theta3_dot*x23 - x16*x29)) - x22*x28 - x24*x30)
    )
    h_3 = (
        -I3xy*x26 + r3x*x20*x26 + x1*(g*x14 + r3x*x27 + x1*(x19*x26 - x21*x26)) +
        x5*(g*x15 + r3y*x27 + x1*(-I3xx*x26 + I3yy*x26 + m3*(x16*x26 - x23*x26)))
    )
    return m_11, m_12, m_13, m_22, m_23, m_33, h_1, h_2, h_3


@compiled
def kinetic_and_potential_energy(position, velocity, parameters):
    """T_tot (2.21, 2.22) and V_tot (2.23, 2.24) in J; V_tot counts from the base."""
    p = parameters[0]
    I2zz = p['x_rotate_inertia'][2, 2]
    I3xx = p['y_rotate_inertia'][0, 0]
    I3xy = p['y_rotate_inertia'][0, 1]
    I3xz = p['y_rotate_inertia'][0, 2]
    I3yy = p['y_rotate_inertia'][1, 1]
    I3yz = p['y_rotate_inertia'][1, 2]
    I3zz = p['y_rotate_inertia'][2, 2]
    J3M = p['motor_inertia']
    a2 = p['y_rotate_offset']
    c1 = p['carriage_cable_mount_height']
    c2 = p['counterweight_cable_mount_height']
    c3 = p['cable_pulley_height']
    cable_length = p['cable_length']
    d1 = position[0]
    d1_dot = velocity[0]
    drive_radius = p['drive_pulley_radius']
    driven_radius = p['driven_pulley_radius']
    g = p['gravity']
    gear_ratio = p['gear_ratio']
    m1 = p['carriage_mass']
    m2 = p['x_rotate_mass']
    m3 = p['y_rotate_mass']
    mcw = p['counterweight_mass']
    pulley_radius = p['cable_pulley_radius']
    r1z = p['carriage_centre_of_gravity'][2]
    r2x = p['x_rotate_centre_of_gravity'][0]
    r2y = p['x_rotate_centre_of_gravity'][1]
    r3x = p['y_rotate_centre_of_gravity'][0]
    r3y = p['y_rotate_centre_of_gravity'][1]
    r3z = p['y_rotate_centre_of_gravity'][2]
    theta2 = position[1]
    theta2_dot = velocity[1]
    theta3 = position[2]
    theta3_dot = velocity[2]
    x0 = theta2_dot**2
    x1 = (1/2)*x0
    x2 = I3yy*x1
    x3 = (1/2)*theta3_dot**2
    x4 = (1/2)*d1_dot**2
    x5 = sin(theta2)
    x6 = m2*r2y
    x7 = d1_dot*theta2_dot
    x8 = m3*r3z
    x9 = cos(theta2)
    x10 = a2*m3
    x11 = m2*r2x
    x12 = r3y**2
    x13 = r3x**2
    x14 = cos(theta3)
    x15 = theta2_dot*theta3_dot
    x16 = r3x*x0
    x17 = m3*r3y
    x18 = x17*x5
    x19 = d1_dot*theta3_dot
    x20 = x15*x8
    x21 = m3*r3x
    x22 = x7*x9
    x23 = sin(theta3)
    x24 = x21*x5
    x25 = g*mcw
    kinetic = (
        I2zz*x1 + I3zz*x3 + J3M*driven_radius**2*gear_ratio**2*x3/drive_radius**2 +
        a2**2*m3*x1 + m1*x4 + m2*(r2x**2*x1 + r2y**2*x1 + x4) + m3*(r3z**2*x1 + x12*x3 +
        x13*(x1 + x3) + x4) + mcw*x4 + x14*(I3yz*x15 - r3y*x20 + x10*x16 + x18*x19 -
        x21*x22 + x23*(I3xy*x0 - x16*x17)) + x2 + x23*(I3xz*x15 - r3x*x20 - r3y*x0*x10 +
        x17*x22 + x19*x24 + x23*(I3xx*x1 + m3*((1/2)*x0*x12 - x1*x13) - x2)) + x5*(x6*x7
        - x7*x8) + x9*(-x10*x7 - x11*x7)
    )
    potential = (
        -c1*x25 - c2*x25 + 2*c3*x25 + d1*g*(m1 + m2 + m3 - mcw) - g*x14*x24 + g*x18*x23 +
        g*x9*(m3*r3z - x6) + g*(-cable_length*mcw + m1*r1z + pi*mcw*pulley_radius) +
        x5*(-g*x10 - g*x11)
    )
    return kinetic, potential


@compiled
def payload_kinematics(position, velocity, acceleration, parameters, frame):
    """Write the motion of frame 4 in base axes into frame, (1,) of PAYLOAD_FRAME."""
    p = parameters[0]
    f = frame[0]
    a2 = p['y_rotate_offset']
    d1 = position[0]
    d1_ddot = acceleration[0]
    d1_dot = velocity[0]
    d2 = p['x_rotate_offset']
    r4x = p['payload_origin'][0]
    r4y = p['payload_origin'][1]
    r4z = p['payload_origin'][2]
    theta2 = position[1]
    theta2_ddot = acceleration[1]
    theta2_dot = velocity[1]
    theta3 = position[2]
    theta3_ddot = acceleration[2]
    theta3_dot = velocity[2]
    x0 = sin(theta3)
    x1 = cos(theta3)
    x2 = cos(theta2)
    x3 = r4z*x2
    x4 = sin(theta2)
    x5 = a2*x4
    x6 = x0*x4
    x7 = x1*x4
    x8 = a2*x2
    x9 = r4z*x4
    x10 = x1*x2
    x11 = x0*x2
    x12 = r4x*theta3_dot
    x13 = theta3_dot*x4
    x14 = theta2_dot*x2
    x15 = theta3_dot*x2
    x16 = r4x*theta3_ddot
    x17 = theta3_dot**2
    x18 = r4y*theta3_ddot
    x19 = theta2_dot**2
    x20 = a2*x19 - r4z*theta2_ddot
    x21 = -a2*theta2_ddot - r4z*x19
    x22 = -r4x*theta2_ddot + 2*r4y*theta2_dot*theta3_dot
    x23 = x17 + x19
    x24 = r4y*theta2_ddot + 2*theta2_dot*x12
    x25 = -x23
    f['position'][0] = d2 + r4x*x0 + r4y*x1
    f['position'][1] = d1 - r4x*x7 + r4y*x6 + x3 - x5
    f['position'][2] = r4x*x10 - r4y*x11 + x8 + x9
    f['velocity'][0] = -r4y*theta3_dot*x0 + x1*x12
    f['velocity'][1] = (
        d1_dot - theta2_dot*x8 - theta2_dot*x9 + x0*(r4x*x13 + r4y*x14) + x1*(-r4x*x14 +
        r4y*theta3_dot*x4)
    )
    f['velocity'][2] = (
        theta2_dot*x3 - theta2_dot*x5 + x0*(-r4x*x15 + r4y*theta2_dot*x4) +
        x1*(-r4x*theta2_dot*x4 - r4y*x15)
    )
    f['angular_velocity'][0] = theta2_dot
    f['angular_velocity'][1] = x15
    f['angular_velocity'][2] = x13
    f['acceleration'][0] = x0*(-r4x*x17 - x18) + x1*(-r4y*x17 + x16)
    f['acceleration'][1] = (
        d1_ddot + x0*(x2*x24 + x4*(r4y*x25 + x16)) + x1*(x2*x22 + x4*(r4x*x23 + x18)) +
        x2*x21 + x20*x4
    )
    f['acceleration'][2] = (
        x0*(x2*(r4y*x23 - x16) + x24*x4) + x1*(x2*(r4x*x25 - x18) + x22*x4) - x2*x20 +
        x21*x4
    )
    f['angular_acceleration'][0] = theta2_ddot
    f['angular_acceleration'][1] = -theta2_dot*x13 + theta3_ddot*x2
    f['angular_acceleration'][2] = theta2_dot*x15 + theta3_ddot*x4
    f['rotation'][0, 0] = x0
    f['rotation'][0, 1] = x1
    f['rotation'][0, 2] = 0
    f['rotation'][1, 0] = -x7
    f['rotation'][1, 1] = x6
    f['rotation'][1, 2] = x2
    f['rotation'][2, 0] = x10
    f['rotation'][2, 1] = -x11
    f['rotation'][2, 2] = x4
