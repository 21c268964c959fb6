# SPDX-License-Identifier: Apache-2.0
"""Friction beyond a table: hand formulas, fine ODE solutions, exact sticking, energy."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.integrate import solve_ivp
from test_integrator import run

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, plant
from waferbot_plant.plant import load_machine

MASS = 2.0
TICK = 1 / 18000
NO_VOLTAGE = np.zeros(9)


def slide(friction: dict, substeps: int = 1, **more):
    """Return a mass of 2 kg on a horizontal slide with friction: machine, parameters, state."""
    machine = load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, 0, 0],
            substeps=substeps,
            frictions={'guide': {'coordinate': 'travel', **friction}},
            **more,
        )
    )
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


COULOMB = {'speed_m_s': [0], 'force_n': [4.0]}


@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_direction_dependent_friction_stops_and_sticks_by_its_own_limits(direction: float) -> None:
    """4 N (1 +- 0.25): v^2 m / 2F metres to stop; sticks to the last bit below breakaway."""
    friction = {**COULOMB, 'asymmetry': 0.25, 'breakaway': 1.5}
    machine, parameters, state = slide(friction)
    limit = 4.0 * (1.0 + 0.25 * direction)
    state[0]['velocity'][0] = direction * 0.5
    before = audit.books(machine, state, parameters)
    for _ in range(9000):
        plant.advance(state, parameters, NO_VOLTAGE)
    rest = state[0]['position'][0]
    assert rest == pytest.approx(direction * 0.5**2 * MASS / (2 * limit), rel=1e-6)
    assert state[0]['friction_loss'][0] == pytest.approx(0.25, rel=1e-9)
    assert abs(audit.imbalance(before, audit.books(machine, state, parameters))) < 1e-9
    for share in (0.5, 0.999999):
        state[0]['external_force'][0] = direction * share * 1.5 * limit
        for _ in range(20):
            plant.advance(state, parameters, NO_VOLTAGE)
        assert state[0]['velocity'][0] == 0.0
        assert state[0]['position'][0] == rest
    state[0]['external_force'][0] = direction * 1.000001 * 1.5 * limit
    for _ in range(100):
        plant.advance(state, parameters, NO_VOLTAGE)
    gained = (1.000001 * 1.5 * limit - limit) / MASS * 100 * TICK
    assert state[0]['velocity'][0] == pytest.approx(direction * gained, rel=1e-9)


def test_position_dependent_friction_agrees_with_a_fine_solution() -> None:
    friction = {
        **COULOMB, 'position_amplitude': 0.6, 'position_order': 2, 'period_m': 0.1,
        'position_phase_rad': 0.4,
    }  # fmt: skip
    machine, parameters, state = slide(friction)
    state[0]['velocity'][0] = 0.9
    before = audit.books(machine, state, parameters)
    run(state, parameters, 3600, np.zeros(3), np.zeros((3600, 1)))
    after = audit.books(machine, state, parameters)
    k = 2 * math.pi * 2 / 0.1
    expected = solve_ivp(
        lambda _, y: [y[1], -4.0 * (1 + 0.6 * math.cos(k * y[0] - 0.4)) / MASS],
        (0.0, 0.2), [0.0, 0.9], rtol=1e-11, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    assert [state[0]['position'][0], state[0]['velocity'][0]] == pytest.approx(expected, rel=1e-7)
    assert abs(audit.imbalance(before, after)) < 1e-9


def test_position_dependence_never_makes_friction_drive() -> None:
    """Amplitude 3: where the factor would be below zero there is none, and none is gained."""
    friction = {**COULOMB, 'position_amplitude': 3.0, 'period_m': 0.05}
    _, parameters, state = slide(friction)
    state[0]['velocity'][0] = 1.5
    speed, free = 1.5, 0
    for _ in range(1200):
        plant.advance(state, parameters, NO_VOLTAGE)
        assert state[0]['velocity'][0] <= speed
        free += state[0]['velocity'][0] == speed
        speed = state[0]['velocity'][0]
    assert free > 100


def test_cold_friction_decays_with_its_time_constant() -> None:
    """v' = -F (1 + C exp(-t / tau)) / m in closed form."""
    _, parameters, state = slide({**COULOMB, 'cold_amplitude': 1.5, 'cold_time_s': 0.05})
    state[0]['velocity'][0] = 2.0
    ticks = 3600
    run(state, parameters, ticks, np.zeros(3), np.zeros((ticks, 1)))
    t = ticks * TICK
    expected = 2.0 - 4.0 / MASS * (t + 1.5 * 0.05 * (1 - math.exp(-t / 0.05)))
    assert state[0]['velocity'][0] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize('share', [0.0, 0.3])
