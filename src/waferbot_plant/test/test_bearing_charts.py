# SPDX-License-Identifier: Apache-2.0
"""Bearings that follow their charts: against SciPy's curves, fine ODE solutions, statics of blocks."""

from __future__ import annotations

import math
from itertools import pairwise

import bearing_machines as bearings
import numpy as np
import plant_machines as machines
import pytest
from bearing_machines import (
    ACROSS_CHART,
    GRAVITY,
    MASS,
    MOMENT_CHART,
    OVERHANG,
    PRESSED_CHART,
    PULLED_CHART,
    RADIAL,
    RADIAL_CHART,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, loads, modes, plant, spring_curves, statics, validity
from waferbot_plant.plant import load_machine
from waferbot_plant.spring_curves import LONGEST_CURVE, SpringCurve

TICK = 1 / 18000
NO_VOLTAGE = np.zeros(9)
WEIGHT = MASS * GRAVITY


def curve_of(steps: list[tuple[float, float]]) -> SpringCurve:
    """Return the curve through points with these steps of deflection and force."""
    points = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    return SpringCurve.through(*points.T.tolist())


charts = st.lists(
    st.tuples(st.floats(0.05, 20.0), st.floats(0.05, 20.0)),
    min_size=1, max_size=LONGEST_CURVE - 1,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(charts, st.lists(st.floats(-1.5, 1.5), min_size=2, max_size=8))
def test_any_chart_makes_a_rising_odd_smooth_curve(steps, places) -> None:
    """Through its points; force rises with deflection, the inverse is one, energy is its integral."""
    curve = curve_of(steps)
    near = 1e-6 * min(width for width, _ in steps)
    stiffest = max(rise / width for width, rise in steps)
    for at, force in zip(curve.deflections, curve.forces, strict=True):
        assert curve.force(at) == pytest.approx(force, rel=1e-12)
        assert curve.deflection(-force) == pytest.approx(-at, rel=1e-12)
        ahead, behind = curve.slope(at + near), curve.slope(at - near)
        assert ahead == pytest.approx(behind, abs=1e-4 * stiffest)
    found = [place * curve.deflections[-1] for place in sorted(places)]
    for low, high in pairwise(found):
        assert curve.force(high) >= curve.force(low)
        assert curve.force(-high) == -curve.force(high)
        if high > low >= 0.0:
            kinks = [at for at in curve.deflections if low < at < high]
            expected = quad(curve.force, low, high, points=kinks or None, limit=200)[0]
            done = spring_curves.work(*curve._arrays, len(curve.forces), low, high)
            assert done == pytest.approx(expected, rel=1e-9, abs=1e-12)
    for at in found:
        assert curve.force(curve.deflection(curve.force(at))) == pytest.approx(
            curve.force(at), rel=1e-9, abs=1e-12
        )
        assert curve.slope(at) >= 0.0
    assert min(curve.slopes) > 0.0


@settings(max_examples=30, deadline=None)
@given(charts, st.floats(1e-3, 10.0), st.floats(0.0, 1.0))
def test_curves_in_series_share_the_force(steps, compliance, place) -> None:
    """Deflections add at the points; in between the sum is missed by little and never turns back."""
    curve = curve_of(steps)
    both = spring_curves.in_series([curve], compliance)
    for force in curve.forces:
        assert both.deflection(force) == pytest.approx(
            curve.deflection(force) + compliance * force, rel=1e-9
        )
    load = place * curve.forces[-1]
    low = max(force for force in curve.forces if force <= load)
    high = min(force for force in curve.forces if force >= load)
    assert both.deflection(low) <= both.deflection(load) * (1 + 1e-12)
    assert both.deflection(load) <= both.deflection(high) * (1 + 1e-12)


def test_curve_is_scipys_and_ends_straight() -> None:
    curve = SpringCurve.through([0.0, 1.0, 1.7, 3.0], [0.0, 2.0, 5.0, 6.0])
    chart = bearings.Chart([0.0, 2.0, 5.0, 6.0], [0.0, 1.0e6, 1.7e6, 3.0e6])
    for at in np.linspace(-5.0, 5.0, 41):
        assert curve.force(at) == pytest.approx(chart.force(at), rel=1e-12, abs=1e-12)
        assert curve.slope(at) == pytest.approx(chart.slope(at), rel=1e-9, abs=1e-12)
    assert curve.force(5.0) == pytest.approx(6.0 + 2.0 * curve.slopes[-1])


def test_slopes_that_would_turn_the_curve_back_are_limited() -> None:
    """Known slopes of 20 between points of slope 1 would make it fall; three times theirs does not."""
    curve = SpringCurve.through([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], slopes=[20.0, 20.0, 0.5])
    assert curve.slopes == (3.0, 3.0, 0.5)
    assert np.diff([curve.force(at) for at in np.linspace(0.0, 3.0, 400)]).min() >= 0.0


def test_end_that_pchip_makes_flat_goes_on_with_its_secant() -> None:
    curve = SpringCurve.through([0.0, 1.0, 2.0], [0.0, 10.0, 10.5])
    assert bearings.Chart([0.0, 10.0, 10.5], [0.0, 1e6, 2e6]).slope(2.0) == 0.0
    assert curve.force(4.0) == pytest.approx(10.5 + 2.0 * 0.5)
    force = [curve.force(at) for at in np.linspace(0.0, 4.0, 400)]
    assert np.diff(force).min() > 0.0


@pytest.mark.parametrize('force', [60.0, 120.0, 175.0, 450.0, 900.0, -300.0])
@pytest.mark.parametrize('weighs', [True, False])
def test_static_deflection_is_the_charts(force: float, weighs: bool) -> None:
    """Under weight and a force, from equilibrium at home; beyond the last point on its slope."""
    description = bearings.on_bearing('ring', ('radial_y',))
    description['connections']['radial_y']['loss_factor'] = 0.9
    if not weighs:
        description['gravity_m_s2'] = [0, 0, 0]
    _, parameters, state = bearings.load(description)
    state[0]['external_force'][0] = -force
    for _ in range(3000):
        plant.advance(state, parameters, NO_VOLTAGE)
    before = WEIGHT * weighs
    expected = RADIAL_CHART.deflection(before + force) - RADIAL_CHART.deflection(before)
    assert state[0]['position'][0] == pytest.approx(-expected, rel=1e-9)
    if not weighs and force in RADIAL['load_n']:
        chart = np.interp(force, RADIAL['load_n'], RADIAL['deflection_um'])
        assert state[0]['position'][0] == pytest.approx(-1e-6 * chart, rel=1e-9)


@pytest.mark.parametrize('force', [0.0, 150.0, 380.0, -170.0])
def test_small_oscillations_have_the_slope_of_the_present_load(force: float) -> None:
    """f = sqrt(local slope / m) / 2 pi, at each load another; a secant would have one."""
    _, parameters, state = bearings.load(bearings.on_bearing('ring', ('radial_y',), substeps=16))
    rest = RADIAL_CHART.deflection(WEIGHT)
    middle = RADIAL_CHART.deflection(WEIGHT + force)
    s = state[0]
    s['external_force'][0] = -force
    s['position'][0] = rest - middle
    s['velocity'][0] = 1e-7
    crossings, before, ticks = [], 0.0, 0
    while len(crossings) < 20:
        plant.advance(state, parameters, NO_VOLTAGE)
        ticks += 1
        at = s['position'][0] - (rest - middle)
        if before < 0.0 <= at:
            crossings.append((ticks - at / (at - before)) * TICK)
        before = at
    frequency = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    expected = math.sqrt(RADIAL_CHART.slope(middle) / MASS) / (2.0 * math.pi)
    print(frequency, expected)
    assert frequency == pytest.approx(expected, rel=2e-4)


def test_first_frequency_and_modes_have_the_slope_at_the_static_load() -> None:
    machine, _, _ = bearings.load(bearings.on_bearing('ring', ('radial_y',)))
    slope = RADIAL_CHART.slope(RADIAL_CHART.deflection(WEIGHT))
    expected = math.sqrt(slope / MASS) / (2.0 * math.pi)
    assert modes.first_frequencies(machine.description)['radial_y'] == pytest.approx(expected)
    assert modes.coupled_modes(machine)[-1].frequency_hz == pytest.approx(expected, rel=1e-6)


def test_large_motion_agrees_with_a_fine_solution_and_keeps_its_energy() -> None:
    """From beyond the chart's end on one side to well into the other, without damping."""
    machine, parameters, state = bearings.load(
        bearings.on_bearing('ring', ('radial_y',), substeps=8)
    )
    speed = 0.02
    state[0]['velocity'][0] = -speed
    before = audit.books(machine, state, parameters)
    found = follow(parameters, state, 1800)[:, 0]
    after = audit.books(machine, state, parameters)
    rest = RADIAL_CHART.deflection(WEIGHT)
    expected = solve_ivp(
        lambda _, y: [y[1], (WEIGHT - RADIAL_CHART.force(rest - y[0])) / MASS * -1.0 ],
        (0.0, 1800 * TICK), [0.0, -speed], rtol=1e-10, atol=1e-16, max_step=2e-5,
        t_eval=np.arange(1, 1801) * TICK,
    ).y[0]  # fmt: skip
    amplitude = np.abs(expected).max()
    assert rest + amplitude > RADIAL_CHART.end[0]
    assert expected.max() > 1.5 * rest  # the other side is reached too
    error = np.abs(found - expected).max() / amplitude
    print('error', error)
    assert error < 0.02
    energy = 0.5 * MASS * speed**2
    change = sum(after.stored.values()) - sum(before.stored.values())
    assert abs(change) < 1e-10 * energy
    assert abs(audit.imbalance(before, after)) < 1e-10 * energy


def test_a_straight_chart_moves_as_a_linear_spring_does() -> None:
    """With weight and damping, over 500 steps: the same but for rounding."""
    found = []
    for stiffness_by in ('secant', 'chart'):
        description = bearings.on_bearing('ring', ('radial_y', 'about_z'), stiffness_by)
        straight = {'load_n': [0, 300, 600], 'deflection_um': [0, 2, 4]}
        tilt = {'moment_nm': [0, 20, 40], 'tilt_urad': [0, 80, 160]}
        part = {**bearings.RING, 'radial': straight, 'moment': tilt, 'loss_factor': 0.02}
        description['parts'] = {'bearing': part}
        _, parameters, state = bearings.load(description)
        state[0]['velocity'][:2] = 0.01, 0.05
        found.append(follow(parameters, state, 500))
    assert np.abs(found[0]).max() > 1e-6
    assert np.abs(found[1] - found[0]).max() < 1e-10 * np.abs(found[0]).max()


def follow(parameters, state, ticks: int) -> np.ndarray:
    """Return the positions at every tick."""
    found = np.zeros((ticks, len(state[0]['position'])))
    for row in found:
        plant.advance(state, parameters, NO_VOLTAGE)
        row[:] = state[0]['position']
    return found


def test_stored_energy_is_the_integral_of_the_chart() -> None:
    _, parameters, state = bearings.load(bearings.on_bearing('ring', ('radial_y',)))
    found = np.zeros(4)
    rest = RADIAL_CHART.deflection(WEIGHT)
    for at in (0.0, 1.1e-6, -0.7e-6):
        state[0]['position'][0] = at
        plant.energy(state, parameters, found)
        assert found[2] == pytest.approx(RADIAL_CHART.energy(rest - at), rel=1e-9)


def blocks_moment(tilt: float, axis: str, held: float) -> float:
    """Return the moment of four blocks about an axis, from each block's force and place, Nm."""
    b_y, b_z = bearings.GUIDE['vertical_spacing_m'], bearings.GUIDE['horizontal_spacing_m']
    total = 0.0
    for up in (-1.0, 1.0):
        for side in (-1.0, 1.0):
            if axis == 'about_x':
                total += up * b_y / 2 * ACROSS_CHART.force(tilt * up * b_y / 2)
                continue
            arm = up * b_y / 2 if axis == 'about_z' else side * b_z / 2
            at = tilt * arm + (up * held if axis == 'about_y' else 0.0)
            chart = PRESSED_CHART if at > 0.0 else PULLED_CHART
            total += arm * chart.force(at)
    return total


@pytest.mark.parametrize('axis', ['about_x', 'about_y', 'about_z'])
def test_guide_answers_as_its_four_blocks_do(axis: str) -> None:
    """Exactly at the points of the charts, to the interpolation's error between; odd; static load."""
    machine, _, _ = bearings.load(bearings.on_bearing('guide', (axis,)))
    curve = machine.description.connections[axis].curve
    b_y = bearings.GUIDE['vertical_spacing_m']
    moment = WEIGHT * OVERHANG
    held = (
        bearings.brentq(
            lambda d: b_y * (PRESSED_CHART.force(d) + PULLED_CHART.force(d)) - moment, 0.0, 1e-5,
            xtol=1e-18,
        )
    )  # fmt: skip
    assert len(curve.forces) >= 5
    for tilt, force in zip(curve.deflections, curve.forces, strict=True):
        assert force == pytest.approx(blocks_moment(tilt, axis, held), rel=1e-9, abs=1e-9)
    for tilt in np.linspace(-1.0, 1.0, 31) * curve.deflections[-1]:
        assert curve.force(tilt) == pytest.approx(
            blocks_moment(tilt, axis, held), rel=0.01, abs=0.01 * curve.forces[1]
        )
    element = machine.assembly.springs[0]
    static = {'about_x': WEIGHT * 0.04, 'about_y': 0.0, 'about_z': -moment}[axis]
    assert element.static_force == pytest.approx(static, rel=1e-6, abs=1e-12)
    step = 1e-9
    if axis == 'about_y':
        slope = (blocks_moment(step, axis, held) - blocks_moment(-step, axis, held)) / (2 * step)
        assert element.stiffness == pytest.approx(slope, rel=1e-3)


def test_straight_charts_give_the_equations_of_the_thesis() -> None:
    """(5.23) to (5.25) with k_t, k_rad, k_rev of straight charts, at any tilt about x and z."""
    k_t, k_rad, k_rev = 90e6, 140e6, 110e6
    description = bearings.on_bearing('guide', ('about_x', 'about_y', 'about_z'))
    part = {**bearings.GUIDE}
    for name, stiffness in (('transverse', k_t), ('radial', k_rad), ('reverse', k_rev)):
        part[name] = {'load_n': [0, 800], 'deflection_um': [0, 800 / stiffness * 1e6]}
    description['parts'] = {'bearing': part}
    machine, _, _ = bearings.load(description)
    b_y, b_z = part['vertical_spacing_m'], part['horizontal_spacing_m']
    expected = {
        'about_x': k_t * b_y**2,
        'about_y': 0.5 * (k_rad + k_rev) * b_z**2,
        'about_z': 0.5 * (k_rad + k_rev) * b_y**2,
    }
    for name, stiffness in expected.items():
        connection = machine.description.connections[name]
        assert connection.stiffness == pytest.approx(stiffness, rel=1e-9)
        assert connection.curve.slope(1e-5) == pytest.approx(stiffness, rel=1e-9)


def test_ring_across_its_static_moment_follows_the_potential() -> None:
    """M_y = d/d phi of U(sqrt(r_0^2 + phi^2)), by a difference; slope f(r_0) / r_0."""
    machine, _, _ = bearings.load(bearings.on_bearing('ring', ('about_y', 'about_z')))
    curve = machine.description.connections['about_y'].curve
    held = MOMENT_CHART.deflection(WEIGHT * OVERHANG)
    step = 1e-9
    for tilt, moment in zip(curve.deflections[1:], curve.forces[1:], strict=True):
        if math.hypot(held, tilt) + step < MOMENT_CHART.end[0]:
            high, low = (
                MOMENT_CHART.energy(math.hypot(held, tilt + way * step)) for way in (1.0, -1.0)
            )
            assert moment == pytest.approx((high - low) / (2.0 * step), rel=1e-4)
            # and its own slope, from moments by the chart alone
            ahead, behind = (
                MOMENT_CHART.force(math.hypot(held, at)) * at / math.hypot(held, at)
                for at in (tilt + step, tilt - step)
            )
            assert curve.slope(tilt) == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-3)
    stiffness = machine.description.connections['about_y'].stiffness
    assert stiffness == pytest.approx(MOMENT_CHART.force(held) / held, rel=1e-9)
    along = machine.description.connections['about_z'].stiffness
    assert along == pytest.approx(MOMENT_CHART.slope(held), rel=1e-9)


def test_bearing_in_series_with_a_shaft_carries_the_same_force() -> None:
    description = bearings.on_bearing('ring', ('radial_y',))
    description['connections']['shaft'] = {
        'state': 'flexible', 'stiffness_n_m': 2e8, 'loss_factor': 0.0
    }  # fmt: skip
    freedoms = description['joints']['mount']['freedoms']
    freedoms['radial_y']['held_by'] = ['radial_y', 'shaft']
    machine, _, _ = bearings.load(description)
    element = machine.assembly.springs[0]
    for force in RADIAL['load_n']:
        expected = RADIAL_CHART.deflection(force) + force / 2e8
        assert element.curve.deflection(force) == pytest.approx(expected, rel=1e-9, abs=1e-18)
    assert element.static_force == pytest.approx(-WEIGHT)
    slope = 1.0 / (1.0 / RADIAL_CHART.slope(RADIAL_CHART.deflection(WEIGHT)) + 1.0 / 2e8)
    assert element.stiffness == pytest.approx(slope, rel=2e-3)
    description['connections']['shaft']['gap_m'] = 1e-6
    with pytest.raises(UserError, match='shaft must be linear'):
        bearings.load(description)


def test_secant_is_the_default_and_the_same_to_the_bit() -> None:
    given = {
        name: {'stiffness_by': 'secant'}
        for name in ('payload_bearing_x', 'x_rotate_bearing_radial', 'x_rotate_bearing_y')
    }
    plain, said = (
        load_machine('flexible', overlays=overlays).parameters()
        for overlays in ([], [{'connections': given}])
    )
    assert plain.tobytes() == said.tobytes()
    assert not plain['spring_curve_points'].any()


def test_shipped_machine_follows_its_charts_when_told_to() -> None:
    """It stands at home as before, and bears the same."""
    names = [
        name for name in load_machine('flexible').description.connections if 'bearing' in name
    ]
    told = {'connections': {name: {'stiffness_by': 'chart'} for name in names}}
    rest = []
    for overlays in ([], [told]):
        machine = load_machine('flexible', overlays=overlays)
        state, parameters = machine.at_rest()
        assert np.abs(state['position']).max() < 1e-15
        rest.append(statics.reactions(machine, state, parameters))
    for name, force in rest[0].items():
        assert rest[1][name] == pytest.approx(force, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'gap_m': 1e-6}, 'the chart is the whole law of force; gap does not go with it'),
        ({'hardening_1_m2': 1.0}, 'hardening does not go with it'),
        ({'stiffness_by': 'cubic'}, 'must be one of secant, chart'),
        ({'part': 'rod', 'direction': 'bending'}, 'part rod has no chart'),
    ],
)
def test_what_does_not_go_with_a_chart_is_told(change: dict, message: str) -> None:
    description = bearings.on_bearing('ring', ('radial_y',))
    description['parts']['rod'] = {
        'kind': 'shaft', 'outer_diameter_m': 0.1, 'inner_diameter_m': 0.0, 'length_m': 0.2,
        'elastic_modulus_pa': 2e11, 'shear_modulus_pa': 8e10, 'loss_factor': 0.0,
    }  # fmt: skip
    description['connections']['radial_y'].update(change)
    with pytest.raises(UserError, match=message):
        bearings.load(description)


