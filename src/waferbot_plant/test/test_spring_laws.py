# SPDX-License-Identifier: Apache-2.0
"""Springs that are not linear, and ropes: closed forms, fine ODE solutions, energy, statics."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from scipy.integrate import quad, solve_ivp
from test_integrator import run

from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, modes, plant, spring_laws, statics
from waferbot_plant.plant import load_machine

MASS = 2.0
STIFFNESS = 8000.0
TICK = 1 / 18000
NO_VOLTAGE = np.zeros(9)


def oscillator(connection: dict, substeps: int = 1, damping: float = 0.0, **more):
    """Return 2 kg on a spring of 8000 N/m with something to it: machine, parameters, state."""
    data = machines.single_mass(
        gravity_m_s2=[0, 0, 0],
        substeps=substeps,
        connections={
            'hold': {
                'state': 'flexible', 'stiffness_n_m': STIFFNESS, 'damping_n_s_m': damping,
                **connection,
            }
        },
        **more,
    )  # fmt: skip
    data['joints']['guide']['freedoms']['travel']['held_by'] = ['hold']
    del data['axes']
    machine = load_machine(machines.write(data))
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


def follow(parameters, state, ticks: int) -> np.ndarray:
    """Return position and velocity at every tick."""
    found = np.zeros((ticks, 2))
    for tick in range(ticks):
        plant.advance(state, parameters, NO_VOLTAGE)
        found[tick] = state[0]['position'][0], state[0]['velocity'][0]
    return found


def exact(force, start, ticks: int, damping=lambda e: 0.0) -> np.ndarray:
    """Return a fine solution of m e'' = -f(e) - d(e) e' at the ticks."""
    return solve_ivp(
        lambda _, y: [y[1], -(force(y[0]) + damping(y[0]) * y[1]) / MASS],
        (0.0, ticks * TICK), start, rtol=1e-10, atol=1e-14, max_step=1e-4,
        t_eval=np.arange(1, ticks + 1) * TICK,
    ).y.T  # fmt: skip


def with_gap(e: float, gap: float) -> float:
    return STIFFNESS * math.copysign(max(abs(e) - gap / 2, 0.0), e)


LAWS = {
    'gap': ({'gap_m': 0.004}, lambda e: with_gap(e, 0.004)),
    'hardening': ({'hardening_1_m2': 5e3}, lambda e: STIFFNESS * e * (1 + 5e3 * e * e)),
    'gap and hardening': (
        {'gap_m': 0.004, 'hardening_1_m2': 5e3},
        lambda e: with_gap(e, 0.004) * (1 + 5e3 * (with_gap(e, 0.004) / STIFFNESS) ** 2),
    ),
}


@pytest.mark.parametrize('law', LAWS)
def test_free_motion_agrees_with_a_fine_solution_and_keeps_its_energy(law: str) -> None:
    """Over many turns: positions to 1e-4 of the amplitude, energy to 1e-10 of what there is."""
    connection, force = LAWS[law]
    machine, parameters, state = oscillator(connection)
    state[0]['velocity'][0] = 0.9
    before = audit.books(machine, state, parameters)
    found = follow(parameters, state, 9000)
    after = audit.books(machine, state, parameters)
    expected = exact(force, [0.0, 0.9], 9000)
    amplitude = np.abs(expected[:, 0]).max()
    error = np.abs(found[:, 0] - expected[:, 0]).max() / amplitude
    print('error', error)
    assert amplitude > 0.01
    assert error < 1e-4
    energy = 0.5 * MASS * 0.9**2
    assert sum(after.stored.values()) == pytest.approx(energy, rel=1e-10)
    assert abs(after.lost['travel damping']) < 1e-10 * energy
    assert abs(audit.imbalance(before, after)) < 1e-10 * energy


