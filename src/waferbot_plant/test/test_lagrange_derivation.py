# SPDX-License-Identifier: Apache-2.0
"""The derivation against first principles, and the generated code against the derivation."""

import importlib.util
import re

import numpy as np
import pytest
import sympy as sp
from lagrange_machines import random_machine, random_state
from sympy import Matrix

from waferbot_plant import lagrange
from waferbot_plant.lagrange import derivation, generate, generated
from waferbot_plant.lagrange.derivation import reduce_squares, time_derivative

SEED = 20250302


@pytest.fixture(scope='module')
def derived():
    return derivation.derive()


def _is_zero(expression) -> bool:
    return all(reduce_squares(e) == 0 for e in Matrix([expression]))


def test_reduce_squares_is_a_normal_form():
    angle = derivation.theta2
    assert reduce_squares(sp.cos(angle) ** 4 - (1 - sp.sin(angle) ** 2) ** 2) == 0
    assert reduce_squares(sp.cos(angle) ** 3) == sp.expand(
        sp.cos(angle) - sp.cos(angle) * sp.sin(angle) ** 2
    )


def test_denavit_hartenberg_is_two_screws():
    """Compare (2.9) with a screw along x (alpha, a) followed by one along z (theta, d)."""
    a, alpha, d, theta = sp.symbols('a alpha d theta')

    def screw(axis: int, shift, angle) -> Matrix:
        i, j = (axis + 1) % 3, (axis + 2) % 3
        transform = sp.eye(4)
        transform[i, i] = transform[j, j] = sp.cos(angle)
        transform[i, j], transform[j, i] = -sp.sin(angle), sp.sin(angle)
        transform[axis, 3] = shift
        return transform

    assert derivation.denavit_hartenberg(a, alpha, d, theta) == screw(0, a, alpha) * screw(
        2, d, theta
    )


def test_axes_of_the_machine_are_where_chapter_1_puts_them():
    """Y-Linear goes along y, X-Rotate turns about x, Y-Rotate at the zero pose about y."""
    to_1, to_2, to_3 = derivation.link_transforms()
    x, y, z = sp.eye(3)[:, 0], sp.eye(3)[:, 1], sp.eye(3)[:, 2]
    assert to_1[:3, 2] == y
    assert to_1[:3, 3] == derivation.d1 * y
    assert to_2[:3, 2] == x
    assert to_2[:3, 3] == derivation.d1 * y + derivation.d2 * x
    assert to_3[:3, 3].subs(derivation.a2, 0) == to_2[:3, 3]
    at_zero = {derivation.theta2: 0, derivation.theta3: 0}
    assert to_3[:3, 2].subs(at_zero) == y
    assert to_3[:3, 3].subs(at_zero) == to_2[:3, 3] + derivation.a2 * z
    # Positive theta2 takes the Y-Rotate axis from y towards z.
    assert to_3[:3, 2].subs(derivation.theta2, sp.pi / 2) == z


def test_velocities_are_derivatives_of_positions(derived):
    for position, velocity in zip(
        (*derived.gravity_centres, derived.origin),
        (*derived.gravity_centre_velocities, derived.velocity),
        strict=True,
    ):
        assert _is_zero(position.applyfunc(time_derivative) - velocity)


def test_angular_velocity_is_that_of_the_rotation_matrix(derived):
    """R_dot R^T must be the cross-product matrix of omega; Appendix B's w2 and w3 are such."""
    for rotation, omega in (
        (derived.rotations[1], derivation.VELOCITIES[1] * Matrix([1, 0, 0])),
        (derived.rotation, derived.angular_velocity),
    ):
        spin = rotation.applyfunc(time_derivative) * rotation.T
        wx, wy, wz = omega
        assert _is_zero((spin - Matrix([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])).reshape(9, 1))


def test_kinetic_energy_is_the_quadratic_form_of_the_mass_matrix(derived):
    """M comes from d/dt dL/dq_dot; it must be symmetric and the Hessian of T."""
    assert derived.mass_matrix == derived.mass_matrix.T
    v = derivation.VELOCITIES
    assert _is_zero((v.T * derived.mass_matrix * v)[0] / 2 - derived.kinetic_energy)


def test_motion_does_not_depend_on_the_height(derived):
    for matrix in (derived.mass_matrix, derived.bias):
        assert derivation.d1 not in matrix.free_symbols


def test_counterweight_of_the_payloads_mass_balances_the_y_axis(derived):
    """The weight along d1 must be (m1 + m2 + m3 - mcw) g at every pose (2.1, 2.2)."""
    at_rest = derived.bias[0].subs(dict.fromkeys(derivation.VELOCITIES, 0))
    m = derivation
    assert sp.expand(at_rest - (m.m1 + m.m2 + m.m3 - m.mcw) * m.g) == 0


def test_single_term_of_the_drive_is_exact(derived):
    """
    Energy of a true rotor on link 2 = energy of it locked to link 2 + J (theta_M_dot)^2 / 2.

    Spin only: inertia J about the shaft (parallel to z3), any other about the transverse axes.
    """
    spin, transverse = sp.symbols('J_spin J_transverse')
    rotation_3 = derived.rotations[2]
    shaft = rotation_3[:, 2]
    tensor = transverse * (sp.eye(3) - shaft * shaft.T) + spin * shaft * shaft.T
    carrier = derivation.VELOCITIES[1] * Matrix([1, 0, 0])
    rate = time_derivative(derivation.motor_angle())
    omega = carrier + rate * shaft
    energy = omega.dot(tensor * omega) / 2
    locked = carrier.dot(tensor * carrier) / 2
    assert _is_zero(energy - locked - spin * rate**2 / 2)


def test_generated_code_is_a_fresh_derivation(derived, tmp_path):
    """
    Derive and generate again; the kept code must give the same numbers, to rounding.

    With the sympy that wrote the kept code, also the same text; another may order terms otherwise.
    """
    fresh_source = generate.source(derived)
    path = tmp_path / 'fresh.py'
    path.write_text(fresh_source, encoding='utf-8')
    spec = importlib.util.spec_from_file_location('fresh', path)
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)

    print(f'seed {SEED}')
    random = np.random.default_rng(SEED)
    for _ in range(20):
        parameters = random_machine(random).parameters()
        position, velocity, acceleration = random_state(random)
        for name in ('mass_matrix_and_bias', 'kinetic_and_potential_energy'):
            kept = getattr(generated, name).py_func(position, velocity, parameters)
            again = getattr(fresh, name).py_func(position, velocity, parameters)
            scale = np.max(np.abs(kept))
            np.testing.assert_allclose(again, kept, rtol=0.0, atol=1e-12 * scale)
        frames = [np.zeros(1, lagrange.PAYLOAD_FRAME) for _ in range(2)]
        for module, frame in zip((generated, fresh), frames, strict=True):
            module.payload_kinematics.py_func(position, velocity, acceleration, parameters, frame)
        for field in lagrange.PAYLOAD_FRAME.names:
            np.testing.assert_allclose(frames[0][field], frames[1][field], rtol=1e-11, atol=1e-11)

    kept_source = generate.GENERATED.read_text(encoding='utf-8')
    written_with = re.search(r'with sympy ([\w.]+)', kept_source).group(1).rstrip(';')
    if written_with == sp.__version__:
        assert fresh_source == kept_source, 'run: python -m waferbot_plant.lagrange.generate'