def test_load_dependent_friction_takes_its_share_of_the_motors_force(share: float) -> None:
    """A locked current pushes; a = F (1 - mu) / m while the winding holds it."""
    motor = {
        'coordinate': 'travel', 'winding': 'wye', 'resistance_lead_to_lead_ohm': 1e-3,
        'inductance_lead_to_lead_h': 1e3, 'back_emf_lead_to_lead_v_s_m': 50.0,
        'electrical_cycle_m': 1e6,
    }  # fmt: skip
    friction = {'speed_m_s': [0], 'force_n': [1.0], 'per_motor_force': share}
    machine, parameters, state = slide(friction, motors={'y_linear': motor})
    from waferbot_plant import motors

    constant = motors.force_constant(machine.description.motors['y_linear'])
    motors.set_line_currents(state, parameters, 0, (0.0, -math.sqrt(0.75)))
    run(state, parameters, 100, np.zeros(3), np.zeros((100, 1)))
    force = constant * 1.0
    expected = (force * (1.0 - share) - 1.0) / MASS * 100 * TICK
    assert state[0]['velocity'][0] == pytest.approx(expected, rel=1e-4)


def test_a_force_from_outside_stands_for_that_of_an_open_motor() -> None:
    """So is a plant driven by measured currents; with closed terminals it does not count."""
    friction = {'speed_m_s': [0], 'force_n': [1.0], 'per_motor_force': 0.3}
    motor = {
        'coordinate': 'travel', 'winding': 'wye', 'resistance_lead_to_lead_ohm': 1e9,
        'inductance_lead_to_lead_h': 1e3, 'back_emf_lead_to_lead_v_s_m': 50.0,
        'electrical_cycle_m': 1e6,
    }  # fmt: skip
    for is_open, friction_force in ((1, 1.0 + 0.3 * 20.0), (0, 1.0)):
        _, parameters, state = slide(friction, motors={'y_linear': motor})
        state[0]['terminals_open'][0] = is_open
        state[0]['external_force'][0] = 20.0
        run(state, parameters, 100, np.zeros(3), np.zeros((100, 1)))
        expected = (20.0 - friction_force) / MASS * 100 * TICK
        assert state[0]['velocity'][0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize('exponent', [2.0 / 3.0, 1.0, 1.5])
@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_drag_grows_with_a_power_of_the_speed(exponent: float, direction: float) -> None:
    """m v' = -b |v|^p (1 +- a) in closed form, b from the force at a speed that is not 1."""
    drag = {'force_n': 9.0, 'at_speed_m_s': 0.5, 'exponent': exponent}
    friction = {'speed_m_s': [0], 'force_n': [0.0], 'asymmetry': 0.3, 'drag': drag}
    machine, parameters, state = slide(friction)
    state[0]['velocity'][0] = direction * 2.0
    before = audit.books(machine, state, parameters)
    run(state, parameters, 1800, np.zeros(3), np.zeros((1800, 1)))
    rate = 9.0 / 0.5**exponent * (1.0 + 0.3 * direction) / MASS
    t, left = 1800 * TICK, 1.0 - exponent
    expected = (
        2.0 * math.exp(-rate * t)
        if exponent == 1.0
        else (2.0**left - left * rate * t) ** (1.0 / left)
    )
    assert state[0]['velocity'][0] == pytest.approx(direction * expected, rel=1e-6)
    lost = 0.5 * MASS * (4.0 - state[0]['velocity'][0] ** 2)
    assert state[0]['friction_loss'][0] == pytest.approx(lost, rel=1e-9)
    assert abs(audit.imbalance(before, audit.books(machine, state, parameters))) < 1e-9


def test_drag_that_falls_off_slowly_brings_a_mass_to_rest_in_finite_time() -> None:
    """v^(1/3) = v_0^(1/3) - b t / (3 m): at rest at 3 m v_0^(1/3) / b, and no ringing about it."""
    drag = {'force_n': 6.0, 'at_speed_m_s': 1.0, 'exponent': 2.0 / 3.0}
    _, parameters, state = slide({'speed_m_s': [0], 'force_n': [0.0], 'drag': drag})
    state[0]['velocity'][0] = 0.001
    speeds = []
    for _ in range(round(0.12 / TICK)):
        plant.advance(state, parameters, NO_VOLTAGE)
        speeds.append(state[0]['velocity'][0])
    assert (np.diff(speeds) <= 0.0).all()
    at_rest = (np.flatnonzero(np.array(speeds) == 0.0)[0] + 1) * TICK
    assert at_rest == pytest.approx(3.0 * MASS * 0.001 ** (1.0 / 3.0) / 6.0, rel=1e-2)


GEAR = {'speed_m_s': [0], 'force_n': [0.0], 'per_motor_force': 0.1, 'per_motor_force_back': 0.25}
"""Efficiency 0.9 where the motor drives, and 1 / (1 + 0.25) = 0.8 where the load does."""


@pytest.mark.parametrize('turned', [1.0, -1.0])
@pytest.mark.parametrize('asymmetry', [0.0, 0.2])
def test_efficiency_of_a_gear_is_another_where_the_load_drives(
    turned: float, asymmetry: float
) -> None:
    """
    A weight of 40 N: lifted with 40 / 0.9 N, let down with 0.8 x 40 N, at constant speed; held between.

    A force on an open motor is that of the motor; the weight is a constant force.
    """
    weight = 40.0
    for direction, efficiency in ((1.0, 1.0 / 0.9), (-1.0, 0.8)):
        limit = abs(efficiency - 1.0) * weight * (1.0 + turned * direction * asymmetry)
        machine, parameters, state = slide(
            {**GEAR, 'asymmetry': asymmetry},
            motors={
                'y_linear': {
                    'coordinate': 'travel', 'winding': 'wye', 'electrical_cycle_m': 1e6,
                    'resistance_lead_to_lead_ohm': 1e9, 'inductance_lead_to_lead_h': 1e3,
                    'back_emf_lead_to_lead_v_s_m': 50.0,
                },
            },
            disturbances={
                'weight': {'kind': 'constant', 'coordinate': 'travel', 'force_n': -turned * weight}
            },
        )  # fmt: skip
        s = state[0]
        s['terminals_open'][0] = 1
        s['velocity'][0] = turned * direction * 0.05
        s['external_force'][0] = turned * efficiency * weight
        before = audit.books(machine, state, parameters)
        run(state, parameters, 200, np.zeros(3), np.zeros((200, 1)))
        net = efficiency * weight - weight - direction * limit
        if asymmetry == 0.0:
            assert net == pytest.approx(0.0, abs=1e-12)
        expected = turned * (direction * 0.05 + net / MASS * 200 * TICK)
        assert s['velocity'][0] == pytest.approx(expected, rel=1e-9)
        assert abs(audit.imbalance(before, audit.books(machine, state, parameters))) < 1e-9
        s['velocity'][0] = 0.0
        s['external_force'][0] = turned * 40.5
        place = s['position'][0]
        run(state, parameters, 200, np.zeros(3), np.zeros((200, 1)))
        assert s['velocity'][0] == 0.0
        assert s['position'][0] == place


def test_friction_at_a_gear_that_turns_the_direction_round_is_the_same() -> None:
    """Loss by the load's direction on the motor's coordinate, through a ratio below zero."""
    found = []
    for sign, back in ((1.0, 0.5), (-1.0, 0.5), (1.0, 0.1)):
        gears = {
            'coordinate': 'y_rotate_motor', 'speed_rad_s': [0.0], 'torque_nm': [0.0],
            'per_motor_force': 0.1, 'per_motor_force_back': back,
        }  # fmt: skip
        machine = load_machine('rigid', overlays=[{'frictions': {'gears': gears}}])
        parameters = machine.parameters()
        row = machine.coordinates.index('y_rotate')
        slot = list(machine.description.frictions).index('gears')
        parameters[0]['friction_ratio'][slot] *= sign
        state = machine.initial_state(parameters)
        state[0]['terminals_open'][:] = 1
        state[0]['velocity'][row] = 0.3
        state[0]['external_force'][row] = -2.0
        record = np.zeros((300, len(machine.coordinates)))
        run(state, parameters, 300, np.zeros(3), record)
        found.append(record)
    assert np.array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 1e-5


def test_presliding_slides_by_the_drag_too() -> None:
    """Steady speed where the bristles carry 4 N + b |v|^(2/3), forward and backward."""
    drag = {'force_n': 5.0, 'at_speed_m_s': 1.0, 'exponent': 2.0 / 3.0}
    presliding = {'stiffness_n_m': 1e6, 'damping_n_s_m': 10.0}
    for direction in (1.0, -1.0):
        friction = {**COULOMB, 'asymmetry': 0.1, 'presliding': presliding, 'drag': drag}
        _, parameters, state = slide(friction)
        force = (4.0 + 5.0 * 0.2 ** (2.0 / 3.0)) * (1.0 + 0.1 * direction)
        state[0]['velocity'][0] = direction * 0.2
        state[0]['bristle'][0] = direction * force / 1e6
        state[0]['external_force'][0] = direction * force
        run(state, parameters, 1800, np.zeros(3), np.zeros((1800, 1)))
        assert state[0]['velocity'][0] == pytest.approx(direction * 0.2, rel=1e-9)


def lugre(y, pull, stiffness, damping, limit, mass=MASS):
    """Return (x', v', z') of a mass with LuGre friction, as published."""
    _, v, z = y
    rate = v - stiffness * abs(v) / limit(abs(v)) * z
    return [v, (pull - stiffness * z - damping * rate) / mass, rate]


def stribeck(speed: float) -> float:
    return float(np.interp(speed, [0.0, 0.02, 0.2], [6.0, 4.0, 5.0]))


STRIBECK = {'speed_m_s': [0.0, 0.02, 0.2], 'force_n': [6.0, 4.0, 5.0]}


@pytest.mark.slow
def test_presliding_hysteresis_breakaway_and_sliding_agree_with_a_fine_solution() -> None:
    """Force up and down within presliding, then through breakaway and back: scipy's Radau."""
    stiffness, damping = 2e5, 300.0
    machine, parameters, state = slide(
        {**STRIBECK, 'presliding': {'stiffness_n_m': stiffness, 'damping_n_s_m': damping}}
    )
    before = audit.books(machine, state, parameters)

    def pull(time: float) -> float:
        grows = 3.0 if time < 0.2 else 12.0
        return grows * math.sin(2 * math.pi * 10.0 * time)

    def with_work(y, force: float):
        return [*lugre(y[:3], force, stiffness, damping, stribeck), force * y[1]]

    ticks = 7200
    found = np.zeros((ticks, 2))
    for tick in range(ticks):
        state[0]['external_force'][0] = pull((tick + 0.5) * TICK)
        plant.advance(state, parameters, NO_VOLTAGE)
        found[tick] = state[0]['position'][0], state[0]['bristle'][0]
    time = np.arange(1, ticks + 1) * TICK
    first, start = [], [0.0, 0.0, 0.0, 0.0]
    for begin, end in ((0.0, 0.2), (0.2, 0.4)):
        inside = (time > begin + 1e-9) & (time <= end + 1e-9)
        grows = 3.0 if begin == 0.0 else 12.0
        motion = solve_ivp(
            lambda t, y, grows=grows: with_work(y, grows * math.sin(2 * math.pi * 10.0 * t)),
            (begin, end), start, method='Radau', rtol=1e-9, atol=1e-13,
            t_eval=time[inside].clip(begin, end), max_step=2e-4,
        )  # fmt: skip
        first.append(motion.y[[0, 2]].T)
        start = motion.y[:, -1]
    expected = np.concatenate(first)
    small, all_of_it = np.abs(expected[:3600, 0]).max(), np.abs(expected[:, 0]).max()
    assert small < 3.0 / stiffness * 2.5
    assert all_of_it > 100 * small
    errors = np.abs(found - expected)
    print('errors', errors[:3600, 0].max() / small, errors[:, 0].max() / all_of_it)
    assert errors[:3600, 0].max() < 1e-3 * small
    assert errors[:, 0].max() < 1e-3 * all_of_it
    after = audit.books(machine, state, parameters)
    assert abs(audit.imbalance(before, after)) < 1e-9 * after.supplied['outside']
    lost = start[3] - 0.5 * MASS * start[1] ** 2 - 0.5 * stiffness * start[2] ** 2
    assert after.lost['guide dry friction'] == pytest.approx(lost, rel=1e-4)


def test_presliding_is_of_second_order() -> None:
    """Half the step, a quarter of the error, within presliding, at smooth motion."""
    stiffness, damping = 2e5, 300.0
    ends = []
    for substeps in (2, 4, 8, 64):
        _, parameters, state = slide(
            {**COULOMB, 'presliding': {'stiffness_n_m': stiffness, 'damping_n_s_m': damping}},
            substeps=substeps,
        )
        state[0]['velocity'][0] = 0.05
        run(state, parameters, 60, np.zeros(3), np.zeros((60, 1)))
        ends.append(state[0]['position'][0])
    errors = np.abs(np.array(ends[:-1]) - ends[-1])
    print('errors', errors)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.25)