@pytest.mark.slow
@pytest.mark.parametrize('speed', [0.003, 0.11, 0.9, 7.0])
def test_backlash_gains_no_energy_over_many_impacts(speed: float) -> None:
    """Thousands of impacts at any phase of the step: kept to rounding."""
    _, parameters, state = oscillator({'gap_m': 0.0013})
    state[0]['velocity'][0] = speed
    energies, stored = [], np.zeros(4)
    for _ in range(60):
        run(state, parameters, 1000, np.zeros(3), np.zeros((1000, 1)))
        plant.energy(state, parameters, stored)
        energies.append(stored.sum())
    start = 0.5 * MASS * speed**2
    assert np.abs(np.array(energies) - start).max() < 1e-9 * start


def test_damping_acts_in_contact_only() -> None:
    """Against the fine solution with d only where |e| > gap / 2; and freely in the gap."""
    gap, damping = 0.004, 30.0
    _, parameters, state = oscillator({'gap_m': gap}, damping=damping, substeps=4)
    state[0]['velocity'][0] = 0.9
    found = follow(parameters, state, 5400)
    expected = exact(
        lambda e: with_gap(e, gap), [0.0, 0.9], 5400,
        damping=lambda e: damping if abs(e) > gap / 2 else 0.0,
    )  # fmt: skip
    assert np.abs(found[:, 0] - expected[:, 0]).max() < 1e-4 * np.abs(expected[:, 0]).max()
    assert found[0, 1] == found[10, 1] == 0.9


@pytest.mark.parametrize(
    ('name', 'small'),
    [('spring_gap', 1e-9), ('spring_hardening', 1e-3), ('spring_error_amplitude', 1e-10)],
)
def test_small_laws_change_the_motion_little(name: str, small: float) -> None:
    """Continuous at zero, damping included; twice the parameter, twice the change."""
    ends = []
    for factor in (0.0, 1.0, 2.0):
        _, parameters, state = oscillator({}, damping=30.0)
        parameters[0][name] = factor * small
        parameters[0]['spring_error_wave'] = 20.0
        state[0]['velocity'][0] = 0.9
        ends.append(follow(parameters, state, 1500)[:, 0])
    change = np.abs(ends[1] - ends[0]).max(), np.abs(ends[2] - ends[0]).max()
    print('changes', change)
    assert 0.0 < change[0] < 1e-5
    assert change[1] / change[0] == pytest.approx(2.0, rel=0.01)


def test_slope_is_zero_in_the_gap_and_that_of_the_spring_outside():
    gap = 1e-3
    _, parameters, state = oscillator({'gap_m': gap})
    s, p = state[0], parameters[0]
    spring_laws.find_spring_laws(s, p)
    for place, slope in (
        (0.0, 0.0),
        (0.49 * gap, 0.0),
        (0.51 * gap, STIFFNESS),
        (-gap, STIFFNESS),
    ):
        position = np.array([p['spring_rest'][0] + place])
        assert spring_laws.slope_now(s, p, 0, position) == slope
        assert (
            spring_laws.stiffness_now(s, p, 0, position) == STIFFNESS
        )  # there must be one to go by


def test_slipping_clutch_passes_its_torque_and_books_the_rest() -> None:
    """m v' = -slip once it slips: way and loss in closed form; then it swings about a new rest."""
    slip = 20.0
    machine, parameters, state = oscillator({'slip_force_n': slip})
    state[0]['velocity'][0] = 1.0
    before = audit.books(machine, state, parameters)
    stretch = slip / STIFFNESS
    kinetic = 0.5 * MASS - 0.5 * STIFFNESS * stretch**2
    found = follow(parameters, state, 9000)
    after = audit.books(machine, state, parameters)
    assert found[:, 0].max() == pytest.approx(stretch + kinetic / slip, rel=1e-6)
    assert state[0]['spring_slipped'][0] == pytest.approx(kinetic / slip, rel=1e-5)
    assert after.lost['travel damping'] == pytest.approx(kinetic, rel=1e-5)
    assert abs(audit.imbalance(before, after)) < 1e-12
    late = found[4500:, 0] - kinetic / slip
    assert np.abs(late).max() == pytest.approx(stretch, rel=1e-3)


