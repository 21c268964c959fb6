# SPDX-License-Identifier: Apache-2.0
"""Shaft, cross-roller bearing and ferrofluid seal, equations (5.27) to (5.31)."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import eigh

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts import cross_roller_bearing, ferrofluid_seal, shaft
from waferbot_plant.parts.cross_roller_bearing import CrossRollerBearing, CrossRollerLoad
from waferbot_plant.parts.ferrofluid_seal import FerrofluidSeal
from waferbot_plant.parts.load_deflection import ForceDeflection, MomentTilt
from waferbot_plant.parts.shaft import Shaft

SHAFT = Shaft(
    outer_diameter_m=0.08,
    inner_diameter_m=0.04,
    length_m=0.25,
    elastic_modulus_pa=200e9,
    shear_modulus_pa=77e9,
    loss_factor=0.003,
)


def test_moments_of_the_section_by_integration():
    polar = quad(lambda r: 2.0 * math.pi * r**3, 0.02, 0.04)[0]
    about_diameter = quad(lambda r: math.pi * r**3, 0.02, 0.04)[0]
    assert shaft.polar_moment_m4(SHAFT) == pytest.approx(polar, rel=1e-12)
    assert shaft.area_moment_m4(SHAFT) == pytest.approx(about_diameter, rel=1e-12)


def test_torsional_stiffness_by_stacking_thin_slices():
    """Twist of the shaft under 1 Nm, summed over slices of the shear in each ring."""
    polar = quad(lambda r: 2.0 * math.pi * r**3, 0.02, 0.04)[0]
    twist = sum(1.0 / (77e9 * polar) * (0.25 / 100) for _ in range(100))
    assert shaft.torsional_stiffness_nm_per_rad(SHAFT) == pytest.approx(1.0 / twist, rel=1e-9)


def test_bending_stiffness_by_finite_elements():
    """A cantilever of ten beam elements under 1 N at its end."""
    bending = 200e9 * math.pi * (0.08**4 - 0.04**4) / 64.0
    count, length = 10, 0.25 / 10
    matrix = np.zeros((2 * count + 2, 2 * count + 2))
    element = (
        bending
        / length**3
        * np.array(
            [
                [12, 6 * length, -12, 6 * length],
                [6 * length, 4 * length**2, -6 * length, 2 * length**2],
                [-12, -6 * length, 12, -6 * length],
                [6 * length, 2 * length**2, -6 * length, 4 * length**2],
            ]
        )
    )
    for place in range(count):
        matrix[2 * place : 2 * place + 4, 2 * place : 2 * place + 4] += element
    force = np.zeros(2 * count)
    force[-2] = 1.0
    deflection = np.linalg.solve(matrix[2:, 2:], force)[-2]
    assert shaft.bending_stiffness_n_per_m(SHAFT) == pytest.approx(1.0 / deflection, rel=1e-8)


def test_torsion_frequency_is_the_mode_of_rotor_and_load():
    stiffness = shaft.torsional_stiffness_nm_per_rad(SHAFT)
    spring = stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    omega_squared = eigh(spring, np.diag([0.013, 0.837]), eigvals_only=True)[1]
    found = shaft.torsion_frequency(SHAFT, 0.837, 0.013)
    assert found**2 == pytest.approx(omega_squared, rel=1e-9)


def test_held_rotor_is_equation_5_29():
    held = math.sqrt(shaft.torsional_stiffness_nm_per_rad(SHAFT) / 0.837)
    assert shaft.torsion_frequency(SHAFT, 0.837) == pytest.approx(held, rel=1e-12)
    assert shaft.torsion_frequency(SHAFT, 0.837, 1e12) == pytest.approx(held, rel=1e-9)


def test_bending_frequency_is_equation_5_31():
    expected = math.sqrt(shaft.bending_stiffness_n_per_m(SHAFT) / 23.8)
    assert shaft.bending_frequency(SHAFT, 23.8) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'outer_diameter_m': -0.08}, r'outer_diameter_m is -0\.08'),
        ({'inner_diameter_m': 0.08}, 'must be smaller than outer_diameter_m'),
        ({'length_m': 0.0}, 'length_m is 0'),
        ({'shear_modulus_pa': 200e9}, "Poisson's ratio -0.5"),
        ({'shear_modulus_pa': 60e9}, "Poisson's ratio 0.667"),
    ],
)
def test_bad_shafts_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(SHAFT, **change)


LOADS = tuple(float(value) for value in range(0, 501, 10))
MOMENTS = tuple(float(value) for value in range(0, 51))
BEARING = CrossRollerBearing(
    radial=ForceDeflection(LOADS, tuple(0.0109 * value**0.9 for value in LOADS)),
    moment=MomentTilt(MOMENTS, tuple(7.4 * value**0.9 for value in MOMENTS)),
    load_variability=0.25,
    pitch_diameter_m=0.1,
    friction_coefficient=0.01,
    loss_factor=0.001,
)


def test_static_load_by_hand():
    load = cross_roller_bearing.static_load(23.8, -0.08, gravity_m_per_s2=9.81)
    assert load.radial_n == pytest.approx(23.8 * 9.81, rel=1e-12)
    assert load.moment_nm == pytest.approx(23.8 * 9.81 * 0.08, rel=1e-12)


def test_stiffness_of_line_contacts_matches_the_power_law():
    """With deflection c F^0.9 the secants have closed forms; along over across tends to 1/0.9."""
    load = CrossRollerLoad(radial_n=233.0, moment_nm=18.7)
    found = cross_roller_bearing.stiffness(BEARING, load)

    def along(value, scale):
        return 0.5 * value / (scale * ((1.25 * value) ** 0.9 - (0.75 * value) ** 0.9))

    assert found.radial_y_n_per_m == pytest.approx(along(233.0, 0.0109e-6), rel=1e-3)
    assert found.about_z_nm_per_rad == pytest.approx(along(18.7, 7.4e-6), rel=1e-3)
    assert found.about_y_nm_per_rad == pytest.approx(18.7**0.1 / 7.4e-6, rel=1e-3)
    assert found.about_z_nm_per_rad / found.about_y_nm_per_rad == pytest.approx(1 / 0.9, rel=5e-3)


def test_friction_torque_by_hand():
    found = cross_roller_bearing.friction_torque_nm(BEARING, CrossRollerLoad(233.0, 18.7))
    assert found == pytest.approx(0.01 * (233.0 + 2 * 18.7 / 0.1) * 0.05, rel=1e-12)


def test_bearing_errors_name_the_value():
    with pytest.raises(UserError, match=r'pitch_diameter_m is -0\.1'):
        dataclasses.replace(BEARING, pitch_diameter_m=-0.1)
    with pytest.raises(UserError, match=r'moment: load 62\.5 lies beyond the last point 50'):
        cross_roller_bearing.stiffness(BEARING, CrossRollerLoad(233.0, 50.0))


def test_drag_passes_through_both_points():
    friction = ferrofluid_seal.drag(FerrofluidSeal(0.5, 6.283), 0.3)
    assert friction.torque_nm(0.0) == pytest.approx(0.3)
    assert friction.torque_nm(-6.283) == pytest.approx(0.5)
    with pytest.raises(UserError, match=r'drag_torque_nm 0\.2 is below'):
        ferrofluid_seal.drag(FerrofluidSeal(0.2, 6.283), 0.3)
    with pytest.raises(UserError, match='drag_speed_rad_per_s'):
        FerrofluidSeal(0.2, 0.0)
