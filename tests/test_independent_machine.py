# SPDX-License-Identifier: Apache-2.0
"""
The second simulator against independent truth, and what it writes against what waferbot reads.

Truth are solutions on paper, energy, scipy's solve_ivp with events, and MuJoCo.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from independent_machine import cases
from independent_machine.answers import TIME, answers
from independent_machine.cases import draw
from independent_machine.files import (
    ESTIMATION,
    MACHINE,
    MAP,
    VALIDATION,
    description,
    write_case,
)
from independent_machine.machine import physics_of
from independent_machine.motions import MOTIONS, Reach
from independent_machine.plant import Encoder, Loop, Physics, motion_under, run_loop
from independent_machine.simulation import Motion, Noise, averaged, simulate
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from waferbot_twin.diagnosis.inference.nuisance import nuisance
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects import find, places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.logs.load import load_log
from waferbot_twin.models import load_model_or_machine
from waferbot_twin.residuals.from_measured_log import aligned_records, sized_by
from waferbot_twin.residuals.problem import Cause, Problem

STEP_S = 1e-5

pytestmark = pytest.mark.long


def mechanism(**values):
    nothing = dict.fromkeys(Physics._fields, 0.0)
    nothing |= {'load_mass': 2.0, 'elastic': False, 'stribeck_speed': 1.0}
    return Physics(**nothing | {'cogging': np.zeros((0, 3))} | values)


def move(physics, state, forces):
    path, forced = motion_under(physics, np.array(state, float), np.asarray(forces, float), STEP_S)
    assert forced == 0
    return path


def times(path):
    return STEP_S * np.arange(len(path))


# One mass


def test_a_speed_decays_exponentially_in_grease():
    path = move(mechanism(viscous=3.0), [0.0, 1.5, 0.0, 1.5], np.zeros(50_000))
    np.testing.assert_allclose(path[:, 3], 1.5 * np.exp(-1.5 * times(path)), rtol=1e-10)
    np.testing.assert_allclose(path[:, 2], 1.0 - np.exp(-1.5 * times(path)), atol=1e-10)


def test_dry_friction_stops_a_mass_where_its_energy_is_used_up_and_holds_it_exactly():
    rubbing = mechanism(coulomb_forward=4.0, coulomb_backward=9.0)
    path = move(rubbing, [0.0, 0.5, 0.0, 0.5], np.zeros(40_000))
    assert path[-1, 2] == pytest.approx(2.0 * 0.5**2 / (2.0 * 4.0), rel=1e-9)
    assert (path[26_000:, 3] == 0.0).all()
    assert (path[26_000:, 2] == path[-1, 2]).all()
    back = move(rubbing, [0.0, -0.5, 0.0, -0.5], np.zeros(40_000))
    assert back[-1, 2] == pytest.approx(-2.0 * 0.5**2 / (2.0 * 9.0), rel=1e-9)


def test_a_mass_breaks_away_where_the_force_passes_what_holds_it():
    sticky = mechanism(
        coulomb_forward=2.0, coulomb_backward=2.0, breakaway=1.0, stribeck_speed=0.1
    )
    ramp = np.linspace(0.0, 5.0, 50_001)[1:]
    path = move(sticky, [0.0] * 4, ramp)
    first = int(np.flatnonzero(path[:, 3])[0])
    # Held in step n is the force ramp[n]; the first above 3 N moves it.
    assert ramp[first - 1] > 3.0
    assert ramp[first - 2] <= 3.0
    assert (path[first:, 3] > 0.0).all()


def test_stick_slip_of_a_pendulum_is_that_of_solve_ivp_with_events():
    """Imbalance, cogging, grease and Stribeck's friction, until it stands for good."""
    pendulum = mechanism(
        load_mass=0.05, viscous=0.01, coulomb_forward=0.05, coulomb_backward=0.08, breakaway=0.03,
        stribeck_speed=0.3, gravity_cosine=0.05, gravity_sine=-1.2,
        cogging=np.array([[6.0, 0.1, 0.2], [18.0, -0.05, 0.08]]),
    )  # fmt: skip

    def force(angle):
        found = 0.05 * math.cos(angle) - 1.2 * math.sin(angle)
        found += 0.1 * math.cos(6.0 * angle) + 0.2 * math.sin(6.0 * angle)
        return found - 0.05 * math.cos(18.0 * angle) + 0.08 * math.sin(18.0 * angle)

    def level(direction):
        return 0.05 if direction > 0.0 else 0.08

    def stops(time, state, direction):
        return state[1]

    stops.terminal = True
    state, begun, turns = [2.0, 0.0], 0.0, []
    while True:
        net = force(state[0])
        if -(0.08 + 0.03) <= net <= 0.05 + 0.03:
            break
        way = math.copysign(1.0, net)
        stops.direction = -way

        def rates(time, state, direction):
            rubs = level(direction) + 0.03 * math.exp(-((state[1] / 0.3) ** 2))
            return [state[1], (force(state[0]) - 0.01 * state[1] - direction * rubs) / 0.05]

        # A little way on by its acceleration, so that the event is not the beginning itself.
        early = 1e-7
        a = rates(0.0, state, way)[1]
        state = [state[0] + 0.5 * a * early**2, a * early]
        swing = solve_ivp(
            rates, (begun + early, begun + 60.0), state, 'DOP853', args=(way,), events=stops,
            rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        assert swing.status == 1
        state, begun = [swing.y[0, -1], 0.0], swing.t[-1]
        turns.append((begun, state[0]))
    assert len(turns) > 8
    path = move(pendulum, [2.0, 0.0, 2.0, 0.0], np.zeros(int((begun + 0.1) / STEP_S)))
    for time, angle in turns:
        place = round(time / STEP_S)
        assert path[place, 2] == pytest.approx(angle, abs=1e-6)
    assert (path[round(begun / STEP_S) + 2 :, 3] == 0.0).all()


def test_a_damped_pendulum_swings_as_in_mujoco():
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.0005" integrator="RK4" gravity="0 -9.81 0"/><worldbody>'
        '<body><joint type="hinge" axis="0 0 1" damping="0.02"/>'
        '<inertial pos="0.03 -0.2 0" mass="0.8" diaginertia="0.01 0.01 0.01"/></body>'
        '</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    angles = []
    for _ in range(4000):
        mujoco.mj_step(model, data)
        angles.append(data.qpos[0])
    inertia = 0.01 + 0.8 * (0.03**2 + 0.2**2)
    ours = mechanism(
        load_mass=inertia, viscous=0.02, gravity_cosine=-0.8 * 9.81 * 0.03,
        gravity_sine=-0.8 * 9.81 * 0.2,
    )  # fmt: skip
    path = move(ours, [1.0, 0.0, 1.0, 0.0], np.zeros(200_000))
    np.testing.assert_allclose(path[50::50, 2], angles, atol=1e-6)


# Two masses


def test_two_free_masses_swing_at_their_resonance():
    pair = mechanism(motor_mass=0.5, elastic=True, stiffness=9000.0)
    path = move(pair, [0.01, 0.0, 0.0, 0.0], np.zeros(30_000))
    omega = math.sqrt(9000.0 * (1.0 / 0.5 + 1.0 / 2.0))
    stretch = path[:, 0] - path[:, 2]
    np.testing.assert_allclose(stretch, 0.01 * np.cos(omega * times(path)), atol=1e-8)
    centre = (0.5 * path[:, 0] + 2.0 * path[:, 2]) / 2.5
    np.testing.assert_allclose(centre, 0.002, atol=1e-13)


def test_an_impact_through_backlash_keeps_energy_and_momentum():
    """The motor crosses the gap, hits, and both part again: the elastic collision of the textbook."""
    pair = mechanism(motor_mass=0.5, elastic=True, stiffness=1e5, gap=0.004)
    path = move(pair, [-0.002, 0.4, 0.0, 0.0], np.zeros(3000))
    touch_s = 0.004 / 0.4
    apart_s = touch_s + math.pi * math.sqrt(0.5 * 2.0 / 2.5 / 1e5)
    touch, apart = round(touch_s / STEP_S), round(apart_s / STEP_S)
    assert (path[: touch - 1, 1] == 0.4).all()
    assert (path[: touch - 1, 3] == 0.0).all()
    assert path[touch + 2, 3] > 0.0
    np.testing.assert_allclose(
        path[apart + 2 : apart + 900, 1], 0.4 * (0.5 - 2.0) / 2.5, rtol=1e-9
    )
    np.testing.assert_allclose(path[apart + 2 : apart + 900, 3], 0.4 * 2.0 * 0.5 / 2.5, rtol=1e-9)


def test_flanks_push_and_never_pull():
    pair = mechanism(motor_mass=0.5, elastic=True, stiffness=1e5, gap=0.004, damping=60.0)
    path = move(pair, [-0.002, 0.4, 0.0, 0.0], np.zeros(3000))
    assert (np.diff(path[:, 3]) >= 0.0).all()
    assert (np.diff(path[:, 1]) <= 0.0).all()
    after = path[-1]
    assert 0.0 < after[3] < 0.4 * 2.0 * 0.5 / 2.5
    assert 0.5 * after[1] + 2.0 * after[3] == pytest.approx(0.5 * 0.4, rel=1e-12)


def test_energy_supplied_is_stored_or_lost():
    pair = mechanism(
        motor_mass=0.5, elastic=True, stiffness=4e4, gap=0.002, damping=20.0, coulomb_forward=1.5,
        coulomb_backward=1.0, breakaway=0.5, stribeck_speed=0.02, viscous=2.0, motor_coulomb=0.5,
        motor_viscous=1.0, gravity_cosine=1.0, gravity_sine=-3.0, constant_force=0.7,
        cogging=np.array([[200.0, 0.4, -0.3]]),
    )  # fmt: skip
    forces = 8.0 * np.sin(2.0 * np.pi * 3.0 * STEP_S * np.arange(100_000))
    path = move(pair, [0.0] * 4, forces)
    q1, v1, q2, v2 = path.T
    stretch, rate = q1 - q2, v1 - v2
    deep = np.maximum(np.abs(stretch) - 0.001, 0.0) * np.sign(stretch)
    push = 4e4 * deep + 20.0 * rate
    touching = (deep != 0.0) & (push * deep > 0.0)
    stored = 0.25 * v1**2 + v2**2 + 2e4 * deep**2
    stored -= np.sin(q2) + 3.0 * np.cos(q2) + 0.7 * q2
    stored -= (0.4 * np.sin(200.0 * q1) + 0.3 * np.cos(200.0 * q1)) / 200.0
    rubs = np.where(v2 > 0.0, 1.5, 1.0) + 0.5 * np.exp(-((v2 / 0.02) ** 2))
    # In contact T e' leaves the flanks' spring what is not lost; parting, the spring's rest goes too.
    lost = rubs * np.abs(v2) + 2.0 * v2**2 + 0.5 * np.abs(v1) + v1**2
    into_flanks = np.where(touching, push, 0.0) * rate
    supplied = np.sum(forces * np.diff(q1))
    flank_loss = np.trapezoid(into_flanks) * STEP_S - 2e4 * (deep[-1] ** 2 - deep[0] ** 2)
    balance = stored[-1] - stored[0] + np.trapezoid(lost) * STEP_S + flank_loss
    assert flank_loss > 0.0
    assert np.count_nonzero(np.diff(touching)) > 10
    assert balance == pytest.approx(supplied, rel=2e-4)


# Drive, encoder, controller


def loop(**values):
    plain = {
        'cascade': False, 'position_gain': 800.0, 'velocity_gain': 64.0, 'integral_rate': 3.0,
        'velocity_feedforward': 1.0, 'mass_feedforward': 2.0, 'filter_share': 1.0,
        'position_on_motor': False, 'velocity_on_motor': False, 'known_constant': 5.0,
        'true_constant': 5.0, 'limit': 10.0, 'delay_steps': 0, 'lag_s': 0.0, 'bias': 0.0,
    }  # fmt: skip
    return Loop(**plain | values)


def encoder(**values):
    plain = {
        'ratio': 1.0, 'resolution': 1e-6, 'rounds': False, 'cosine': 0.0, 'sine': 0.0,
        'period': 1.0, 'delay_steps': 0,
    }  # fmt: skip
    return Encoder(**plain | values)


def run(own_loop, own_encoder, ticks=1000, steps=50):
    path = MOTIONS['sines'](
        Reach(0.0, 0.1, 0.3, 3.0), np.random.default_rng(3), ticks, steps * STEP_S
    )
    noise = np.zeros((ticks, 10)), np.zeros((ticks, 2))
    return path, *run_loop(
        mechanism(), own_loop, own_encoder, encoder(), path, *noise, steps * STEP_S, steps
    )


def test_a_drive_is_late_by_its_delay_and_lags_exponentially():
    _, _, commands, currents, _, forces, _ = run(loop(delay_steps=70, lag_s=2e-4), encoder())
    held = np.repeat(commands, 50)
    given = np.concatenate([np.full(70, commands[0]), held])[: len(held)]
    keep = math.exp(-STEP_S / 2e-4)
    expected = lfilter([1.0 - keep], [1.0, -keep], given)
    np.testing.assert_allclose(forces[1:], 5.0 * expected, atol=1e-12)
    np.testing.assert_allclose(currents, forces[:-1:50] / 5.0, atol=1e-12)


@pytest.mark.parametrize('every', [1, 2])
@pytest.mark.parametrize('lag_s', [5e-5, 2.5e-4])
def test_a_measured_drive_stands_late_in_a_straight_log(drawn, lag_s, every):
    """As late as least squares say of what it does and the rate of what is logged."""
    _, _, _, currents, _, forces, _ = run(loop(lag_s=lag_s), encoder(), 4000)
    tick_s = 50 * STEP_S
    sampled_s = np.arange(0, len(currents), every) * tick_s
    logged = np.interp(
        np.arange(len(forces)) * STEP_S, sampled_s, averaged(currents, every)[::every]
    )
    rate = np.gradient(logged, STEP_S)
    inside = slice(2000, -2000)
    late_s = (forces / 5.0 - logged)[inside] @ rate[inside] / (rate[inside] @ rate[inside])
    setup = drawn[0].setup
    setup = replace(
        setup, drive='current', tick_hz=1.0 / tick_s, every=every,
        tuning=replace(setup.tuning, lag_s=lag_s),
    )  # fmt: skip
    assert setup.drive_late_s == pytest.approx(late_s, rel=0.05)


@pytest.mark.parametrize('rounds', [False, True])
def test_an_encoder_shows_counts_of_where_the_axis_was(rounds):
    own = encoder(delay_steps=130, rounds=rounds, cosine=3e-5, sine=-2e-5, period=0.02)
    _, readings, _, _, motion, _, _ = run(loop(), own)
    place = np.maximum(50 * np.arange(len(readings)) - 130, 0)
    true = motion[place, 2]
    angle = 2.0 * np.pi * true / 0.02
    shown = (true + 3e-5 * np.cos(angle) - 2e-5 * np.sin(angle)) / 1e-6
    counts = np.floor(shown + 0.5) if rounds else np.floor(shown)
    np.testing.assert_array_equal(readings[:, 0], counts * 1e-6)
    assert np.ptp(counts) > 1000


@pytest.mark.parametrize('cascade', [False, True])
def test_a_known_machine_follows_and_its_limit_holds(cascade):
    path, readings, commands, *_ = run(loop(cascade=cascade, velocity_gain=64.0), encoder(), 4000)
    assert np.abs(path[:, 0] - readings[:, 0]).max() < 2e-3
    _, _, limited, *_ = run(loop(limit=0.5 * np.abs(commands).max()), encoder())
    assert np.abs(limited).max() <= 0.5 * np.abs(commands).max()


def test_a_slow_drive_averages_what_came_since_its_last_sample():
    np.testing.assert_allclose(averaged(np.arange(5.0), 2)[1:], [0.5, 1.5, 2.5, 3.5])
    np.testing.assert_array_equal(averaged(np.arange(5.0), 1), np.arange(5.0))


@pytest.mark.parametrize('kind', list(MOTIONS))
def test_motions_stay_in_reach_and_are_what_their_rates_say(kind):
    reach = Reach(0.2, 0.3, 0.4, 2.0)
    path = MOTIONS[kind](reach, np.random.default_rng(5), 6000, 1e-3)
    assert np.abs(path[:, 0] - 0.2).max() <= 0.15 + 1e-9
    if kind == 'steps':
        assert len(np.unique(path[:, 0])) > 3
        return
    assert np.abs(path[:, 1]).max() <= 1.3 * 0.4
    np.testing.assert_allclose(np.gradient(path[:, 0], 1e-3), path[:, 1], atol=2.5e-3)


# Cases and files


@pytest.fixture(scope='module')
def drawn():
    return [draw(1, number) for number in (1, 8)]


def test_a_case_is_the_same_to_the_bit_and_its_effects_matter(drawn):
    case, again = drawn[0], draw(1, 1)
    assert case == again
    assert case.hidden
    for log, other in zip(case.logs(), again.logs(), strict=True):
        assert log.forced_steps == 0
        np.testing.assert_array_equal(log.position, other.position)
        np.testing.assert_array_equal(log.drive, other.drive)
        assert log.saturated < 0.02
    assert all(effect.size >= cases.LEAST_SIZE for effect in case.hidden)


@pytest.mark.parametrize(
    ('drive', 'every'), [('current', 1), ('current', 2), ('force', 2), ('current_command', 1)]
)
@pytest.mark.parametrize('kind', ['random moves', 'steps'])
def test_logs_balance_momentum_without_a_simulation(drawn, drive, every, kind):
    """Force times a window, summed, is mass times position times the second derivative of the window."""
    setup = drawn[0].setup
    machine = replace(setup.machine, coulomb=0.0, viscous=0.0)
    quiet = Noise(0.0, 10.0, 0.0, 0.0, 0.0)
    setup = replace(setup, machine=machine, drive=drive, every=every, noise=quiet)
    log = simulate(setup, {}, Motion(kind, 4.0, (3,)), (4,))
    scale = 1.0 if drive == 'force' else machine.axis_constant
    step_s = log.time_s[1] - log.time_s[0]
    width = round(0.15 / step_s)
    x = np.arange(width + 1) / width
    window = (x * (1.0 - x)) ** 4
    second = np.gradient(np.gradient(window, step_s), step_s)
    force = np.convolve(scale * log.drive, window, 'valid')
    moved = machine.total * np.convolve(log.position, second, 'valid')
    assert force @ moved / (force @ force) == pytest.approx(1.0, abs=0.01)
    assert np.std(moved - force) < 0.06 * np.std(force)


def machines(count=40):
    """Give machines and one of every effect that each may have."""
    for seed in range(count):
        random = np.random.default_rng([9, seed])
        machine, reach = cases._machine(random)
        kinds = [
            'coulomb', 'direction_dependent', 'stribeck', 'viscous', 'mass', 'motor_constant',
            'constant_force', 'cogging', 'eccentricity', 'encoder_delay', 'drive_delay',
        ]  # fmt: skip
        kinds += ['imbalance'] if cases._can_tilt(machine) else []
        kinds += ['motor_eccentricity'] if machine.motor_resolution else []
        if machine.kind == 'geared':
            kinds += ['motor_coulomb', 'backlash', 'compliance']
        yield machine, {kind: cases._values(kind, machine, reach, random) for kind in kinds}


@pytest.fixture(scope='module')
def described(tmp_path_factory):
    """Machines, their effects, and their descriptions as waferbot reads them."""
    import yaml

    folder, found = tmp_path_factory.mktemp('machines'), []
    for place, (machine, effects) in enumerate(machines()):
        file = folder / f'{place}.yaml'
        file.write_text(yaml.safe_dump(description(machine)), 'utf-8')
        found.append((machine, effects, Variant.of(load_model_or_machine(str(file)))))
    assert {machine.kind for machine, _, _ in found} == {'linear', 'rotary', 'geared'}
    return found


def test_descriptions_say_what_the_machines_are(described):
    for machine, _, variant in described:
        axis = machine.axis
        assert places.motor_axes(variant) == (axis,)
        assert places.moving_inertia(variant, axis) == pytest.approx(machine.total, rel=1e-9)
        assert places.force_per_ampere(variant, axis) == pytest.approx(
            machine.axis_constant, rel=1e-9
        )
        assert places.motor_ratio(variant, axis) == pytest.approx(machine.ratio)


def test_every_answer_is_an_effect_of_the_library_with_these_parameters(described):
    for machine, effects, variant in described:
        for kind, values in effects.items():
            expected = answers(machine, kind, values, {kind: values})
            for answer in expected.right:
                if answer.effect in (TIME, 'command_delay'):
                    continue
                if answer.effect.startswith('axes.'):
                    assert answer.effect.split('.')[1] in places.motor_axes(variant)
                    continue
                if '.' in answer.effect:
                    corrected = description(machine)
                    for key in answer.effect.split('.'):
                        corrected = corrected[key]
                    if kind == 'motor_constant':
                        true = corrected * values['ratio']
                        assert answer.values['value'] == pytest.approx(true)
                    continue
                effect = find(answer.effect)
                assert machine.axis in effect.axes(variant), (kind, answer.effect)
                if kind != 'cogging':  # its orders are named by what a log shows
                    known = {item.name for item in effect.parameters(variant, machine.axis)}
                    assert answer.values.keys() <= known, (kind, answer.effect)
            for name in expected.related:
                find(name)


def test_masses_and_imbalances_of_the_library_change_what_they_should(described):
    for machine, effects, variant in described:
        for kind in ('mass', 'imbalance'):
            if kind not in effects:
                continue
            hidden = {kind: effects[kind]}
            best = answers(machine, kind, effects[kind], hidden).right[0]
            changed = find(best.effect).apply(variant, machine.axis, best.values)
            physics = physics_of(machine, hidden)
            bodies = changed.description.bodies['load']
            centre, turns = bodies.centre_of_gravity, not machine.linear
            load = bodies.mass
            if turns:
                load = bodies.inertia[2, 2] + bodies.mass * (centre[0] ** 2 + centre[1] ** 2)
            assert load == pytest.approx(physics.load_mass, rel=1e-9)
            if turns and machine.has_gravity:
                assert -9.81 * bodies.mass * centre[0] == pytest.approx(physics.gravity_cosine)
                assert 9.81 * bodies.mass * centre[1] == pytest.approx(physics.gravity_sine)


def test_files_are_read_as_the_log_that_was_simulated(tmp_path, drawn):
    for case in drawn:
        folder = tmp_path / str(case.number)
        write_case(case, folder)
        _, log = case.logs()
        read = load_log(folder / VALIDATION, str(folder / MAP), None, None, None, None)
        axis, machine = case.setup.machine.axis, case.setup.machine
        position = read[axis, 'position']
        np.testing.assert_allclose(position.value, log.position, atol=1e-3 * machine.resolution)
        assert position.resolution == pytest.approx(machine.resolution, rel=1e-6)
        np.testing.assert_allclose(position.time_s, log.time_s, atol=1e-9)
        kind = case.setup.drive
        np.testing.assert_allclose(read[axis, kind].value, log.drive, atol=1e-8, rtol=1e-8)
        np.testing.assert_allclose(
            read[axis, 'commanded_position'].value, log.commanded, atol=1e-9, rtol=1e-8
        )
        text = (folder / MACHINE).read_text('utf-8') + (folder / MAP).read_text('utf-8')
        assert not any(effect.kind in text for effect in case.hidden)
        assert not read.findings


def test_a_compliance_that_rings_is_what_it_is_in_fine_steps(tmp_path):
    """
    Steps h of the plant make an oscillation slower by (w h)^2 / 12, a compliance smaller by twice that.

    Of a gear at 89 Hz and 4 kHz that is 0.33 %, far more than a log that rings leaves open.
    """
    case = draw(234, 7)
    (hidden,) = case.hidden
    truth, machine = hidden.values['compliance'], case.setup.machine
    write_case(case, tmp_path)
    nominal = Variant.of(load_model_or_machine(str(tmp_path / MACHINE)))
    log = load_log(tmp_path / ESTIMATION, str(tmp_path / MAP), None, None, None, None)
    records = aligned_records([log], nominal, moved=False)
    nominal = sized_by(records, nominal)
    dense, _ = nuisance(nominal, records, Settings())
    (times,) = (effect for effect in dense if effect.name == 'nuisance_times')
    gives = find('gearbox_compliance')
    causes = tuple(
        Cause(effect, machine.axis, dict(values))
        for effect, values in (
            (gives, {'compliance': truth}),
            (times, times.typical(nominal, machine.axis)),
        )
    )
    problem = Problem(nominal, records)
    coarse, fine = (
        fit_causes(one, causes).causes[0].values['compliance'] for one in (problem, problem.fine())
    )
    reduced = 1.0 / (1.0 / machine.inertia + 1.0 / (machine.motor_inertia * machine.ratio**2))
    step_s = 1.0 / (4.0 * case.setup.tick_hz)
    assert coarse / truth - 1.0 == pytest.approx(-(step_s**2) / (truth * reduced) / 6.0, rel=0.5)
    assert abs(fine / truth - 1.0) < 1e-3


def test_an_encoder_of_another_scale_leaves_what_another_force_constant_does(tmp_path):
    """
    Without friction and weight, x' = (1 + s) x and a force constant (1 + s) k are the same machine.

    An observer that corrects by counts of the model's scale is slower by that: the scale explained a log
    better than the force constant that was wrong, by 10 in ln L, and was named with certainty.
    """
    case = draw(249, 3)
    machine = case.setup.machine
    assert machine.linear
    assert machine.coulomb == machine.viscous == 0.0
    write_case(case, tmp_path)
    nominal = Variant.of(load_model_or_machine(str(tmp_path / MACHINE)))
    log = load_log(tmp_path / ESTIMATION, str(tmp_path / MAP), None, None, None, None)
    problem = Problem(nominal, aligned_records([log], nominal, moved=False))
    left = {}
    for name, values in {
        'encoder_scale': {'error': -0.05},
        'force_constant': {'ratio': 0.95},
    }.items():
        cause = Cause(find(name), machine.axis, values)
        (left[name],) = evaluate(problem, (cause,)).residuals['plant']
    (before,) = evaluate(problem).residuals['plant']
    assert np.std(left['force_constant'] - before) > 0.1
    np.testing.assert_allclose(left['encoder_scale'], left['force_constant'], atol=2e-3)