def test_force_passed_never_exceeds_slip_with_hardening() -> None:
    _, parameters, state = oscillator({'slip_force_n': 50.0, 'hardening_1_m2': 2e4})
    state[0]['velocity'][0] = 3.0
    found = follow(parameters, state, 3000)
    force = np.abs(np.diff(found[:, 1])) * MASS / TICK
    assert force.max() == pytest.approx(50.0, rel=1e-9)


@pytest.mark.parametrize('parameters_of', [(0.004, 0.0, math.inf, 1.0, math.inf),
                                           (0.0, 3e3, math.inf, 1.0, math.inf),
                                           (0.002, 3e3, 30.0, 0.5, 60.0),
                                           (0.001, 0.0, 30.0, 0.6, 20.0)])  # fmt: skip
def test_mean_force_is_the_integral_of_the_law(parameters_of: tuple) -> None:
    """The closed form of the mean against quadrature of the force, at random ends."""
    _, parameters, _ = oscillator({})
    p = parameters[0]
    names = ('gap', 'hardening', 'slack_force', 'slack_slope', 'slip')
    for name, value in zip(names, parameters_of, strict=True):
        p[f'spring_{name}'] = value
    gap, hardening, slack, slope, slip = parameters_of
    largest = spring_laws._largest_contact(p, 0)

    def force(e: float) -> float:
        c = max(abs(e) - gap / 2, 0.0)
        linear = STIFFNESS * c
        value = min(linear, slack) + slope * max(linear - slack, 0.0)
        return math.copysign(min(value + STIFFNESS * hardening * c**3, slip), e)

    seed = np.random.SeedSequence().entropy
    print('seed', seed)
    for start, end in np.random.default_rng(seed).uniform(-0.02, 0.02, (40, 2)):
        found, _ = spring_laws._mean_force(p, 0, start, end, largest)
        kinks = sorted({s * x for s in (1, -1) for x in
                        (gap / 2, gap / 2 + slack / STIFFNESS, gap / 2 + largest)
                        if x < 1 and min(start, end) < s * x < max(start, end)})  # fmt: skip
        expected = quad(force, start, end, points=kinks or None, epsabs=1e-11)[0] / (end - start)
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-9)


def drive(transmission: dict, connections: dict, **more):
    """Return a motor of 1e-4 kg m2 on a load of 0.01 by a gear of 3 and a belt of 1:2."""
    data = {
        'name': 'drive',
        'gravity_m_s2': [0, 0, 0],
        'bodies': {
            'load': {
                'mass_kg': 1.0, 'centre_of_gravity_m': [0, 0, 0],
                'inertia_kg_m2': {'xx': 0.01, 'yy': 0.01, 'zz': 0.01},
            }
        },
        'joints': {
            'shaft': {
                'parent': 'base', 'child': 'load', 'at_m': [0, 0, 0],
                'freedoms': {'load': {'type': 'revolute', 'axis': [0, 0, 1]}},
            }
        },
        'rotors': {'motor': {'inertia_kg_m2': 1e-4}},
        'transmissions': {
            'drive': {
                'driving': 'motor', 'driven': 'load',
                'stages': [
                    {'kind': 'gear', 'ratio': 3, 'connection': 'gear'},
                    {'kind': 'belt', 'driving_pulley_radius_m': 0.01,
                     'driven_pulley_radius_m': 0.02, 'connection': 'belt'},
                ],
                **transmission,
            }
        },
        'connections': {
            'gear': {'state': 'flexible', 'stiffness_nm_rad': 500.0, 'damping_nm_s_rad': 0.0,
                     **connections.get('gear', {})},
            'belt': {'state': 'flexible', 'stiffness_n_m': 4e5, 'damping_n_s_m': 0.0,
                     **connections.get('belt', {})},
        },
        'axes': {'y_rotate': 'load'},
        **more,
    }  # fmt: skip
    machine = load_machine(machines.write(data))
    parameters = machine.parameters()
    return machine, parameters, machine.initial_state(parameters)