def test_a_connection_of_no_part_has_no_chart() -> None:
    data = machines.single_mass(
        connections={
            'hold': {'state': 'flexible', 'stiffness_n_m': 1.0, 'damping_n_s_m': 0.0,
                     'stiffness_by': 'chart'}
        }
    )  # fmt: skip
    data['joints']['guide']['freedoms']['travel']['held_by'] = ['hold']
    del data['axes']
    with pytest.raises(UserError, match='needs a part that has a chart'):
        bearings.load(data)


@pytest.mark.parametrize(
    ('radial', 'message'),
    [
        ({'load_n': [0, 100, 90], 'deflection_um': [0, 1, 2]}, 'points must rise strictly'),
        ({'load_n': [0, 100, 200], 'deflection_um': [0, 1, 1]}, 'points must rise strictly'),
        ({'load_n': [0], 'deflection_um': [0]}, 'two at least'),
        (
            {'load_n': list(range(40)), 'deflection_um': list(range(40))},
            f'from 2 to {LONGEST_CURVE}',
        ),
    ],
)
def test_charts_that_cannot_be_followed_are_told(radial: dict, message: str) -> None:
    description = bearings.on_bearing('ring', ('radial_y',))
    description['parts'] = {'bearing': {**bearings.RING, 'radial': radial}}
    with pytest.raises(UserError, match=message):
        bearings.load(description)


