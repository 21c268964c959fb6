# SPDX-License-Identifier: Apache-2.0
"""Friction that follows the load of its bearing: against sums over blocks, motion by hand, energy."""

from __future__ import annotations

import math
from typing import Any

import bearing_machines as bearings
import numpy as np
import pytest
from bearing_machines import GRAVITY, MASS, OVERHANG
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, friction_laws, plant
from waferbot_plant.inverse_dynamics import InverseDynamics
from waferbot_plant.plant import load_machine

NO_VOLTAGE = np.zeros(9)
WEIGHT = MASS * GRAVITY
ASIDE = 0.04
GUIDE_SPRINGS = ('about_x', 'about_y', 'about_z')
RING_SPRINGS = ('radial_y', 'about_y', 'about_z')
SEAL = {'kind': 'ferrofluid_seal', 'drag_torque_nm': 0.5, 'drag_speed_rad_per_s': 6.0}


def guide(
    flexible: tuple[str, ...] = GUIDE_SPRINGS, coefficient: float = 0.003, **more: Any
) -> dict:
    """Return a carriage on a guide whose friction follows its load."""
    description = bearings.on_bearing('guide', flexible, 'secant', **more)
    description['parts'] = {'bearing': {**bearings.GUIDE, 'friction_coefficient': coefficient}}
    description['frictions'] = {
        'rail': {'coordinate': 'travel', 'part': 'bearing', 'load_of': 'bearing'}
    }
    return description


def ring(flexible: tuple[str, ...] = RING_SPRINGS, **more: Any) -> dict:
    """Return a load on a ring whose friction, and that of the seal about it, follows its load."""
    description = bearings.on_bearing('ring', flexible, 'secant', **more)
    description['parts'] = {'bearing': bearings.RING, 'seal': SEAL}
    description['frictions'] = {
        'seal': {'coordinate': 'turn', 'part': 'seal', 'with': 'bearing', 'load_of': 'bearing'}
    }
    return description


def friction_at(machine, parameters, position: dict[str, float]) -> float:
    """Return the sliding friction at deflections of springs by name, at rest, N or Nm."""
    state = machine.initial_state(parameters)
    s, p = state[0], parameters[0]
    plant.find_imperfections(s, p)
    for name, value in position.items():
        s['position'][machine.coordinates.index(name)] = value
    still = np.zeros(len(s['position']))
    friction_laws.limit_lawful_friction(s, p, s['position'], still, 1e-4)
    return float(s['friction_now'][0])


def forces_of(machine, position: dict[str, float]) -> dict[str, float]:
    """Return the forces of linear springs at deflections, by name."""
    return {
        element.name: element.static_force + element.stiffness * position.get(element.name, 0.0)
        for element in machine.assembly.springs
        if element.connections
    }


def sum_over_blocks(moments: dict[str, float]) -> float:
    """Return the sum of |normal| + |transverse| load over four blocks that share the moments, N."""
    b_y, b_z = bearings.GUIDE['vertical_spacing_m'], bearings.GUIDE['horizontal_spacing_m']
    total = 0.0
    for up in (-1, 1):
        for side in (-1, 1):
            normal = up * moments['about_z'] / (2 * b_y) + side * moments['about_y'] / (2 * b_z)
            total += abs(normal) + abs(moments['about_x']) / (2 * b_y)
    return total


tilts = st.floats(-3e-5, 3e-5)


@settings(max_examples=40, deadline=None)
@given(tilts, tilts, tilts)
def test_guides_friction_is_that_of_its_four_blocks(about_x, about_y, about_z) -> None:
    machine, parameters, _ = bearings.load(GUIDE)
    position = {'about_x': about_x, 'about_y': about_y, 'about_z': about_z}
    expected = 4 * 1.5 + 0.003 * sum_over_blocks(forces_of(machine, position))
    assert friction_at(machine, parameters, position) == pytest.approx(expected, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.floats(-3e-6, 3e-6), tilts, tilts)
def test_rings_friction_is_that_of_its_equivalent_load(radial_y, about_y, about_z) -> None:
    """mu P D / 2, P = F + 2 M / D; the seal's viscous drag stays a damper."""
    machine, parameters, _ = bearings.load(RING)
    position = {'radial_y': radial_y, 'about_y': about_y, 'about_z': about_z}
    forces = forces_of(machine, position)
    moment = math.hypot(forces['about_y'], forces['about_z'])
    expected = 0.01 * (abs(forces['radial_y']) + 2.0 * moment / 0.13) * 0.13 / 2.0
    assert friction_at(machine, parameters, position) == pytest.approx(expected, rel=1e-9)
    static = 0.01 * (WEIGHT + 2.0 * WEIGHT * OVERHANG / 0.13) * 0.13 / 2.0
    damper = machine.description.dampers['seal']
    assert damper.damping == pytest.approx((0.5 - static) / 6.0)


