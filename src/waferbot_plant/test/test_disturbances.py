# SPDX-License-Identifier: Apache-2.0
"""Forces from outside and a shaking floor, against closed forms, ODE solutions and statistics."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.integrate import solve_ivp
from test_integrator import run

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, plant, statics
from waferbot_plant.plant import load_machine

MASS = 2.0
TICK = 1 / 18000
NO_VOLTAGE = np.zeros(9)


def slide(force: dict | None, substeps: int = 1, **more):
    """Return a free mass of 2 kg with a force on it: machine, parameters, state."""
    if force is not None:
        more['disturbances'] = {'force': {'coordinate': 'travel', **force}}
    machine = load_machine(
        machines.write_single_mass(gravity_m_s2=[0, 0, 0], substeps=substeps, **more)
    )
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


def advance(state, parameters, ticks: int) -> None:
    """Advance by so many ticks without voltage."""
    run(state, parameters, ticks, np.zeros(3), np.zeros((ticks, 1)))


def test_constant_force_accelerates_evenly_and_its_work_is_booked() -> None:
    machine, parameters, state = slide({'kind': 'constant', 'force_n': 3.0})
    before = audit.books(machine, state, parameters)
    advance(state, parameters, 18000)
    assert state[0]['velocity'][0] == pytest.approx(1.5, rel=1e-12)
    assert state[0]['position'][0] == pytest.approx(0.75, rel=1e-12)
    after = audit.books(machine, state, parameters)
    assert after.supplied['force disturbance'] == pytest.approx(3.0 * 0.75, rel=1e-12)
    rounding = 18000 * np.finfo(float).eps * after.supplied['force disturbance']
    assert abs(audit.imbalance(before, after)) < rounding


@pytest.mark.parametrize('order', [1, 3])
def test_periodic_force_is_a_potential(order: int) -> None:
    """Against solve_ivp; and what it takes while the mass runs over it, it gives back."""
    cosine, sine, period = 4.0, -7.0, 0.032
    machine, parameters, state = slide(
        {
            'kind': 'periodic', 'period_m': period, 'order': order,
            'cosine_n': cosine, 'sine_n': sine,
        }
    )  # fmt: skip
    state[0]['velocity'][0] = 0.3
    before = audit.books(machine, state, parameters)
    advance(state, parameters, 9000)
    after = audit.books(machine, state, parameters)
    k = 2 * math.pi * order / period
    expected = solve_ivp(
        lambda _, y: [y[1], (cosine * math.cos(k * y[0]) + sine * math.sin(k * y[0])) / MASS],
        (0.0, 0.5), [0.0, 0.3], rtol=1e-11, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    assert state[0]['position'][0] == pytest.approx(expected[0], rel=1e-6)
    assert state[0]['velocity'][0] == pytest.approx(expected[1], rel=1e-5)
    assert abs(audit.imbalance(before, after)) < 1e-6 * 0.5 * MASS * 0.3**2
    assert 'force disturbance' not in after.supplied


def _table_force(over: str, at: list[float], force: list[float]) -> dict:
    unit = {'position': 'at_m', 'velocity': 'at_m_s', 'time': 'at_s'}[over]
    return {'kind': 'table', 'over': over, unit: at, 'force_n': force}


@pytest.mark.parametrize('over', ['position', 'velocity', 'time'])
def test_table_agrees_with_a_fine_solution(over: str) -> None:
    at, force = [-0.01, 0.05, 0.1, 0.2], [2.0, -3.0, 4.0, 1.0]
    _, parameters, state = slide(_table_force(over, at, force))
    state[0]['velocity'][0] = 0.2
    ticks = 9000
    advance(state, parameters, ticks)
    pick = {'position': 1, 'velocity': 2, 'time': 0}[over]
    expected = solve_ivp(
        lambda t, y: [y[1], float(np.interp((t, *y)[pick], at, force)) / MASS],
        (0.0, ticks * TICK), [0.0, 0.2], rtol=1e-10, atol=1e-13, max_step=1e-3,
    ).y[:, -1]  # fmt: skip
    assert [state[0]['position'][0], state[0]['velocity'][0]] == pytest.approx(expected, abs=2e-7)


def test_forces_keep_the_second_order() -> None:
    """Half the step, a quarter of the error, for a force over position and time together."""
    errors = []
    for substeps in (1, 2, 4):
        _, parameters, state = slide(
            {'kind': 'periodic', 'period_m': 0.01, 'cosine_n': 300.0}, substeps=substeps
        )
        state[0]['velocity'][0] = 0.5
        advance(state, parameters, 500)
        k = 2 * math.pi / 0.01
        expected = solve_ivp(
            lambda _, y, k=k: [y[1], 300.0 * math.cos(k * y[0]) / MASS],
            (0.0, 500 * TICK), [0.0, 0.5], rtol=1e-12, atol=1e-14,
        ).y[0, -1]  # fmt: skip
        errors.append(abs(state[0]['position'][0] - expected))
    print('errors', errors)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_steep_damping_table_is_stable_and_exact_for_the_midpoint_rule() -> None:
    """1e6 N s/m on 2 kg: v shrinks by (1 - x) / (1 + x) each step, x = h d / 2 m."""
    _, parameters, state = slide(_table_force('velocity', [-1.0, 1.0], [1e6, -1e6]))
    state[0]['velocity'][0] = 0.5
    x = TICK * 1e6 / (2 * MASS)
    for tick in range(1, 4):
        plant.advance(state, parameters, NO_VOLTAGE)
        expected = 0.5 * ((1 - x) / (1 + x)) ** tick
        assert state[0]['velocity'][0] == pytest.approx(expected, rel=1e-9)


def test_noise_has_its_deviation_and_correlation_and_comes_again() -> None:
    rms, bandwidth, ticks = 5.0, 200.0, 150_000
    force = {'kind': 'noise', 'rms_n': rms, 'bandwidth_hz': bandwidth, 'seed': 12}
    _, parameters, state = slide(force)
    speed = np.zeros(ticks + 1)
    for tick in range(ticks):
        plant.advance(state, parameters, NO_VOLTAGE)
        speed[tick + 1] = state[0]['velocity'][0]
    found = np.diff(speed) * MASS / TICK
    pole = math.exp(-2 * math.pi * bandwidth * TICK)
    effective = ticks * (1 - pole) / (1 + pole)
    assert abs(found.mean()) < 4 * rms / math.sqrt(effective)
    assert found.std() == pytest.approx(rms, rel=4 / math.sqrt(effective))
    for lag in (1, 10, 30):
        correlation = np.corrcoef(found[lag:], found[:-lag])[0, 1]
        assert correlation == pytest.approx(pole**lag, abs=4 / math.sqrt(effective))
    begin = found[:300].copy()
    _, parameters, again = slide(force)
    advance(again, parameters, 300)
    assert again[0]['velocity'][0] == speed[300]
    _, parameters, other = slide({**force, 'seed': 13})
    advance(other, parameters, 300)
    assert other[0]['velocity'][0] != speed[300]
    assert np.abs(begin).max() > 0.5 * rms


def test_noise_is_held_over_the_substeps_of_a_tick() -> None:
    """More substeps, the same noise: a free mass moves the same, to rounding."""
    ends = []
    for substeps in (1, 4):
        force = {'kind': 'noise', 'rms_n': 5.0, 'bandwidth_hz': 50.0, 'seed': 3}
        _, parameters, state = slide(force, substeps=substeps)
        advance(state, parameters, 1000)
        ends.append(state[0]['velocity'][0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)


def test_shaking_floor_drives_an_oscillator_as_the_textbook_says() -> None:
    """
    e'' + omega^2 e = -A sin(w t + phase), from rest, in closed form.

    The error is the midpoint rule's: its frequency is low by (omega h)^2 / 12, which turns the
    free part by omega t times that; and a quarter of it with half the step.
    """
    omega, w, phase = math.sqrt(8000.0 / MASS), 2 * math.pi * 7.0, 0.4
    gain = -0.3 / (omega**2 - w**2)
    a, b = -gain * math.sin(phase), -gain * w * math.cos(phase) / omega
    t = 9000 * TICK
    expected = gain * math.sin(w * t + phase) + a * math.cos(omega * t) + b * math.sin(omega * t)
    errors = []
    for substeps in (1, 2):
        data = machines.single_mass(
            gravity_m_s2=[0, 0, 0],
            substeps=substeps,
            connections={
                'hold': {'state': 'flexible', 'stiffness_n_m': 8000.0, 'damping_n_s_m': 0.0}
            },
            vibration={'frequency_hz': 7.0, 'acceleration_m_s2': [5, 0.3, 9], 'phase_rad': 0.4},
        )
        data['joints']['guide']['freedoms']['travel']['held_by'] = ['hold']
        del data['axes']
        machine = load_machine(machines.write(data))
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        before = audit.books(machine, state, parameters)
        advance(state, parameters, 9000)
        errors.append(abs(state[0]['position'][0] - expected))
        after = audit.books(machine, state, parameters)
        assert after.supplied['floor'] > 1e-5
        assert abs(audit.imbalance(before, after)) < 1e-9 * after.supplied['floor']
    turned = omega * t * (omega * TICK) ** 2 / 12
    assert errors[0] < 1.5 * turned * math.hypot(a, b)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_shaking_floor_is_gravity_less_its_acceleration_on_any_tree() -> None:
    """One step of a random tree: as if gravity were g - a at the middle of the step."""
    seed = np.random.SeedSequence().entropy
    print('seed', seed)
    random = np.random.default_rng(seed)
    tree = machines.random_tree(random, 6)
    shake = random.normal(0.0, 3.0, 3)
    phase = 0.7
    wave = math.sin(2 * math.pi * 50.0 * 0.5 * TICK + phase)
    shaken = load_machine(
        machines.write(
            {
                **tree,
                'vibration': {
                    'frequency_hz': 50.0, 'acceleration_m_s2': shake.tolist(), 'phase_rad': phase,
                },
            }
        )
    )  # fmt: skip
    gravity = (np.array(tree['gravity_m_s2']) - shake * wave).tolist()
    tilted = load_machine(machines.write({**tree, 'gravity_m_s2': gravity}))
    q, v = random.normal(0.0, 1.0, (2, 6))
    speeds = []
    for machine in (shaken, tilted):
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        state[0]['position'][: len(q)], state[0]['velocity'][: len(v)] = q, v
        plant.advance(state, parameters, NO_VOLTAGE)
        speeds.append(state[0]['velocity'][:6] - v)
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-8, abs=1e-13)


def test_constant_force_is_held_by_the_motor_at_the_start() -> None:
    machine = load_machine(
        'flexible',
        overlays=[
            {'disturbances': {
                'push': {'kind': 'constant', 'coordinate': 'y_linear', 'force_n': 25.0}
            }}
        ],
    )  # fmt: skip
    plain = load_machine('flexible')
    pushed = statics.holding_forces(machine, machine.parameters(), {})
    free = statics.holding_forces(plain, plain.parameters(), {})
    assert pushed['y_linear'] - free['y_linear'] == pytest.approx(-25.0, rel=1e-9)


@pytest.mark.parametrize(
    ('force', 'message'),
    [
        ({'kind': 'constant'}, 'force_n missing'),
        ({'kind': 'constant', 'torque_nm': 1.0}, 'wrong unit.*give force_n'),
        ({'kind': 'constant', 'force_n': 1.0, 'seed': 1}, 'seed: a constant force has no such'),
        ({'kind': 'periodic', 'cosine_n': 1.0}, 'period_m missing'),
        ({'kind': 'noise', 'rms_n': 1.0, 'bandwidth_hz': 5.0}, 'seed missing'),
        ({'kind': 'table', 'at_m': [0], 'force_n': [1]}, 'over missing'),
        ({'kind': 'table', 'over': 'time', 'at_m': [0], 'force_n': [1]}, 'takes at_s'),
        ({'kind': 'table', 'over': 'time', 'at_s': [0, 0], 'force_n': [1, 2]}, 'must rise'),
        ({'kind': 'table', 'over': 'time', 'at_s': [0, 1], 'force_n': [1]}, '2 points but 1'),
        ({'kind': 'wind', 'force_n': 1.0}, 'must be one of constant'),
        ({'kind': 'constant', 'force_n': [1.0]}, 'must be a number'),
    ],
)  # fmt: skip
def test_mistakes_are_named(force: dict, message: str) -> None:
    with pytest.raises(
        UserError, match=rf'machine_\d+.yaml, line \d+: disturbances.force.*{message}'
    ):
        slide(force)


def test_too_many_forces_are_refused() -> None:
    many = {
        f'force_{number}': {'kind': 'constant', 'coordinate': 'travel', 'force_n': 0.0}
        for number in range(25)
    }
    with pytest.raises(UserError, match='there are 25; at most 24'):
        load_machine(machines.write_single_mass(disturbances=many))