def test_guide_with_too_many_points_is_told() -> None:
    description = bearings.on_bearing('guide', ('about_z',))
    many = {'load_n': list(range(20)), 'deflection_um': [0.1 * place for place in range(20)]}
    other = {'load_n': list(range(20)), 'deflection_um': [0.13 * place for place in range(20)]}
    description['parts'] = {'bearing': {**bearings.GUIDE, 'radial': many, 'reverse': other}}
    with pytest.raises(UserError, match='radial and reverse have 38 different deflections'):
        bearings.load(description)


def test_load_beyond_the_chart_is_told_and_a_secants_range_is_not_looked_at() -> None:
    description = bearings.on_bearing('ring', ('radial_y',))
    machine, parameters, state = bearings.load(description)
    rows = np.zeros((2, loads.width(3)))
    plant.find_imperfections(state[0], parameters[0])
    for row, at in zip(rows, (0.0, -3e-6), strict=True):
        state[0]['position'][0] = at
        loads.take(state, parameters, loads.begin(3), row)
    watch = validity.Watch(machine)
    watch.note(loads.Loads.of_rows(180 * np.arange(2), rows))
    (found,) = watch.extremes()
    assert found.check.what == 'radial load beside the chart'
    assert found.outside
    assert found.first_tick == 180
    beyond = RADIAL_CHART.force(RADIAL_CHART.deflection(WEIGHT) + 3e-6)
    assert found.high == pytest.approx(beyond)
    by_secant = bearings.load(bearings.on_bearing('ring', ('radial_y',), 'secant'))[0]
    checks = [check.what for check, _ in validity.checks_of(by_secant)]
    assert checks == ['radial load', 'radial load beside the chart']