@settings(max_examples=40, deadline=None)
@given(tilts, tilts, st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_friction_grows_with_the_load(about_x, about_y, one, other) -> None:
    """Of springs without weight, all of whose loads grow together."""
    machine, parameters, _ = bearings.load(WEIGHTLESS)
    at = [
        friction_at(machine, parameters, {'about_x': scale * about_x, 'about_y': scale * about_y})
        for scale in sorted((one, other))
    ]
    assert at[1] >= at[0] >= 4 * 1.5 * (1 - 1e-12)


GUIDE, RING = guide(), ring()
WEIGHTLESS = guide(gravity_m_s2=[0, 0, 0])


@pytest.mark.parametrize('flexible', [(), ('about_x',), GUIDE_SPRINGS])
def test_at_rest_it_is_the_static_friction_whatever_gives(flexible: tuple[str, ...]) -> None:
    machine, parameters, _ = bearings.load(guide(flexible))
    static = 4 * 1.5 + 0.003 * 4 * WEIGHT * (OVERHANG + ASIDE) / (2 * 0.2)
    assert friction_at(machine, parameters, {}) == pytest.approx(static, rel=1e-6)
    assert machine.description.frictions['rail'].bearing.static == pytest.approx(
        (static - 6) / 0.003
    )
    plain = guide(flexible)
    del plain['frictions']['rail']['load_of']
    other = bearings.load(plain)[0].description.frictions['rail']
    assert other.resistances[0] == pytest.approx(static, rel=1e-9)


@pytest.mark.parametrize('flexible', [(), RING_SPRINGS])
def test_a_ring_without_a_seal_has_the_friction_of_its_load(flexible: tuple[str, ...]) -> None:
    static = 0.01 * (WEIGHT + 2.0 * WEIGHT * OVERHANG / 0.13) * 0.13 / 2.0
    description = ring(flexible)
    description['frictions'] = {'ring': {'coordinate': 'turn', 'part': 'bearing', 'factor': 3}}
    plain = bearings.load(description)[0].description.frictions['ring']
    assert plain.resistances[0] == pytest.approx(3.0 * static, rel=1e-9)
    description['frictions']['ring']['load_of'] = 'bearing'
    machine, parameters, _ = bearings.load(description)
    assert friction_at(machine, parameters, {}) == pytest.approx(3.0 * static, rel=1e-6)


@pytest.mark.parametrize('bristles', [False, True])
def test_acceleration_loads_the_guide_as_by_hand(bristles: bool) -> None:
    """
    m a = F - m g - R with R = R_0 + mu m (g + a) kappa: the weight and inertia at the overhangs load the
    blocks. Springs well damped, so that they ring for a few ms only.
    """
    coefficient, push = 0.1, 500.0
    description = guide(coefficient=coefficient)
    description['parts']['bearing']['loss_factor'] = 0.5
    if bristles:  # long bent by then
        description['frictions']['rail']['presliding'] = {'stiffness_n_m': 1e7}
    machine, parameters, state = bearings.load(description)
    s = state[0]
    place = machine.coordinates.index('travel')
    s['external_force'][place] = push
    speeds = []
    for _ in range(1800):
        plant.advance(state, parameters, NO_VOLTAGE)
        speeds.append(s['velocity'][place])
    found = (speeds[-1] - speeds[899]) / (900 / 18000)
    kappa = coefficient * 4.0 * (OVERHANG + ASIDE) / (2.0 * 0.2)
    expected = (push - WEIGHT - 6.0 - kappa * WEIGHT) / (MASS * (1.0 + kappa))
    static = (push - WEIGHT - 6.0 - kappa * WEIGHT) / MASS
    print(found, expected, static)
    assert abs(static / expected - 1.0) > 0.1
    assert found == pytest.approx(expected, rel=1e-3)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(-800.0, 800.0), min_size=8, max_size=8), st.booleans())
def test_it_never_gives_energy(pushes, presliding) -> None:
    """
    Under any forces on the axis: losses grow, and the books balance.

    In a step that ends at rest friction may hold against a force while the mean speed is half of that
    before: a loss of at most R (|push| + R) h^2 / (2 m) below zero, with any friction.
    """
    description = guide(coefficient=0.2)
    if presliding:
        description['frictions']['rail']['presliding'] = {'stiffness_n_m': 1e6}
    machine, parameters, state = bearings.load(description)
    s = state[0]
    before = audit.books(machine, state, parameters)
    lost, place = 0.0, machine.coordinates.index('travel')
    for push in pushes:
        s['external_force'][place] = WEIGHT + push
        for _ in range(40):
            plant.advance(state, parameters, NO_VOLTAGE)
            step = s['friction_loss'][0] - lost
            limit = s['friction_now'][0]  # zero with bristles, which cannot do so
            assert step >= -1e-15 - limit * (abs(push) + limit) / 18000**2 / (2.0 * MASS)
            lost += step
    assert lost >= 0.0
    after = audit.books(machine, state, parameters)
    moved = abs(s['external_work']) + sum(abs(value) for value in after.stored.values())
    assert abs(audit.imbalance(before, after)) < 1e-3 * moved