def wind_up(parameters, state, machine, motor: float) -> float:
    """Return the torque on the load (Nm) with the motor turned by so much, the load at zero."""
    state[0]['position'][machine.coordinates.index('motor')] = motor
    force = np.zeros(len(machine.coordinates))
    plant.generalised_forces(state, parameters, force)
    return float(force[machine.coordinates.index('load')])


def series_torque(twist: float, gear, belt) -> float:
    """Return the torque at the load where the two stages' own laws share a twist of the load."""
    low, high = 0.0, 1e4
    for _ in range(200):
        torque = 0.5 * (low + high)
        if gear(torque) + belt(torque) < twist:
            low = torque
        else:
            high = torque
    return torque


def test_gaps_and_slack_strand_of_stages_in_series_are_those_of_the_stages() -> None:
    """Each stage by hand: its twist at the load as a function of the torque there."""
    machine, parameters, state = drive(
        {}, {'gear': {'gap_rad': 0.002}, 'belt': {'slack_preload_n': 100.0, 'gap_m': 1e-4}}
    )

    def gear(torque: float) -> float:  # the belt halves its motion and doubles its torque
        return 0.5 * (torque * 0.5 / 500.0 + 0.001)

    def belt(torque: float) -> float:
        force = torque / 0.02
        stretch = force / 4e5 if force < 200.0 else 200.0 / 4e5 + (force - 200.0) / 2e5
        return (stretch + 0.5e-4) / 0.02

    for twist in (0.004, 0.02, 0.05, 0.1):
        expected = series_torque(twist, gear, belt)
        assert wind_up(parameters, state, machine, twist * 6.0) == pytest.approx(
            expected, rel=1e-9
        )
    assert wind_up(parameters, state, machine, 0.9 * 6.0 * 0.003) == 0.0


def test_weakest_stage_slips_and_hardening_is_right_to_first_order() -> None:
    machine, parameters, state = drive(
        {}, {'gear': {'slip_torque_nm': 4.0}, 'belt': {'slip_force_n': 300.0}}
    )
    assert wind_up(parameters, state, machine, 6.0) == pytest.approx(6.0, rel=1e-12)
    machine, parameters, state = drive({}, {'gear': {'slip_torque_nm': 2.0}})
    assert wind_up(parameters, state, machine, 6.0) == pytest.approx(4.0, rel=1e-12)
    machine, parameters, state = drive({}, {'gear': {'hardening_1_rad2': 30.0}})
    own = 160.0 * 2000.0 / (160.0 + 2000.0)
    for twist in (0.01, 0.02):
        expected = series_torque(
            twist,
            lambda torque: 0.5 * np.roots([500.0 * 30.0, 0.0, 500.0, -torque * 0.5]).real.max(),
            lambda torque: torque / 160.0,
        )
        found = wind_up(parameters, state, machine, twist * 6.0)
        assert found - own * twist == pytest.approx(expected - own * twist, rel=0.05)