@pytest.mark.parametrize('stiffness', [1e5, 1e8, 1e11])
def test_presliding_slides_steadily_by_its_table_at_any_stiffness(stiffness: float) -> None:
    """Drawn at 0.1 m/s by a huge mass's worth of force; F = R(v), no ringing, z = R / sigma_0."""
    _, parameters, state = slide(
        {**STRIBECK, 'presliding': {'stiffness_n_m': stiffness, 'damping_n_s_m': 10.0}}
    )
    state[0]['velocity'][0] = 0.1
    state[0]['external_force'][0] = stribeck(0.1)
    state[0]['bristle'][0] = stribeck(0.1) / stiffness
    run(state, parameters, 1800, np.zeros(3), np.zeros((1800, 1)))
    assert state[0]['velocity'][0] == pytest.approx(0.1, rel=1e-9)
    assert state[0]['bristle'][0] == pytest.approx(stribeck(0.1) / stiffness, rel=1e-9)
    state[0]['external_force'][0] = 0.0
    state[0]['bristle'][0] = 0.0
    for _ in range(9000):
        plant.advance(state, parameters, NO_VOLTAGE)
        assert abs(state[0]['velocity'][0]) < 0.11
    assert abs(state[0]['velocity'][0]) < 1e-3


def test_presliding_loop_closes_as_the_model_does() -> None:
    """Slow reversal from full slip: F goes from R to -R as 1 - 2 exp(-sigma x / R), (Dahl)."""
    stiffness = 1e5
    _, parameters, state = slide(
        {**COULOMB, 'presliding': {'stiffness_n_m': stiffness, 'damping_n_s_m': 0.0}}
    )
    parameters[0]['mass'] *= 1e6
    s = state[0]
    s['bristle'][0] = 4.0 / stiffness
    s['velocity'][0] = s['velocity_change'][0] = 0.0
    s['velocity'][0] = -1e-3
    start = s['position'][0]
    for _ in range(2000):
        plant.advance(state, parameters, NO_VOLTAGE)
        back = start - s['position'][0]
        expected = 4.0 * (2.0 * math.exp(-stiffness * back / 4.0) - 1.0)
        assert stiffness * s['bristle'][0] == pytest.approx(expected, abs=1e-4)
    assert back > 8.0 / stiffness