def test_a_map_is_over_the_load_of_the_bearing() -> None:
    """In N, on an axis that turns too; at rows, between them, and beyond the last."""
    rows = [[1.0, 2.0], [3.0, 6.0]]
    description = ring()
    description['frictions'] = {
        'ring': {
            'coordinate': 'turn', 'speed_rad_s': [0, 1], 'load_of': 'bearing',
            'load_n': [0, 1000], 'torque_nm': rows,
        }
    }  # fmt: skip
    machine, parameters, _ = bearings.load(description)
    found = []
    for at in (-1e-6, 0.0, 1e-6, -1e-4):
        load = sum(
            share * abs(force)
            for share, force in (
                (1.0, forces_of(machine, {'radial_y': at})['radial_y']),
                (2.0 / 0.13, WEIGHT * OVERHANG),
            )
        )
        expected = 1.0 + 2.0 * min(load, 1000.0) / 1000.0
        assert friction_at(machine, parameters, {'radial_y': at}) == pytest.approx(
            expected, rel=1e-6
        )
        found.append(expected)
    assert len(set(found)) == 4


def test_inverse_dynamics_has_the_static_load() -> None:
    description = guide()
    description['axes'] = {'y_linear': 'travel'}
    description['motors'] = {'y_linear': {'coordinate': 'travel', 'force_per_ampere_n_a': 35}}
    dynamics = InverseDynamics(bearings.load(description)[0].description)
    still = np.zeros((1, 1))
    up, down = (dynamics.forces(still, way * (still + 0.1), still)[0, 0] for way in (1, -1))
    static = 4 * 1.5 + 0.003 * 4 * WEIGHT * (OVERHANG + ASIDE) / (2 * 0.2)
    assert up - down == pytest.approx(2.0 * static, rel=1e-9)


def test_shipped_machines_friction_follows_nothing_unless_told() -> None:
    """Nothing is on by default; told to, at home it is as before, to the g of the static loads."""
    plain = load_machine('flexible')
    state, parameters = plain.at_rest()
    assert not parameters['friction_bearing'].any()
    plant.advance(state, parameters, NO_VOLTAGE)
    assert not state['any_friction_law'][0]
    told = {
        'payload_guide': {'load_of': 'payload_bearing'},
        'counterweight_guide': {'load_of': 'counterweight_bearing'},
        'x_rotate_seal_and_bearing': {'load_of': 'x_rotate_bearing'},
    }
    machine = load_machine('flexible', overlays=[{'frictions': told}])
    state, parameters = machine.at_rest()
    plant.advance(state, parameters, NO_VOLTAGE)
    for place, (name, friction) in enumerate(plain.description.frictions.items()):
        ratio = abs(parameters[0]['friction_ratio'][place])
        found = state[0]['friction_now'][place] / ratio
        if name in told:
            assert found == pytest.approx(friction.resistances[0], rel=1e-3)


@pytest.mark.parametrize(
    ('friction', 'message'),
    [
        ({'part': 'bearing', 'load_of': 'baring'}, "no part 'baring'"),
        ({'part': 'bearing', 'load_of': 'seal'}, "no connection puts part 'seal'"),
        ({'part': 'lip', 'load_of': 'bearing'}, 'bearing is not the bearing whose friction'),
        ({'part': 'bearing', 'load_of': 'bearing', 'load_n': [0, 1]}, 'has no map'),
        ({'load_of': 'bearing', 'speed_rad_s': [0], 'torque_nm': [1]}, 'load_of.*needs load_n'),
        (
            {'load_of': 'bearing', 'speed_rad_s': [0], 'load_nm': [0], 'torque_nm': [[1]]},
            'is in N: give load_n',
        ),
    ],
)
def test_what_no_load_is_known_for_is_told(friction: dict, message: str) -> None:
    description = ring()
    description['parts']['lip'] = {
        'kind': 'lip_seal', 'shaft_radius_m': 0.01, 'friction_coefficient': 0.4,
        'normal_force_n': 3.0,
    }  # fmt: skip
    description['frictions'] = {'one': {'coordinate': 'turn', **friction}}
    with pytest.raises(UserError, match=message):
        bearings.load(description)


def test_a_shaft_in_a_joint_has_no_bearing_load() -> None:
    description = ring(())
    description['parts']['rod'] = {
        'kind': 'shaft', 'outer_diameter_m': 0.1, 'inner_diameter_m': 0.0, 'length_m': 0.2,
        'elastic_modulus_pa': 2e11, 'shear_modulus_pa': 8e10, 'loss_factor': 0.0,
    }  # fmt: skip
    description['connections']['rod'] = {'state': 'rigid', 'part': 'rod', 'direction': 'bending'}
    description['joints']['mount']['freedoms']['radial_y']['held_by'] = ['radial_y', 'rod']
    description['frictions']['seal']['load_of'] = 'rod'
    with pytest.raises(UserError, match='rod is no guide and no cross-roller bearing'):
        bearings.load(description)
