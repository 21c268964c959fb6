# SPDX-License-Identifier: Apache-2.0
"""
Symbolic derivation of the rigid mechanism's equations of motion (thesis, chapter 2, Appendix B).

The chain: Denavit-Hartenberg transforms (2.9, Table 2.1) -> angular and linear velocities (2.10 to
2.20) -> kinetic and potential energy (2.21 to 2.24) under the configuration constraints (2.1 to
2.8) -> Lagrangian (2.25) -> Euler-Lagrange equations (2.26).

Frames. Frame 0, the base, has y up and gravity along -y; its origin is where the X-Rotate axis
meets the Y-Linear axis at d1 = 0. Frame i is fixed in link i and turns about (link 1: slides
along) its own z axis. At the zero pose, with x, y, z the base axes:

    frame 1  (carriage)       z1 = y,  x1 = z,  y1 = x
    frame 2  (X-Rotate body)  z2 = x,  x2 = z,  y2 = -y    origin at (d2, d1, 0)
    frame 3  (Y-Rotate body)  z3 = y,  x3 = z,  y3 = x     origin at (d2, d1, a2)
    frame 4  (payload)        parallel to frame 3

so theta2 turns about +x and, at theta2 = 0, theta3 about +y.

One length more than in the thesis: a2 (declared in Appendix B, zero in Table 2.1), by which the
Y-Rotate axis may miss the X-Rotate axis. With a2 = 0 all is as in the thesis.

Everything is in SI units. This takes about a second and runs only when the code is generated.
"""

from dataclasses import dataclass

import sympy as sp
from sympy import Matrix, Rational, Symbol, cos, pi, sin


def _vector(name: str) -> Matrix:
    return Matrix([Symbol(f'{name}{axis}') for axis in 'xyz'])