def test_laws_on_a_tied_coordinate_act_on_what_it_is_tied_to() -> None:
    """
    Rubbing at the counterweight and the motor, or at carriage and table: the same motion.

    The cable turns the direction round, so forward there is backward here; the gears multiply by 48.
    """
    ratio = load_machine('rigid').description.transmissions['y_rotate_drive'].ratio
    there = {
        'counterweight_guide': {
            'coordinate': 'counterweight', 'speed_m_s': [0.0], 'force_n': [30.0], 'asymmetry': 0.5,
        },
        'gears': {
            'coordinate': 'y_rotate_motor', 'speed_rad_s': [0.0], 'torque_nm': [0.05],
            'asymmetry': -0.3,
        },
    }  # fmt: skip
    here = {
        'counterweight_guide': {
            **there['counterweight_guide'], 'coordinate': 'y_linear', 'asymmetry': -0.5,
        },
        'gears': {**there['gears'], 'coordinate': 'y_rotate', 'torque_nm': [0.05 / ratio]},
    }  # fmt: skip
    found = []
    for frictions in (there, here):
        machine = load_machine('rigid', overlays=[{'frictions': frictions}])
        parameters = machine.parameters()
        state = machine.initial_state(parameters, {}, holding=True)
        record = np.zeros((4000, len(machine.coordinates)))
        before = audit.books(machine, state, parameters)
        run(state, parameters, 4000, np.array([60.0, 60.0, 20.0]), record)
        after = audit.books(machine, state, parameters)
        supplied = sum(after.supplied.values())
        assert abs(audit.imbalance(before, after)) < 1e-6 * abs(supplied)
        losses = audit.loss_powers(before, after, 4000 * TICK)
        assert losses['counterweight_guide dry friction'] > 0.0
        assert losses['gears dry friction'] > 0.0
        found.append(record)
    assert (np.abs(found[0]).max(axis=0) > 1e-3).all()
    assert (np.abs(found[0] - found[1]) / np.abs(found[0]).max(axis=0)).max() < 1e-9


