# SPDX-License-Identifier: Apache-2.0
"""
Effects of friction on a mass on a slide, against closed forms and ordinary differential equations.

The mass has an open motor: a force from outside is what its drive makes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from waferbot_lockstep.timing import Timing
from waferbot_plant import modes, plant
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import find_description
from waferbot_twin.effects import find, frictions, library
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model

AXIS = 'y_linear'
MASS = 10.0
TICK = Timing().tick_s
NO_VOLTAGE = np.zeros(9)


def example(name: str) -> Variant:
    return Variant(name, yaml.safe_load(whole_text(find_description(name))), 'improved', {}, {})


def bare() -> Variant:
    """Return a mass of 10 kg on a slide without friction."""
    data = yaml.safe_load(whole_text(find_description('single_mass')))
    del data['frictions']
    return Variant('bare', data, 'improved', {}, {})


def typical(name: str) -> dict[str, float]:
    return find(name).typical(bare(), AXIS)


def motion(
    causes: Mapping[str, Mapping[str, float]],
    speed: float,
    force: Callable[[float], float],
    ticks: int,
) -> np.ndarray:
    """Return place and speed (ticks, 2) after each tick of the mass with these effects."""
    variant = bare()
    for name, values in causes.items():
        variant = find(name).apply(variant, AXIS, values)
    machine = variant.build(Timing())
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['terminals_open'][:] = 1
    state[0]['velocity'][0] = speed
    found = np.zeros((ticks, 2))
    for tick in range(ticks):
        state[0]['external_force'][0] = force((tick + 0.5) * TICK)
        plant.advance(state, parameters, NO_VOLTAGE)
        found[tick] = state[0]['position'][0], state[0]['velocity'][0]
    return found


def nothing(time: float) -> float:
    return 0.0


@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_damping_by_direction_slows_down_exponentially_at_its_own_rate(direction: float) -> None:
    values = {'forward': 35.0, 'backward': 12.0}
    found = motion({'direction_dependent_damping': values}, direction * 0.8, nothing, 5400)
    rate = (35.0 if direction > 0.0 else 12.0) / MASS
    time = np.arange(1, 5401) * TICK
    expected = direction * 0.8 * np.exp(-rate * time)
    assert np.abs(found[:, 1] - expected).max() < 1e-7
    place = direction * 0.8 * (1.0 - np.exp(-rate * time)) / rate
    assert np.abs(found[:, 0] - place).max() < 1e-7


def test_damping_that_is_the_same_in_both_directions_is_viscous_friction() -> None:
    def sways(time: float) -> float:
        return 20.0 * math.sin(2.0 * math.pi * 8.0 * time)

    by_direction = {'forward': 25.0, 'backward': 25.0}
    one = motion({'direction_dependent_damping': by_direction}, 0.1, sways, 5400)
    other = motion({'viscous_friction': {'damping': 25.0}}, 0.1, sways, 5400)
    assert np.abs(one - other).max() < 1e-6 * np.abs(other).max()


def test_drag_of_rolling_bearings_falls_by_palmgrens_power() -> None:
    """v^(1/3) falls evenly: v = (v_0^(1/3) - b t / (3 m))^3."""
    found = motion({'rolling_drag': {'drag': 20.0}}, 0.5, nothing, 9000)
    time = np.arange(1, 9001) * TICK
    expected = (0.5 ** (1.0 / 3.0) - 20.0 * time / (3.0 * MASS)) ** 3
    assert expected[-1] < 0.2
    assert np.abs(found[:, 1] - expected).max() < 1e-7


@pytest.mark.parametrize('name', ['velocity_strengthening_friction', 'stribeck_friction'])
def test_friction_over_speed_is_the_curve_that_it_says(name: str) -> None:
    """Against the curve itself, not its table, at speeds from rest to far beyond Stribeck's."""
    values = typical(name)
    size, speed = values.get('rise', values.get('breakaway')), values['speed']
    entry = find(name).overlay(bare(), AXIS, values).machine['frictions'][f'{AXIS}_{name}']
    at = np.linspace(0.0, 6.0 * speed, 601)
    table = np.interp(at, entry['speed_m_s'], entry['force_n'])
    falls = np.exp(-((at / speed) ** 2))
    curve = size * (1.0 - falls if 'rise' in values else falls)
    assert np.abs(table - curve).max() < 0.02 * size
    assert table[0] == (0.0 if 'rise' in values else size)


