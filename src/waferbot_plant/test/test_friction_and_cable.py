# SPDX-License-Identifier: Apache-2.0
"""Friction that truly sticks and cables that only pull, against exact and event-driven motion."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.integrate import solve_ivp

from waferbot_plant import plant, statics
from waferbot_plant.plant import load_machine

MASS = 2.0
NO_VOLTAGE = np.zeros(9)


def slide(friction: dict, substeps: int = 1):
    """Return a mass of 2 kg on a horizontal slide with friction: machine, parameters, state."""
    machine = load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, 0, 0],
            substeps=substeps,
            frictions={'guide': {'coordinate': 'travel', **friction}},
        )
    )
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


def test_mass_slides_to_a_stop_and_stays() -> None:
    """v0 m / F seconds, v0^2 m / 2F metres, and then zero velocity to the last bit."""
    _, parameters, state = slide({'speed_m_s': [0], 'force_n': [4.0]})
    state[0]['velocity'][0] = 0.5
    stopped = None
    for tick in range(9000):
        plant.advance(state, parameters, NO_VOLTAGE)
        if stopped is None and state[0]['velocity'][0] == 0.0:
            stopped = tick + 1
            rest = state[0]['position'][0]
    assert stopped is not None
    assert stopped / 18000 == pytest.approx(0.5 * MASS / 4.0, abs=1 / 18000)
    assert rest == pytest.approx(0.5**2 * MASS / (2 * 4.0), rel=1e-6)
    assert state[0]['position'][0] == rest
    assert state[0]['velocity'][0] == 0.0
    assert state[0]['friction_loss'][0] == pytest.approx(0.5 * MASS * 0.5**2, rel=1e-9)


@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_sticks_exactly_below_breakaway_and_slides_above(direction: float) -> None:
    _, parameters, state = slide({'speed_m_s': [0], 'force_n': [4.0], 'breakaway': 1.5})
    for tick in range(6000):
        state[0]['external_force'][0] = direction * 5.999999 * tick / 6000
        plant.advance(state, parameters, NO_VOLTAGE)
        assert state[0]['velocity'][0] == 0.0
        assert state[0]['position'][0] == 0.0
        assert state[0]['friction_force'][0] == pytest.approx(
            -state[0]['external_force'][0], abs=1e-12
        )
    state[0]['external_force'][0] = direction * 6.000001
    for _ in range(1800):
        plant.advance(state, parameters, NO_VOLTAGE)
    acceleration = (6.000001 - 4.0) / MASS
    assert state[0]['velocity'][0] == pytest.approx(direction * acceleration * 0.1, rel=1e-9)
    assert state[0]['position'][0] == pytest.approx(direction * acceleration * 0.005, rel=1e-9)


def test_force_between_sliding_and_breakaway_keeps_a_sliding_mass_sliding() -> None:
    _, parameters, state = slide({'speed_m_s': [0], 'force_n': [4.0], 'breakaway': 1.5})
    state[0]['external_force'][0] = 5.0
    for _ in range(10):
        plant.advance(state, parameters, NO_VOLTAGE)
    assert state[0]['velocity'][0] == 0.0
    state[0]['velocity'][0] = 1e-3
    for _ in range(10):
        plant.advance(state, parameters, NO_VOLTAGE)
    assert state[0]['velocity'][0] == pytest.approx(1e-3 + 0.5 * 10 / 18000, rel=1e-9)


def test_table_is_interpolated_and_held_beyond_its_end() -> None:
    from waferbot_plant.elements import resistance_at

    _, parameters, _ = slide({'speed_m_s': [0, 0.1, 0.4], 'force_n': [4.0, 2.0, 5.0]})
    found = [
        resistance_at(parameters[0], 0, 0, speed) for speed in (0.0, 0.05, 0.1, 0.25, 0.4, 9.0)
    ]
    assert found == pytest.approx([4.0, 3.0, 2.0, 3.5, 5.0, 5.0], rel=1e-14)


def test_reversal_passes_through_zero_without_sticking_when_driven_hard() -> None:
    _, parameters, state = slide({'speed_m_s': [0], 'force_n': [1.0]})
    state[0]['velocity'][0] = 0.1
    state[0]['external_force'][0] = -30.0
    for _ in range(1800):
        plant.advance(state, parameters, NO_VOLTAGE)
    stop = 0.1 * MASS / 31.0
    assert state[0]['velocity'][0] == pytest.approx(-29.0 / MASS * (0.1 - stop), rel=1e-3)


def _drawn_mass(substeps: int):
    """Return a mass with friction, drawn through a spring by a huge one at constant speed."""
    data = machines.two_slides(
        gravity_m_s2=[0, 0, 0],
        substeps=substeps,
        transmissions={
            'spring': {
                'driving': 'first',
                'driven': 'second',
                'stages': [{'kind': 'coupling', 'connection': 'spring'}],
            }
        },
        connections={
            'spring': {'state': 'flexible', 'stiffness_n_m': 800.0, 'damping_n_s_m': 1.0}
        },
        frictions={
            'guide': {
                'coordinate': 'second',
                'speed_m_s': [0, 0.05, 0.5],
                'force_n': [6.0, 4.0, 5.0],
                'breakaway': 1.5,
            }
        },
    )
    data['bodies']['first']['mass_kg'] = 1e12
    machine = load_machine(machines.write(data))
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['velocity'][machine.coordinates.index('first')] = 0.02
    return machine, parameters, state


def _event_driven(duration: float) -> tuple[list[float], float]:
    """Return the breakaway times and final position of the same mass, found by events."""

    def resistance(speed: float) -> float:
        return float(np.interp(speed, [0, 0.05, 0.5], [6.0, 4.0, 5.0]))

    def pull(time: float, position: float, velocity: float) -> float:
        return 800.0 * (0.02 * time - position) + 1.0 * (0.02 - velocity)

    time, position = 0.0, 0.0
    breakaways = []
    while True:
        time = (9.0 - 0.02) / (800.0 * 0.02) + position / 0.02
        if time >= duration:
            return breakaways, position
        breakaways.append(time)

        def slip(t, y):
            return [y[1], (pull(t, *y) - resistance(abs(y[1]))) / MASS]

        def stop(t, y):
            return y[1] if t > breakaways[-1] + 1e-6 else 1.0

        stop.terminal = True
        stop.direction = -1
        motion = solve_ivp(
            slip,
            (time, duration),
            [position, 0.0],
            events=stop,
            rtol=1e-11,
            atol=1e-14,
            max_step=1e-3,
        )
        position = float(motion.y[0, -1])
        time = float(motion.t[-1])
        if time >= duration:
            return breakaways, position


@pytest.mark.slow
def test_stick_slip_agrees_with_an_event_driven_solution() -> None:
    """
    A mass drawn by a slow spring jerks along; every breakaway comes at the same time.

    A stop or start is known to one step, so n jerks may add up to n steps; and seen to one tick.
    """
    duration = 3.0
    expected, final = _event_driven(duration)
    assert len(expected) >= 3
    errors = []
    for substeps in (1, 4):
        machine, parameters, state = _drawn_mass(substeps)
        second = machine.coordinates.index('second')
        breakaways, stuck = [], True
        for tick in range(round(duration * 18000)):
            plant.advance(state, parameters, NO_VOLTAGE)
            moving = state[0]['velocity'][second] != 0.0
            if moving and stuck:
                breakaways.append(tick / 18000)
            stuck = not moving
        assert len(breakaways) == len(expected)
        errors.append(np.abs(np.array(breakaways) - expected).max())
        assert state[0]['position'][second] == pytest.approx(final, abs=2e-5)
    print('error of breakaway times, s', errors)
    jerks = len(expected)
    assert errors[0] < (jerks + 1) / 18000
    assert errors[1] < (jerks / 4 + 1) / 18000


@pytest.mark.slow
def test_two_frictions_on_one_coordinate_share_the_loss() -> None:
    """Payload and counterweight guide, tied by a rigid cable, stop all masses together."""
    machine = load_machine('flexible', 'rigid')
    parameters = machine.parameters()
    parameters[0]['gravity'] = 0.0
    state = machine.initial_state(parameters)
    s = state[0]
    s['terminals_open'][:] = 1
    s['velocity'][0] = 0.05
    for name, force in (('x_rotate', 1e3), ('y_rotate', 1e3)):
        place = [friction.coordinate for friction in machine.description.frictions.values()]
        parameters[0]['friction_resistance'][place.index(name), 0, 0] = force
    names = list(machine.description.frictions)
    guides = [names.index('payload_guide'), names.index('counterweight_guide')]
    resistance = parameters[0]['friction_resistance'][guides, 0, 0]
    for _ in range(9000):
        plant.advance(state, parameters, NO_VOLTAGE)
    assert s['velocity'][0] == 0.0
    mass = sum(body.mass for body in machine.description.bodies.values())
    energy = 0.5 * mass * 0.05**2
    assert s['friction_loss'][guides] == pytest.approx(
        energy * resistance / resistance.sum(), rel=1e-9
    )
    assert s['position'][0] == pytest.approx(energy / resistance.sum(), rel=1e-6)


def test_machine_at_rest_in_its_bearings_does_not_creep() -> None:
    """Balanced within friction, nothing moves: zero to the last bit on every sliding axis."""
    machine = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    s = state[0]
    s['terminals_open'][:] = 1
    for axis, force in statics.holding_forces(machine, parameters, {}).items():
        if axis != 'y_rotate':
            s['external_force'][machine.coordinates.index(axis)] = force
    rows = [machine.coordinates.index(name) for name in ('y_linear', 'x_rotate', 'counterweight')]
    for _ in range(3600):
        plant.advance(state, parameters, NO_VOLTAGE)
    assert not s['velocity'][rows].any()
    assert not s['position'][rows].any()


def _hanging_mass(substeps: int = 1, damping: float = 0.0):
    """Return a mass of 2 kg that hangs on a cable over a pulley from a huge one."""
    data = machines.two_slides(
        substeps=substeps,
        transmissions={
            'rope': {
                'driving': 'first',
                'driven': 'second',
                'stages': [{'kind': 'cable', 'connection': 'rope'}],
            }
        },
        connections={
            'rope': {'state': 'flexible', 'stiffness_n_m': 4000.0, 'damping_n_s_m': damping}
        },
    )
    data['bodies']['first']['mass_kg'] = 1e18
    machine = load_machine(machines.write(data))
    parameters = machine.parameters()
    parameters[0]['gravity'] = 0.0
    state = machine.initial_state(parameters)
    second = machine.coordinates.index('second')
    state[0]['external_force'][second] = -MASS * 9.81
    return machine, parameters, state, second


def _energy(state, second: int) -> float:
    """Return the energy of the hanging mass: motion, height, cable."""
    height = state[0]['position'][second]
    speed = state[0]['velocity'][second]
    stretch = max(0.0, MASS * 9.81 / 4000.0 - height)
    return 0.5 * MASS * speed**2 + MASS * 9.81 * height + 0.5 * 4000.0 * stretch**2


@pytest.mark.slow
def test_thrown_mass_slackens_the_cable_flies_and_is_caught() -> None:
    """Against the exact motion: harmonic while taut, a throw while slack."""
    _, parameters, state, second = _hanging_mass()
    start = 1.0
    state[0]['velocity'][second] = start
    omega = math.sqrt(4000.0 / MASS)
    slack_at = MASS * 9.81 / 4000.0
    leave = math.asin(slack_at * omega / start) / omega
    leaving_speed = start * math.cos(omega * leave)
    flight = 2.0 * leaving_speed / 9.81
    heights = []
    for _ in range(round(2.5 * (leave + flight) * 18000)):
        plant.advance(state, parameters, NO_VOLTAGE)
        heights.append(state[0]['position'][second])
    top = slack_at + leaving_speed**2 / (2.0 * 9.81)
    assert max(heights) == pytest.approx(top, rel=1e-5)
    time = np.arange(1, len(heights) + 1) / 18000
    taut_again = leave + flight
    ballistic = (time > leave) & (time < taut_again)
    free = slack_at + leaving_speed * (time - leave) - 0.5 * 9.81 * (time - leave) ** 2
    assert np.abs(np.array(heights)[ballistic] - free[ballistic]).max() < 1e-6
    caught = (time > taut_again) & (time < taut_again + math.pi / omega)
    since = time - taut_again
    harmonic = slack_at * np.cos(omega * since) - leaving_speed / omega * np.sin(omega * since)
    assert np.abs(np.array(heights)[caught] - harmonic[caught]).max() < 2e-5


@pytest.mark.slow
@pytest.mark.parametrize('speed', [0.3, 0.71, 1.3, 2.9])
def test_cable_gains_no_energy_over_many_bounces(speed: float) -> None:
    """Hundreds of slack-taut changes at any phase of the step: energy is kept to rounding."""
    _, parameters, state, second = _hanging_mass()
    state[0]['velocity'][second] = speed
    start = _energy(state, second)
    changes, taut = 0, True
    worst = 0.0
    for _ in range(60000):
        plant.advance(state, parameters, NO_VOLTAGE)
        now = state[0]['position'][second] < MASS * 9.81 / 4000.0
        changes += now != taut
        taut = now
        worst = max(worst, abs(_energy(state, second) - start))
    assert changes > 10
    assert worst < 1e-9 * abs(start)


@pytest.mark.slow
def test_damped_cable_only_pulls_and_loses_what_it_books() -> None:
    """Appendix C: damping bounded by the spring force; the ledger holds the loss."""
    _, parameters, state, second = _hanging_mass(damping=60.0)
    state[0]['velocity'][second] = 1.5
    start = _energy(state, second)
    previous = start
    for _ in range(20000):
        plant.advance(state, parameters, NO_VOLTAGE)
        assert state[0]['cable_force'][0] >= -1e-9
        energy = _energy(state, second)
        assert energy <= previous + 1e-9
        previous = energy
    assert start - previous == pytest.approx(state[0]['cable_loss'][0], rel=1e-6)
    assert state[0]['cable_force'][0] == pytest.approx(MASS * 9.81, rel=1e-2)


def test_slack_cable_lets_both_masses_go() -> None:
    """A payload pushed up faster than the counterweight falls has only gravity left."""
    machine = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    y, cw = machine.coordinates.index('y_linear'), machine.coordinates.index('counterweight')
    state[0]['position'][y] = 0.01
    force, acceleration = np.zeros(len(machine.coordinates)), np.zeros(len(machine.coordinates))
    plant.acceleration(state, parameters, force, acceleration)
    plant.generalised_forces(state, parameters, force)
    bodies = machine.description.bodies
    counterweight = bodies['counterweight'].mass
    payload = sum(body.mass for body in bodies.values()) - counterweight
    assert force[y] == pytest.approx(-payload * 9.81, rel=1e-12)
    assert force[cw] == pytest.approx(-counterweight * 9.81, rel=1e-12)