def test_taking_the_law_away_while_it_runs_leaves_the_table() -> None:
    _, parameters, state = slide({**COULOMB, 'asymmetry': 0.5})
    state[0]['velocity'][0] = 0.5
    run(state, parameters, 10, np.zeros(3), np.zeros((10, 1)))
    parameters[0]['friction_asymmetry'] = 0.0
    before = state[0]['velocity'][0]
    run(state, parameters, 10, np.zeros(3), np.zeros((10, 1)))
    assert state[0]['velocity'][0] == pytest.approx(before - 4.0 / MASS * 10 * TICK, rel=1e-12)


@pytest.mark.parametrize(
    ('law', 'message'),
    [
        ({'asymmetry': 1.5}, 'asymmetry: is 1.5; it must be at most 1'),
        ({'position_amplitude': 0.5}, 'period_m missing'),
        ({'position_amplitude': 0.5, 'period_rad': 1.0}, 'wrong unit.*give period_m'),
        ({'period_m': 0.5}, 'period_m: goes with position_amplitude'),
        ({'cold_amplitude': 1.0}, 'give both cold_amplitude and cold_time_s'),
        ({'drag': {'at_speed_m_s': 1.0}}, 'drag: force_n missing'),
        ({'drag': {'force_n': 1.0}}, 'drag: at_speed_m_s missing'),
        ({'drag': {'torque_nm': 1.0, 'at_speed_m_s': 1.0}}, 'wrong unit.*give force_n'),
        ({'presliding': {}}, 'presliding: stiffness_n_m missing'),
        ({'presliding': {'stiffness_n_m': 1.0}, 'breakaway': 1.5}, 'breakaway: friction with pre'),
    ],
)
def test_mistakes_are_named(law: dict, message: str) -> None:
    with pytest.raises(
        UserError, match=rf'machine_\d+.yaml, line \d+: frictions.guide.*{message}'
    ):
        slide({**COULOMB, **law})