@pytest.mark.parametrize('of', ['driving', 'driven'])
def test_transmission_error_is_felt_as_a_moving_rest(of: str) -> None:
    """Motor and load turning with a mesh error: scipy's solution from Lagrange's equations."""
    order, amplitude, phase = (8, 5e-4, 0.3) if of == 'driving' else (40, 5e-4, 0.3)
    machine, parameters, state = drive(
        {
            'transmission_error': {
                'amplitude_rad': amplitude, 'order': order, 'phase_rad': phase, 'of': of,
            }
        },
        {},
    )  # fmt: skip
    stiffness = 160.0 * 2000.0 / (160.0 + 2000.0)
    motor, load = machine.coordinates.index('motor'), machine.coordinates.index('load')
    state[0]['velocity'][motor], state[0]['velocity'][load] = 60.0, 10.0

    def motion(_, y):
        m, load_angle, m_speed, load_speed = y
        angle = order * (m if of == 'driving' else load_angle) - phase
        e = m / 6.0 - load_angle + amplitude * math.cos(angle)
        tangent = -amplitude * order * math.sin(angle)
        arms = (1 / 6.0 + tangent, -1.0) if of == 'driving' else (1 / 6.0, -1.0 + tangent)
        torque = stiffness * e
        return [m_speed, load_speed, -torque * arms[0] / 1e-4, -torque * arms[1] / 0.01]

    ticks = 3600
    before = audit.books(machine, state, parameters)
    run(state, parameters, ticks, np.zeros(3), np.zeros((ticks, 2)))
    after = audit.books(machine, state, parameters)
    expected = solve_ivp(
        motion, (0.0, ticks * TICK), [0.0, 0.0, 60.0, 10.0], rtol=1e-10, atol=1e-12
    ).y[:, -1]
    assert state[0]['position'][motor] == pytest.approx(expected[0], rel=2e-6)
    assert state[0]['velocity'][load] == pytest.approx(expected[3], rel=1e-3)
    assert abs(expected[3] - 10.0) > 1e-2 or abs(expected[2] - 60.0) > 1e-2
    energy = 0.5 * (1e-4 * 60.0**2 + 0.01 * 10.0**2)
    assert abs(audit.imbalance(before, after)) < 1e-9 * energy
    assert sum(after.stored.values()) == pytest.approx(sum(before.stored.values()), rel=1e-8)


@pytest.mark.slow
def test_whole_machine_with_all_of_it_balances_its_energy() -> None:
    """Backlash, slack strand, error, hardening bearings, friction, cable; driven hard."""
    overlay = {
        'connections': {
            'gearbox': {'gap_rad': 1e-3},
            'belt': {'slack_preload_n': 60.0},
            'x_rotate_bearing_z': {'hardening_1_rad2': 1e8},
            'payload_bearing_z': {'gap_rad': 1e-6},
        },
        'transmissions': {
            'y_rotate_drive': {'transmission_error': {'amplitude_rad': 2e-4, 'order': 4}}
        },
    }
    machine = load_machine('flexible', overlays=[overlay])
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {}, holding=True)
    before = audit.books(machine, state, parameters)
    run(state, parameters, 18000, np.array([60.0, 60.0, 20.0]), np.zeros((18000, 15)))
    after = audit.books(machine, state, parameters)
    supplied = sum(after.supplied.values())
    print('imbalance', audit.imbalance(before, after) / supplied)
    assert supplied > 100.0
    assert abs(audit.imbalance(before, after)) < 1e-6 * supplied
    assert min(audit.loss_powers(before, after, 1.0).values()) > -1e-9


def hanging(rope: dict, counterweight: float = 3.0):
    """Return two masses on a cable over a pulley, the first held by a motor-less huge mass."""
    data = machines.two_slides(
        transmissions={
            'rope': {
                'driving': 'first', 'driven': 'second',
                'stages': [{'kind': 'cable', 'connection': 'rope'}],
            }
        },
        connections={
            'rope': {'state': 'flexible', 'stiffness_n_m': 4000.0, 'damping_n_s_m': 0.0, **rope}
        },
    )  # fmt: skip
    data['bodies']['second']['mass_kg'] = counterweight
    return load_machine(machines.write(data))


def test_rope_with_mass_has_a_second_mode() -> None:
    """Three masses on two springs of 2 k: eigenvalues by hand; and near sqrt(4 k / m)."""
    machine = hanging({'rope_mass_kg': 0.02})
    stiffness = 8000.0 * np.array([[1.0, 0.0, 1.0], [0.0, 1.0, -1.0], [1.0, -1.0, 2.0]])
    masses = np.array([2.0, 3.0, 0.02])
    squares = np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(masses, masses)))
    expected = np.sqrt(squares[1:]) / (2 * math.pi)
    found = [mode.frequency_hz for mode in modes.coupled_modes(machine)]
    assert found == pytest.approx(expected, rel=1e-9)
    assert found[1] == pytest.approx(math.sqrt(4 * 4000.0 / 0.02) / (2 * math.pi), rel=0.01)
    light = [mode.frequency_hz for mode in modes.coupled_modes(hanging({}))]
    assert found[0] == pytest.approx(light[0], rel=0.01)


