# SPDX-License-Identifier: Apache-2.0
"""Springs in combination, damping and charts, against independent calculations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import simpson, solve_ivp
from scipy.linalg import eigh

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.damping import coulomb_force, structural_damping, viscous_force
from waferbot_plant.parts.friction import SpeedFriction
from waferbot_plant.parts.load_deflection import ForceDeflection, LoadDeflection, MomentTilt
from waferbot_plant.parts.vibration import (
    free_pair_frequency,
    grounded_frequency,
    hertz,
    series_stiffness,
)

POSITIVE = st.floats(1e-3, 1e6)


def test_series_stiffness_is_the_deflection_of_a_chain():
    """Solve the chain of springs for its deflection under a unit force."""
    springs = [3.0e5, 7.0e4, 1.1e6]
    matrix = np.zeros((3, 3))
    for place, spring in enumerate(springs):
        matrix[place, place] += spring
        if place:
            matrix[place - 1, place - 1] += spring
            matrix[place - 1, place] -= spring
            matrix[place, place - 1] -= spring
    end = np.linalg.solve(matrix, [0.0, 0.0, 1.0])[-1]
    assert series_stiffness(*springs) == pytest.approx(1.0 / end, rel=1e-12)


@given(POSITIVE, POSITIVE, POSITIVE)
def test_free_pair_is_the_generalised_eigenvalue(stiffness, first, second):
    """Equation (5.15) with the sign of a coordinate turned: one zero mode, one of the pair."""
    mass = np.diag([first, second])
    spring = stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    values = eigh(spring, mass, eigvals_only=True)
    found = free_pair_frequency(stiffness, first, second)
    assert found**2 == pytest.approx(values[1], rel=1e-9)
    assert abs(values[0]) <= 1e-9 * values[1]


def test_equal_masses_give_equation_5_18():
    assert free_pair_frequency(9.0e5, 40.0, 40.0) == pytest.approx(math.sqrt(2.0 * 9.0e5 / 40.0))


def test_heavy_partner_is_a_ground():
    held = grounded_frequency(1.0e5, 2.0)
    assert free_pair_frequency(1.0e5, 2.0, 1e15) == pytest.approx(held, rel=1e-12)
    assert hertz(2.0 * math.pi) == pytest.approx(1.0)


@pytest.mark.parametrize('bad', [0.0, -1.0, math.nan, math.inf])
def test_stiffness_and_inertia_must_be_positive(bad):
    with pytest.raises(UserError, match='stiffness is'):
        grounded_frequency(bad, 1.0)
    with pytest.raises(UserError, match='second inertia'):
        free_pair_frequency(1.0, 1.0, bad)
    with pytest.raises(UserError, match='series'):
        series_stiffness(1.0, bad)


def test_structural_damping_loses_two_pi_eta_of_the_energy_in_a_forced_cycle():
    """Integrate b v^2 over one cycle of x = sin(w t); compare with 2 pi eta times k/2."""
    eta, stiffness, omega = 0.008, 7.0e6, 1500.0
    damping = structural_damping(eta, stiffness, omega)
    time = np.linspace(0.0, 2.0 * math.pi / omega, 20001)
    energy = simpson(damping * (omega * np.cos(omega * time)) ** 2, x=time)
    assert energy == pytest.approx(2.0 * math.pi * eta * stiffness / 2.0, rel=1e-6)


def test_structural_damping_decays_as_a_damping_ratio_of_half_the_loss_factor():
    """Let a damped oscillator ring and read the logarithmic decrement."""
    eta, stiffness, mass = 0.02, 4.0e4, 2.5
    omega = grounded_frequency(stiffness, mass)
    damping = structural_damping(eta, stiffness, omega)
    period = 2.0 * math.pi / (omega * math.sqrt(1.0 - (eta / 2.0) ** 2))
    ring = solve_ivp(
        lambda _, state: [state[1], -(stiffness * state[0] + damping * state[1]) / mass],
        (0.0, period),
        [1.0, 0.0],
        rtol=1e-11,
        atol=1e-13,
    )
    ratio = eta / 2.0
    decrement = 2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2)
    assert -math.log(ring.y[0, -1]) == pytest.approx(decrement, rel=1e-6)


def test_viscous_and_coulomb_forces_follow_the_velocity():
    assert viscous_force(3.0, -2.0) == -6.0
    assert coulomb_force(0.003, 1000.0, 1e-9) == pytest.approx(3.0)
    assert coulomb_force(0.003, 1000.0, -5.0) == pytest.approx(-3.0)
    assert coulomb_force(0.003, 1000.0, 0.0) == 0.0
    assert SpeedFriction(0.3, 0.02).torque_nm(-10.0) == pytest.approx(0.5)
    for bad in (
        lambda: viscous_force(-1.0, 1.0),
        lambda: coulomb_force(-0.1, 1.0, 1.0),
        lambda: coulomb_force(0.1, -1.0, 1.0),
        lambda: structural_damping(-0.1, 1.0, 1.0),
        lambda: structural_damping(0.1, 1.0, 0.0),
        lambda: SpeedFriction(-0.1, 0.0),
    ):
        with pytest.raises(UserError):
            bad()


def hertz_chart(exponent=2.0 / 3.0, scale=2.0e-8, points=41, last=2000.0):
    """Return a chart with deflection = scale * load^exponent, dense enough to stand for it."""
    loads = np.linspace(0.0, last, points)
    return LoadDeflection(tuple(loads), tuple(scale * loads**exponent), 'hertz')


def test_linear_chart_has_one_stiffness():
    chart = ForceDeflection((0.0, 100.0, 400.0), (0.0, 0.5, 2.0)).curve('linear')
    assert chart.secant_over_range(150.0, 0.3) == pytest.approx(2.0e8, rel=1e-12)
    assert chart.secant_from_zero(90.0) == pytest.approx(2.0e8, rel=1e-12)
    tilt = MomentTilt((0.0, 10.0), (0.0, 50.0)).curve('tilt')
    assert tilt.secant_from_zero(7.0) == pytest.approx(2.0e5, rel=1e-12)


def test_secants_of_a_hertzian_contact_match_the_formula():
    chart = hertz_chart()
    load, gamma, power = 700.0, 0.25, 2.0 / 3.0
    span = (load * (1 + gamma)) ** power - (load * (1 - gamma)) ** power
    assert chart.secant_over_range(load, gamma) == pytest.approx(
        2.0 * gamma * load / (2.0e-8 * span), rel=1e-3
    )
    assert chart.secant_from_zero(load) == pytest.approx(load ** (1 - power) / 2.0e-8, rel=1e-3)


def test_small_range_tends_to_the_tangent():
    chart = hertz_chart()
    load, step = 710.0, 1e-3
    tangent = 2.0 * step / (chart.deflection(load + step) - chart.deflection(load - step))
    assert chart.secant_over_range(load, 1e-4) == pytest.approx(tangent, rel=1e-6)


def test_stiffness_along_and_across_the_load_is_the_hessian_of_the_potential():
    """Differentiate the force of an isotropic bearing in two directions."""
    chart = hertz_chart(exponent=0.9)
    load = 233.0
    radius = chart.deflection(load)
    loads = np.linspace(150.0, 320.0, 4001)
    deflections = np.array([chart.deflection(value) for value in loads[::40]])

    def force(x, y):
        r = math.hypot(x, y)
        magnitude = np.interp(r, deflections, loads[::40])
        return magnitude * x / r, magnitude * y / r

    step = 1e-3 * radius
    across = (force(radius, step)[1] - force(radius, -step)[1]) / (2.0 * step)
    along = (force(radius + step, 0.0)[0] - force(radius - step, 0.0)[0]) / (2.0 * step)
    assert chart.secant_from_zero(load) == pytest.approx(across, rel=1e-3)
    assert chart.secant_over_range(load, 0.02) == pytest.approx(along, rel=1e-2)
    assert along > 1.05 * across


@given(st.lists(st.floats(0.1, 10.0), min_size=2, max_size=8), st.data())
def test_interpolation_keeps_the_order_of_the_points(steps, data):
    """Any rising chart is read as a rising curve through its points."""
    deflections = data.draw(
        st.lists(st.floats(0.1, 10.0), min_size=len(steps), max_size=len(steps))
    )
    chart = LoadDeflection(
        (0.0, *np.cumsum(steps).tolist()), (0.0, *np.cumsum(deflections).tolist())
    )
    dense = [chart.deflection(load) for load in np.linspace(0.0, 0.999 * chart.loads[-1], 50)]
    assert np.all(np.diff(dense) > 0.0)
    for load, deflection in zip(chart.loads, chart.deflections, strict=True):
        assert chart.deflection(load) == pytest.approx(deflection, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ('loads', 'deflections', 'message'),
    [
        ((0.0, 2.0, 1.0), (0.0, 1.0, 2.0), r'load 1\.0 follows 2\.0'),
        ((0.0, 1.0, 2.0), (0.0, 1.0, 1.0), 'rise strictly'),
        ((1.0, 2.0), (0.0, 1.0), 'first load is 1.0'),
        ((0.0, 1.0), (0.5, 1.0), 'first deflection is 0.5'),
        ((0.0,), (0.0,), 'two at least'),
        ((0.0, 1.0), (0.0, 1.0, 2.0), 'same number'),
        ((0.0, math.nan), (0.0, 1.0), 'finite'),
    ],
)
def test_bad_charts_are_refused(loads, deflections, message):
    with pytest.raises(UserError, match=message):
        LoadDeflection(loads, deflections)


def test_loads_outside_the_chart_are_refused():
    chart = LoadDeflection((0.0, 100.0), (0.0, 1e-6), 'radial')
    with pytest.raises(UserError, match='radial: load 101 lies beyond the last point 100'):
        chart.deflection(101.0)
    with pytest.raises(UserError, match=r'load 112\.5 lies beyond'):
        chart.secant_over_range(90.0, 0.25)
    with pytest.raises(UserError, match='negative'):
        chart.deflection(-1.0)
    for bad in (0.0, 1.0, -0.1):
        with pytest.raises(UserError, match='load variability'):
            chart.secant_over_range(50.0, bad)
    with pytest.raises(UserError, match='static load'):
        chart.secant_from_zero(0.0)