def test_friction_that_rises_with_speed_lets_go_gently_and_brakes_more_the_faster() -> None:
    """With Coulomb friction: 8 N hold, 20 N brake at speed; scipy's solution of the smooth curve."""
    values, speed = {'rise': 12.0, 'speed': 0.042}, 0.042
    both = {'coulomb_friction': {'friction': 8.0}, 'velocity_strengthening_friction': values}
    held = motion(both, 0.0, lambda time: 7.99, 200)
    assert not held.any()
    found = motion(both, 0.0, lambda time: 25.0, 3600)

    def falls(_, y):
        return [y[1], (25.0 - 8.0 - 12.0 * (1.0 - math.exp(-((y[1] / speed) ** 2)))) / MASS]

    time = np.arange(1, 3601) * TICK
    expected = solve_ivp(falls, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-13).y
    assert expected[1, -1] > 2.0 * speed
    assert np.abs(found[:, 1] - expected[1]).max() < 0.01 * expected[1, -1]
    # Friction as at speed, or as at rest, would be off by many times that.
    assert abs(5.0 / MASS * time[-1] - expected[1, -1]) > 0.05 * expected[1, -1]


def test_friction_that_rises_with_speed_leaves_presliding_as_it_is() -> None:
    """A third of what breaks away: the bristles' motion, to a fraction of its table's first point."""
    presliding = {'presliding': {'friction': 10.0, 'distance': 5e-5, 'relaxation': 0.0}}

    def sways(time: float) -> float:
        return 3.0 * math.sin(2.0 * math.pi * 10.0 * time)

    rising = {'velocity_strengthening_friction': {'rise': 5.0, 'speed': 0.042}}
    alone = motion(presliding, 0.0, sways, 3600)
    beside = motion({**presliding, **rising}, 0.0, sways, 3600)
    most = np.abs(alone[:, 0]).max()
    assert most < 5e-5
    assert np.abs(beside[:, 0] - alone[:, 0]).max() < 0.1 * most
    holding = {'stribeck_friction': {'breakaway': 5.0, 'speed': 0.03}}
    assert not motion({**presliding, **holding}, 0.0, sways, 3600).any()


@pytest.mark.parametrize(('driving', 'back_driving'), [(0.1, 0.3), (0.4, 0.7), (0.2, 0.0)])
def test_efficiency_is_what_goes_out_over_what_comes_in(
    driving: float, back_driving: float
) -> None:
    """At steady speed: the motor needs W / eta to lift a weight W, and eta W to let it down."""
    weight = 50.0
    for direction, motor in (
        (1.0, weight / (1.0 - driving)),
        (-1.0, weight * (1.0 - back_driving)),
    ):
        variant = bare()
        pulls = {'kind': 'constant', 'coordinate': 'travel', 'force_n': -weight}
        data = {**variant.machine, 'disturbances': {'weight': pulls}}
        loaded = Variant('loaded', data, 'improved', {}, {})
        values = {'driving': driving, 'back_driving': back_driving}
        machine = find('gear_efficiency').apply(loaded, AXIS, values).build(Timing())
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        state[0]['terminals_open'][:] = 1
        state[0]['velocity'][0] = direction * 0.2
        state[0]['external_force'][0] = motor
        for _ in range(900):
            plant.advance(state, parameters, NO_VOLTAGE)
        assert state[0]['velocity'][0] == pytest.approx(direction * 0.2, rel=1e-9)
        power = max(abs(motor), weight) * 0.2
        lost = driving if direction > 0.0 else back_driving
        assert state[0]['friction_loss'][0] == pytest.approx(lost * power * 900 * TICK, abs=1e-9)


def test_a_gear_that_loses_alike_both_ways_is_load_dependent_friction() -> None:
    """1 - eta = 0.2 driven by the motor, and a share of 0.2 where the load drives: eta = 1 / 1.2."""

    def sways(time: float) -> float:
        return 60.0 * math.sin(2.0 * math.pi * 5.0 * time)

    gear = {'driving': 0.2, 'back_driving': 0.2 / 1.2}
    one = motion({'gear_efficiency': gear}, 0.3, sways, 5400)
    other = motion({'load_dependent_friction': {'share': 0.2}}, 0.3, sways, 5400)
    assert np.abs(one - other).max() < 1e-9


def of_lugre(values: Mapping[str, float], force: Callable[[float], float], ticks: int):
    """Return the place (ticks,) of the mass on bristles, by scipy's Radau, from LuGre as published."""
    stiffness = values['friction'] / values['distance']
    damping = values['relaxation'] * stiffness

    def rates(time, y):
        _, v, z = y
        rate = v - abs(v) * z / values['distance']
        return [v, (force(time) - stiffness * z - damping * rate) / MASS, rate]

    time = np.arange(1, ticks + 1) * TICK
    return solve_ivp(
        rates, (0.0, time[-1]), [0.0, 0.0, 0.0], method='Radau', t_eval=time, rtol=1e-8,
        atol=[1e-13, 1e-10, 1e-13], max_step=2e-4,
    ).y[0]  # fmt: skip