def test_rope_with_mass_moves_along_and_swings_at_its_second_mode() -> None:
    machine = hanging({'rope_mass_kg': 0.02})
    parameters = machine.parameters()
    parameters[0]['gravity'] = 0.0
    state = machine.initial_state(parameters)
    rope, second = machine.coordinates.index('rope_rope'), machine.coordinates.index('second')
    state[0]['external_force'][second] = -3.0 * 9.81
    state[0]['external_force'][machine.coordinates.index('first')] = -3.0 * 9.81
    state[0]['velocity'][rope] = 0.05
    record = np.zeros((18000, 3))
    run(state, parameters, 18000, np.zeros(3), record)
    spectrum = np.abs(np.fft.rfft(record[:, rope] * np.hanning(len(record))))
    expected = modes.coupled_modes(machine)[1].frequency_hz
    assert abs(np.argmax(spectrum[100:]) + 100 - expected) < 1.0


def test_machine_rests_anywhere_with_a_heavy_rope_and_a_slack_cable() -> None:
    overlay = {'connections': {'cable': {'rope_mass_kg': 0.3, 'slack_m': 2e-3}}}
    machine = load_machine('flexible', overlays=[overlay])
    plain = load_machine('flexible')
    found = []
    for each in (machine, plain):
        parameters = each.parameters()
        positions = {'y_linear': 0.2, 'x_rotate': 0.3}
        forces = statics.holding_forces(each, parameters, positions)
        state = each.initial_state(parameters, positions, holding=True)
        found.append((forces, state[0]['position'][each.coordinates.index('counterweight')]))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-6, abs=1e-6)
    assert found[0][1] - found[1][1] == pytest.approx(-2e-3, rel=1e-6)


@pytest.mark.parametrize('slack', [1e-9, 1e-3])
def test_slack_lets_a_cable_go_by_so_much_sooner(slack: float) -> None:
    machine = hanging({'slack_m': slack})
    parameters = machine.parameters()
    assert parameters[0]['cable_rest'][0] == pytest.approx(-3.0 * 9.81 / 4000.0 + slack, rel=1e-9)


@pytest.mark.parametrize(
    ('connection', 'message'),
    [
        ({'gap_rad': 0.1}, 'wrong unit.*give gap_m'),
        ({'gap_m': -0.1}, 'must be at least 0'),
        ({'slack_preload_n': 5.0}, 'only a belt has that'),
        ({'rope_mass_kg': 5.0}, 'only a cable has that'),
        ({'slip_force_n': 0.0}, 'must be greater than 0'),
    ],
)
def test_mistakes_of_connections_are_named(connection: dict, message: str) -> None:
    with pytest.raises(
        UserError, match=rf'machine_\d+.yaml, line \d+: connections.hold.*{message}'
    ):
        oscillator(connection)


def test_mistakes_of_cables_and_errors_are_named() -> None:
    with pytest.raises(UserError, match=r'connections.rope.gap_m: a cable has slack_m instead'):
        hanging({'gap_m': 0.1})
    error = {'transmission_error': {'amplitude_rad': 1e-4, 'order': 3}}
    rigid = {name: {'state': 'rigid'} for name in ('gear', 'belt')}
    with pytest.raises(UserError, match=r'transmission_error: needs a flexible connection'):
        drive(error, rigid)
    with pytest.raises(
        UserError, match=r'transmission_error.amplitude_m: wrong unit.*give amplitude_rad'
    ):
        drive({'transmission_error': {'amplitude_m': 1e-4, 'order': 3}}, {})
