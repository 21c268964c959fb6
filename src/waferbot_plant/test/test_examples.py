# SPDX-License-Identifier: Apache-2.0
"""The same code on other machines, each against its textbook solution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_plant import modes, motors, plant, statics
from waferbot_plant.plant import load_machine


@pytest.mark.slow
def test_single_mass_on_a_motor_reaches_the_speed_of_theory() -> None:
    """
    The step of a synchronous motor whose voltages turn with its electrical angle.

    In the frame that turns along: L di_q/dt = u - R i_q - k v - omega L i_d, L di_d/dt = omega L
    i_q - R i_d, m dv/dt = K i_q, solved here by small explicit steps.
    """
    machine = load_machine('single_mass')
    parameters = machine.parameters()
    parameters[0]['friction_resistance'] = 0.0
    state = machine.initial_state(parameters)
    s = state[0]
    voltage = np.zeros(9)
    amplitude = 30.0
    speeds = []
    for _ in range(3600):
        angle = 2.0 * math.pi / 0.032 * (s['position'][0] + s['velocity'][0] / 36000)
        for line in range(3):
            voltage[line] = amplitude * math.sin(angle - 2.0 * math.pi / 3.0 * line)
        plant.advance(state, parameters, voltage)
        speeds.append(s['velocity'][0])
    constant = math.sqrt(3.0) / 2.0 * 60.0
    star_resistance, star_inductance = 1.0, 0.004
    star_emf = 60.0 / math.sqrt(3.0)
    mass = 10.0
    current, speed, step = 0.0, 0.0, 1.0 / 18000 / 10
    direct = 0.0
    reference = []
    for _ in range(3600):
        for _ in range(10):
            omega = 2.0 * math.pi / 0.032 * speed
            change = (amplitude - star_resistance * current - star_emf * speed) / star_inductance
            change_direct = -star_resistance / star_inductance * direct + omega * current
            change -= omega * direct
            current += step * change
            direct += step * change_direct
            speed += step * constant * current / mass
        reference.append(speed)
    assert np.abs(np.array(speeds) - reference).max() < 2e-3 * max(reference)


@pytest.mark.slow
def test_single_mass_sticks_at_its_breakaway() -> None:
    machine = load_machine('single_mass')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    constant = motors.force_constant(machine.description.motors['y_linear'])
    moved = {}
    for force in (8.9, 9.1):
        state = machine.initial_state(parameters)
        state[0]['external_force'][0] = force
        for _ in range(180):
            plant.advance(state, parameters, np.zeros(9))
        moved[force] = state[0]['position'][0]
    assert moved[8.9] == 0.0
    assert moved[9.1] > 0.0
    assert constant == pytest.approx(51.96, rel=1e-3)


@pytest.mark.slow
def test_two_mass_drive_has_its_resonance() -> None:
    """sqrt(c (1/J1 + 1/J2)), and damping d (1/J1 + 1/J2) / (2 omega)."""
    machine = load_machine('two_mass_drive')
    (mode,) = modes.coupled_modes(machine)
    inverse = 1.0 / 0.025 + 1.0 / 0.1
    omega = math.sqrt(500.0 * inverse)
    assert mode.frequency_hz == pytest.approx(omega / (2.0 * math.pi), rel=1e-9)
    assert mode.damping_ratio == pytest.approx(0.05 * inverse / (2.0 * omega), rel=1e-9)
    assert modes.first_frequencies(machine.description)['shaft'] == pytest.approx(25.16, rel=1e-3)
    assert mode.shape['load_angle'] == pytest.approx(-0.25, rel=1e-9)


@pytest.mark.slow
def test_two_mass_drive_follows_the_exact_motion() -> None:
    """A torque step on the motor, against the closed solution of the damped pair."""
    machine = load_machine('two_mass_drive')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    s = state[0]
    motor, load = (machine.coordinates.index(name) for name in ('motor_angle', 'load_angle'))
    s['terminals_open'][:] = 1
    torque = 2.0
    s['external_force'][motor] = torque
    j1, j2, c, d = 0.025, 0.1, 500.0, 0.05
    reduced = j1 * j2 / (j1 + j2)
    omega = math.sqrt(c / reduced)
    ratio = d / (2.0 * reduced * omega)
    damped = omega * math.sqrt(1.0 - ratio**2)
    for tick in range(1, 3601):
        plant.advance(state, parameters, np.zeros(9))
        if tick % 600 == 0:
            time = tick / 18000
            decay = math.exp(-ratio * omega * time)
            twist = (torque / j1 / omega**2) * (
                1.0
                - decay
                * (math.cos(damped * time) + ratio * omega / damped * math.sin(damped * time))
            )
            mean = 0.5 * torque / (j1 + j2) * time**2
            assert s['position'][motor] == pytest.approx(mean + j2 / (j1 + j2) * twist, rel=2e-5)
            assert s['position'][load] == pytest.approx(mean - j1 / (j1 + j2) * twist, rel=2e-5)


@pytest.mark.slow
def test_two_link_arm_obeys_the_textbook_equations() -> None:
    """M, Coriolis and gravity of the planar arm in closed form, over random states."""
    seed = 11
    print('seed', seed)
    random = np.random.default_rng(seed)
    machine = load_machine('planar_two_link_arm')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    m1, m2, l1, c1, c2, i1, i2 = 4.0, 2.5, 0.5, 0.22, 0.18, 0.065, 0.032
    result = np.zeros(2)
    for _ in range(200):
        q1, q2 = random.uniform(-3.0, 3.0, 2)
        v1, v2 = random.uniform(-5.0, 5.0, 2)
        torque = random.uniform(-20.0, 20.0, 2)
        coupling = m2 * l1 * c2
        m11 = i1 + i2 + m1 * c1**2 + m2 * (l1**2 + c2**2) + 2.0 * coupling * math.cos(q2)
        m12 = i2 + m2 * c2**2 + coupling * math.cos(q2)
        m22 = i2 + m2 * c2**2
        coriolis = coupling * math.sin(q2) * np.array([-(2.0 * v1 * v2 + v2**2), v1**2])
        gravity = 9.81 * np.array(
            [
                (m1 * c1 + m2 * l1) * math.cos(q1) + m2 * c2 * math.cos(q1 + q2),
                m2 * c2 * math.cos(q1 + q2),
            ]
        )
        expected = np.linalg.solve([[m11, m12], [m12, m22]], torque - coriolis - gravity)
        state[0]['position'][:2] = q1, q2
        state[0]['velocity'][:2] = v1, v2
        plant.acceleration(state, parameters, torque, result)
        assert result == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.mark.slow
def test_two_link_arm_is_held_by_the_torques_of_statics() -> None:
    machine = load_machine('planar_two_link_arm')
    forces = statics.holding_forces(
        machine, machine.parameters(), {'x_rotate': 0.3, 'y_rotate': -0.7}
    )
    elbow = 2.5 * 9.81 * 0.18 * math.cos(0.3 - 0.7)
    shoulder = 9.81 * (4.0 * 0.22 + 2.5 * 0.5) * math.cos(0.3) + elbow
    assert forces['y_rotate'] == pytest.approx(elbow, rel=1e-10)
    assert forces['x_rotate'] == pytest.approx(shoulder, rel=1e-10)


def test_what_is_locked_stands_and_the_drive_before_it_twists() -> None:
    """A torque of 3 Nm against a coupling of 1500 Nm/rad: 2 mrad, and a ring of sqrt(k / J)."""
    machine = load_machine('locked_cycloidal_drive')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    motor, output = (machine.coordinates.index(name) for name in ('motor_angle', 'output_angle'))
    state[0]['external_force'][motor] = 3.0
    state[0]['terminals_open'][:] = 1
    angles = []
    for _ in range(18000):
        plant.advance(state, parameters, np.zeros(9))
        angles.append(state[0]['position'][motor])
    assert abs(angles[-1] - 3.0 / 1500.0) < 1e-6 * 3.0 / 1500.0
    assert abs(state[0]['position'][output]) < 1e-11
    crossings = np.flatnonzero(np.diff(np.sign(np.array(angles) - 3.0 / 1500.0)))
    ring_hz = 18000.0 / (2.0 * float(np.mean(np.diff(crossings[:6]))))
    damped = math.sqrt(1500.0 / 0.02 - (1.0 / (2.0 * 0.02)) ** 2) / (2.0 * math.pi)
    assert ring_hz == pytest.approx(damped, rel=0.01)