def shakes(time: float) -> float:
    """Return a force of two tones, up to two thirds of what breaks away."""
    return 4.0 * math.sin(2.0 * math.pi * 13.0 * time) + 2.5 * math.sin(
        2.0 * math.pi * 24.0 * time
    )


RUBBED = {'friction': 10.0, 'distance': 5e-5, 'relaxation': 3e-3}


@pytest.mark.slow
def test_relaxation_of_presliding_is_the_damping_of_lugre() -> None:
    expected = of_lugre(RUBBED, shakes, 4500)
    found = motion({'presliding': RUBBED}, 0.0, shakes, 4500)[:, 0]
    most = np.abs(expected).max()
    assert np.abs(found - expected).max() < 2e-3 * most
    without = motion({'presliding': {**RUBBED, 'relaxation': 0.0}}, 0.0, shakes, 4500)[:, 0]
    assert np.abs(without - expected).max() > 0.1 * most


@pytest.mark.slow
def test_the_distance_of_presliding_is_found_once_its_damping_may_be() -> None:
    """A fit to LuGre by scipy: with bristles that do not damp, the distance makes up for it."""
    measured = of_lugre(RUBBED, shakes, 2700)

    def fitted(free: tuple[str, ...]) -> dict[str, float]:
        start = {'friction': 8.0, 'distance': 8e-5, 'relaxation': 0.0 if len(free) < 3 else 1e-3}

        def error(logs: np.ndarray) -> np.ndarray:
            values = {**start, **dict(zip(free, np.exp(logs), strict=True))}
            return (motion({'presliding': values}, 0.0, shakes, 2700)[:, 0] - measured) * 1e6

        first = np.log([start[name] for name in free])
        bounds = (first - math.log(10.0), first + math.log(10.0))
        found = least_squares(error, first, bounds=bounds, diff_step=1e-3, max_nfev=25)
        return {**start, **dict(zip(free, np.exp(found.x).tolist(), strict=True))}

    without, with_it = fitted(('friction', 'distance')), fitted(tuple(RUBBED))
    print('without', without, 'with', with_it)
    assert abs(without['distance'] / RUBBED['distance'] - 1.0) > 0.1
    assert with_it == pytest.approx(RUBBED, rel=0.02)


def test_a_softer_coupling_lowers_the_resonance_of_two_masses() -> None:
    """omega^2 = k (1 / J_1 + 1 / J_2), with a coupling as soft as was asked for."""
    variant = example('two_mass_drive')
    effect = find('coupling_compliance')
    assert effect.axes(variant) == ('x_rotate',)
    compliance = 3.0 / 500.0
    machine = effect.apply(variant, 'x_rotate', {'compliance': compliance}).build(Timing())
    found = modes.coupled_modes(machine)
    expected = math.sqrt((1.0 / 0.025 + 1.0 / 0.1) / compliance) / (2.0 * math.pi)
    assert max(mode.frequency_hz for mode in found) == pytest.approx(expected, rel=1e-6)


def test_only_an_arm_about_the_vertical_carries_wafers() -> None:
    effect = find('wafer')
    for model in ('rigid', 'simplified'):
        assert effect.axes(Variant.of(load_model(model))) == ('y_rotate',)
    for name in (
        'single_mass',
        'direct_drive_motor',
        'geared_pendulum',
        'two_mass_drive',
        'planar_two_link_arm',
    ):
        assert effect.axes(example(name)) == ()


def test_gears_lose_only_where_there_may_be_one() -> None:
    effect = find('gear_efficiency')
    assert effect.axes(Variant.of(load_model('rigid'))) == ('y_rotate',)
    assert effect.axes(bare()) == (AXIS,)
    for name in ('geared_pendulum', 'locked_cycloidal_drive', 'emps', 'ball_screw_stage'):
        assert len(effect.axes(example(name))) == 1, name
    for name in ('direct_drive_motor', 'solo_motor'):  # their poles turn with them
        assert effect.axes(example(name)) == (), name


def test_each_effect_has_a_title_of_its_own_that_an_engineer_would_say() -> None:
    """Short, no name of the library's making, and never that of another one."""
    titles = [effect.title for effect in library().values()]
    assert len(set(titles)) == len(titles)
    for title in titles:
        assert 0 < len(title.split()) <= 7, title
        assert '_' not in title, title
        assert not title.startswith('wrong'), title
    assert find('coulomb_friction').title == 'Coulomb friction'
    assert find('backlash').title == 'backlash'
    assert find('cogging').title == 'cogging'


def test_slots_of_friction_are_known() -> None:
    """What an effect adds is never taken for a friction of the model itself."""
    for effect in library().values():
        for axis in effect.axes(bare()):
            machine = effect.overlay(bare(), axis, effect.typical(bare(), axis)).machine
            assert set(machine.get('frictions', {})) <= set(frictions.slots(axis)), effect.name
