# SPDX-License-Identifier: Apache-2.0
"""Cables and guides of the Y-Linear axis, equations (5.1) to (5.25)."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.linalg import eigh

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts import cable, linear_bearing
from waferbot_plant.parts.linear_bearing import BlockLoad, LinearBearing
from waferbot_plant.parts.load_deflection import ForceDeflection
from waferbot_plant.parts.vibration import free_pair_frequency

CABLE = cable.Cable(
    nominal_diameter_m=0.0032,
    elastic_modulus_pa=193e9,
    cable_length_m=1.9,
    pulley_radius_m=0.08,
    number_of_cables=2,
    loss_factor=0.001,
)


def test_metallic_area_is_that_of_the_wires_counted_one_by_one():
    """Place 133 wires in seven strands; they fill the diameter and do not overlap."""
    diameter = 0.0032
    wire = diameter / 15.0
    strand = [(0.0, 0.0)]
    strand += [(wire * math.cos(a), wire * math.sin(a)) for a in np.arange(6) * math.pi / 3]
    for index in range(12):
        angle = index * math.pi / 6
        radius = 2.0 * wire
        strand.append((radius * math.cos(angle), radius * math.sin(angle)))
    centres = [(0.0, 0.0)] + [
        (5 * wire * math.cos(a), 5 * wire * math.sin(a)) for a in np.arange(6) * math.pi / 3
    ]
    wires = np.array([(cx + x, cy + y) for cx, cy in centres for x, y in strand])
    assert len(wires) == 133
    assert np.hypot(*wires.T).max() + wire / 2 == pytest.approx(diameter / 2, rel=1e-12)
    area = len(wires) * math.pi * (wire / 2) ** 2
    assert cable.metallic_area_7x19_m2(diameter) == pytest.approx(area, rel=1e-12)
    assert 0.46 < area / diameter**2 < 0.49


def test_effective_stiffness_by_hand():
    """E A/(L - pi r) for each of two cables: 193 GPa, 4.7543 mm2, 1.64867 m."""
    by_hand = 2 * 193e9 * 133 * math.pi / 4 * (0.0032 / 15) ** 2 / (1.9 - 0.08 * math.pi)
    assert by_hand == pytest.approx(1.1131e6, rel=1e-4)
    assert cable.effective_stiffness_n_per_m(CABLE) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize('payload_side', [0.1, 0.7, 1.5])
def test_stiffness_does_not_depend_on_the_position_of_the_payload(payload_side):
    """Two sides E A/L1 and E A/L2 in series, solved as a chain."""
    area = cable.metallic_area_7x19_m2(CABLE.nominal_diameter_m)
    rest = cable.free_length_m(CABLE.cable_length_m, CABLE.pulley_radius_m) - payload_side
    first, second = 193e9 * area / payload_side, 193e9 * area / rest
    chain = np.array([[first + second, -second], [-second, second]])
    stretch = np.linalg.solve(chain, [0.0, 1.0])[1]
    one_cable = cable.effective_stiffness_n_per_m(CABLE) / 2
    assert one_cable == pytest.approx(1.0 / stretch, rel=1e-10)


@pytest.mark.parametrize('counterweight_kg', [20.0, 40.0, 63.0])
def test_cable_frequency_is_the_eigenvalue_of_5_15(counterweight_kg):
    """The thesis' matrices with both coordinates up: modes (1, -1) at zero and, equal, (1, 1)."""
    stiffness = cable.effective_stiffness_n_per_m(CABLE)
    values, modes = eigh(stiffness * np.ones((2, 2)), np.diag([40.0, counterweight_kg]))
    found = free_pair_frequency(stiffness, 40.0, counterweight_kg)
    assert found**2 == pytest.approx(values[1], rel=1e-10)
    assert modes[0, 0] == pytest.approx(-modes[1, 0])


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'nominal_diameter_m': -0.003}, r'nominal_diameter_m is -0\.003'),
        ({'elastic_modulus_pa': 0.0}, 'elastic_modulus_pa'),
        ({'cable_length_m': 0.25}, 'not longer than the half turn'),
        ({'number_of_cables': 1.5}, 'number_of_cables is 1.5'),
        ({'loss_factor': -0.1}, 'loss_factor'),
    ],
)
def test_bad_cables_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(CABLE, **change)


def chart(stiffness_n_per_um):
    """Return a linear chart up to 2000 N."""
    return ForceDeflection(
        (0.0, 1000.0, 2000.0), tuple(v / stiffness_n_per_um for v in (0, 1e3, 2e3))
    )


GUIDE = LinearBearing(
    vertical_spacing_m=0.19,
    horizontal_spacing_m=0.23,
    radial=chart(200.0),
    reverse=chart(170.0),
    transverse=chart(140.0),
    load_variability=0.25,
    friction_coefficient=0.003,
    seal_force_per_block_n=1.5,
    loss_factor=0.008,
)


def test_moment_stiffness_is_that_of_four_springs_in_space():
    """Rotate the carriage a little about each axis; sum the moments of the block forces."""
    found = linear_bearing.moment_stiffness(GUIDE, BlockLoad(300.0, 100.0))
    half_y, half_z = 0.19 / 2, 0.23 / 2
    for axis, value in (
        (0, found.about_x_nm_per_rad),
        (1, found.about_y_nm_per_rad),
        (2, found.about_z_nm_per_rad),
    ):
        rotation = np.zeros(3)
        rotation[axis] = 1e-6
        moment = np.zeros(3)
        for y in (-half_y, half_y):
            for z in (-half_z, half_z):
                place = np.array([0.0, y, z])
                shift = np.cross(rotation, place)
                normal = 200e6 if shift[0] < 0 else 170e6  # pressed on the rail, or pulled off
                force = -np.array([normal * shift[0], 0.0, 140e6 * shift[2]])
                moment += np.cross(place, force)
        # Along y the blocks run free on the rails.
        assert value == pytest.approx(-moment[axis] / 1e-6, rel=1e-9)


def test_static_block_loads_balance_the_weight():
    """The forces of four blocks at +-b_y/2 must make the moments of the weight about z and x."""
    mass, p_x, p_z, spacing, gravity = 40.0, 0.227, -0.0615, 0.19, 9.80665
    load = linear_bearing.static_block_load(mass, p_x, p_z, spacing, gravity)
    assert 4 * load.radial_n * spacing / 2 == pytest.approx(mass * gravity * p_x, rel=1e-12)
    assert 4 * load.transverse_n * spacing / 2 == pytest.approx(
        mass * gravity * abs(p_z), rel=1e-12
    )
    assert min(load.radial_n, load.transverse_n) > 0.0


def test_travel_friction_by_hand():
    found = linear_bearing.travel_friction_n(GUIDE, BlockLoad(300.0, 100.0))
    assert found == pytest.approx(0.003 * 1600.0 + 6.0, rel=1e-12)


def test_guide_errors_name_the_value():
    with pytest.raises(UserError, match='vertical_spacing_m is 0'):
        dataclasses.replace(GUIDE, vertical_spacing_m=0)
    with pytest.raises(UserError, match=r'load_variability is 1\.2'):
        dataclasses.replace(GUIDE, load_variability=1.2)
    with pytest.raises(UserError, match='transverse: load 2500 lies beyond'):
        linear_bearing.moment_stiffness(GUIDE, BlockLoad(300.0, 2000.0))
    with pytest.raises(UserError, match=r'transverse: static load is 0\.0'):
        linear_bearing.moment_stiffness(GUIDE, BlockLoad(300.0, 0.0))