def _inertia_tensor(name: str) -> Matrix:
    xx, xy, xz, yy, yz, zz = (Symbol(name + ij) for ij in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz'))
    return Matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


# Generalised coordinates (2.27 to 2.29) and their time derivatives.
d1, theta2, theta3 = sp.symbols('d1 theta2 theta3')
COORDINATES = Matrix([d1, theta2, theta3])
VELOCITIES = Matrix(sp.symbols('d1_dot theta2_dot theta3_dot'))
ACCELERATIONS = Matrix(sp.symbols('d1_ddot theta2_ddot theta3_ddot'))

# Links. m: mass, kg. r: centre of gravity from the link's frame, in that frame, m.
# I: inertia tensor about the centre of gravity, in axes parallel to the link's frame, kg m^2.
m1, m2, m3, mcw = sp.symbols('m1 m2 m3 mcw')
r1, r2, r3 = _vector('r1'), _vector('r2'), _vector('r3')
I2, I3 = _inertia_tensor('I2'), _inertia_tensor('I3')

d2 = Symbol('d2')  # m, Table 2.1
a2 = Symbol('a2')  # m, zero in Table 2.1
r4 = _vector('r4')  # m, origin of frame 4 in frame 3; Table 2.1 has [0, 0, d4]
g = Symbol('g')  # m/s^2, along -y of the base

# Cable (2.1), m.
c1, c2, c3, cable_length, pulley_radius = sp.symbols('c1 c2 c3 cable_length pulley_radius')

# Y-Rotate drive (2.3 to 2.8): ratio, drive and driven pulley radius (m), motor inertia (kg m^2).
gear_ratio, drive_radius, driven_radius = sp.symbols('gear_ratio drive_radius driven_radius')
J3M = Symbol('J3M')


@dataclass(frozen=True)
class Derivation:
    """
    The result: 3-vectors and 3x3 matrices of sympy expressions, SI units.

    ``mass_matrix`` and ``bias`` are those of M q_ddot + h = Q. ``origin``, ``rotation`` (frame 4
    to base) and the velocities and accelerations are those of the payload frame in base axes.
    ``gravity_centres`` and their velocities are those of links 1, 2, 3 in base axes.
    """

    mass_matrix: Matrix
    bias: Matrix
    kinetic_energy: sp.Expr
    potential_energy: sp.Expr
    rotations: tuple[Matrix, Matrix, Matrix]
    gravity_centres: tuple[Matrix, Matrix, Matrix]
    gravity_centre_velocities: tuple[Matrix, Matrix, Matrix]
    origin: Matrix
    rotation: Matrix
    velocity: Matrix
    angular_velocity: Matrix
    acceleration: Matrix
    angular_acceleration: Matrix


def denavit_hartenberg(a: sp.Expr, alpha: sp.Expr, d: sp.Expr, theta: sp.Expr) -> Matrix:
    """
    Homogeneous transform of frame i to frame i-1 (2.9): a, alpha of link i-1; d, theta of joint i.

    Lengths in m, angles in rad, 4x4.
    """
    return Matrix(
        [
            [cos(theta), -sin(theta), 0, a],
            [sin(theta) * cos(alpha), cos(theta) * cos(alpha), -sin(alpha), -sin(alpha) * d],
            [sin(theta) * sin(alpha), cos(theta) * sin(alpha), cos(alpha), cos(alpha) * d],
            [0, 0, 0, 1],
        ]
    )


def link_transforms() -> tuple[Matrix, Matrix, Matrix]:
    """Return the transforms of frames 1, 2, 3 to the base (Table 2.1), 4x4 each."""
    to_1 = denavit_hartenberg(0, -pi / 2, d1, -pi / 2)
    to_2 = to_1 * denavit_hartenberg(0, -pi / 2, d2, theta2)
    to_3 = to_2 * denavit_hartenberg(a2, pi / 2, 0, theta3)
    return to_1, to_2, to_3


def counterweight_position() -> sp.Expr:
    """Height of the counterweight's centre of gravity over the base, m (2.1); rigid cable."""
    return 2 * c3 - c1 - c2 - cable_length + pi * pulley_radius - d1


def gearbox_angle() -> sp.Expr:
    """Angle of gearbox output and drive pulley, rad (2.6 solved for theta_G); rigid belt."""
    return driven_radius / drive_radius * theta3


def motor_angle() -> sp.Expr:
    """Angle of the Y-Rotate motor shaft against link 2, rad (2.3); rigid gearbox."""
    return gear_ratio * gearbox_angle()


def time_derivative(expression):
    """Total time derivative, by the chain rule over coordinates and velocities."""
    return (
        sp.Matrix([expression]).jacobian(COORDINATES) * VELOCITIES
        + sp.Matrix([expression]).jacobian(VELOCITIES) * ACCELERATIONS
    )[0]


def reduce_squares(expression: sp.Expr) -> sp.Expr:
    """
    Expand, and remove the even powers of cosines by cos^2 = 1 - sin^2.

    A normal form: two polynomials in the sines and cosines of theta2 and theta3 that are equal for
    all angles become the same expression. It is also much shorter than what differentiation
    leaves.
    """
    for angle in (theta2, theta3):
        cosine = sp.Dummy()
        polynomial = sp.Poly(sp.expand(expression).subs(cos(angle), cosine), cosine)
        expression = sum(
            coefficient * (1 - sin(angle) ** 2) ** (power // 2) * cos(angle) ** (power % 2)
            for (power,), coefficient in polynomial.terms()
        )
    return sp.expand(expression)


def derive() -> Derivation:
    """Derive the equations of motion, the energies and the motion of the payload frame."""
    to_1, to_2, to_3 = link_transforms()
    rotation_1, rotation_2, rotation_3 = (to[:3, :3] for to in (to_1, to_2, to_3))
    origin_1, origin_2, origin_3 = (to[:3, 3] for to in (to_1, to_2, to_3))
    z1, z2, z3 = (rotation[:, 2] for rotation in (rotation_1, rotation_2, rotation_3))
    d1_dot, theta2_dot, theta3_dot = VELOCITIES

    # Angular velocities (2.10 to 2.12); the carriage does not turn.
    omega_2 = theta2_dot * z2
    omega_3 = omega_2 + theta3_dot * z3

    # Linear velocities of the frames (2.14 to 2.16; the second term of v_3 is zero with a2) and of
    # the centres of gravity (2.18 to 2.20).
    v_1 = v_2 = d1_dot * z1
    v_3 = v_2 + omega_2.cross(origin_3 - origin_2)
    v_g1 = v_1
    v_g2 = v_2 + omega_2.cross(rotation_2 * r2)
    v_g3 = v_3 + omega_3.cross(rotation_3 * r3)
    r_g1 = origin_1 + rotation_1 * r1
    r_g2 = origin_2 + rotation_2 * r2
    r_g3 = origin_3 + rotation_3 * r3

    # Kinetic energy (2.21, 2.22). The counterweight moves by (2.1), the drive by (2.3 to 2.8).
    inertia_2 = rotation_2 * I2 * rotation_2.T
    inertia_3 = rotation_3 * I3 * rotation_3.T
    half = Rational(1, 2)
    v_cw = time_derivative(counterweight_position())
    omega_m = time_derivative(motor_angle())
    kinetic_energy = (
        half * m1 * v_g1.dot(v_g1)
        + half * m2 * v_g2.dot(v_g2)
        + half * omega_2.dot(inertia_2 * omega_2)
        + half * m3 * v_g3.dot(v_g3)
        + half * omega_3.dot(inertia_3 * omega_3)
        + half * mcw * v_cw**2
        + half * J3M * omega_m**2
    )

    # Potential energy (2.23, 2.24), with the sign of (2.24).
    gravity = Matrix([0, -g, 0])
    r_cw = Matrix([0, counterweight_position(), 0])
    potential_energy = -sum(
        m * gravity.dot(r) for m, r in ((m1, r_g1), (m2, r_g2), (m3, r_g3), (mcw, r_cw))
    )

    # Lagrangian and Euler-Lagrange equations (2.25, 2.26): left-hand sides, equal to Q.
    lagrangian = kinetic_energy - potential_energy
    equations = Matrix(
        [
            time_derivative(sp.diff(lagrangian, velocity)) - sp.diff(lagrangian, coordinate)
            for coordinate, velocity in zip(COORDINATES, VELOCITIES, strict=True)
        ]
    )
    mass_matrix = equations.jacobian(ACCELERATIONS).applyfunc(reduce_squares)
    bias = equations.subs(dict.fromkeys(ACCELERATIONS, 0)).applyfunc(reduce_squares)

    # Payload frame (2.13, 2.17, and their time derivatives).
    omega_4 = omega_3
    origin_4 = origin_3 + rotation_3 * r4
    v_4 = v_3 + omega_4.cross(rotation_3 * r4)
    return Derivation(
        mass_matrix=mass_matrix,
        bias=bias,
        kinetic_energy=kinetic_energy,
        potential_energy=potential_energy,
        rotations=(rotation_1, rotation_2, rotation_3),
        gravity_centres=(r_g1, r_g2, r_g3),
        gravity_centre_velocities=(v_g1, v_g2, v_g3),
        origin=origin_4,
        rotation=rotation_3,
        velocity=v_4,
        angular_velocity=omega_4,
        acceleration=v_4.applyfunc(time_derivative),
        angular_acceleration=omega_4.applyfunc(time_derivative),
    )
