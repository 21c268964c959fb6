# SPDX-License-Identifier: Apache-2.0
"""The bench of the diagnosis: what is drawn, how effects are sized, how results are counted."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from independent_machine.answers import TIME, Answer, Answers
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent / 'bench'))

import bench_diagnosis
from diagnosis_matrix import (
    demonstration,
    deviations,
    differences,
    other_simulator,
    requirements,
    scoring,
    summary,
    trial,
)
from diagnosis_matrix.cases import COUNTS, GROUPS, Case, cases, draw, draw_direction, pairs
from diagnosis_matrix.motions import DURATION_S, draw_experiment
from diagnosis_matrix.sizing import (
    CLOSE,
    NeverNeutral,
    OutOfReach,
    scale_of_size,
    size,
    size_of_change,
    sizes_of_each,
)

import waferbot
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.corrections import Correction
from waferbot_twin.effects import find
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_recording
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import noise, synthesize

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


# Drawing


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_drawn_motions_keep_the_limits_of_the_controller_and_move_every_axis(rigid, seed):
    experiment = load_experiment(draw_experiment(rigid, np.random.default_rng(seed)))
    parameters = servo_parameters(rigid.pmac, 'rigid')
    rate_hz = Timing().servo_hz
    positions = commanded_positions(experiment, parameters, rate_hz)
    assert len(positions) == round(DURATION_S * rate_hz)
    assert (np.ptp(positions, axis=0) > 10.0).all()
    assert (positions[0] == 0.0).all()
    for axis, (motion,) in enumerate(experiment.motion.values()):
        if motion.values['kind'] in ('linear', 'constant_velocity'):
            speed = np.abs(np.diff(positions[:, axis])).max() * rate_hz
            assert speed <= 1e3 * parameters['Ixx16'][0, axis] * (1.0 + 1e-9)
            acceleration = np.abs(np.diff(positions[:, axis], 2)).max() * rate_hz**2
            assert acceleration <= 1e6 * parameters['Ixx17'][0, axis] * (1.0 + 1e-6)


def test_a_seed_is_one_set_of_cases_and_another_seed_another(rigid):
    names = pairs(rigid)

    def drawn(seed):
        chosen = itertools.islice(cases(GROUPS['two'], names, seed), 5)
        return [(case.key, draw(case, rigid)) for case in chosen]

    assert drawn(4) == drawn(4)
    assert drawn(4) != drawn(5)


def test_sizes_differ_in_nothing_but_the_size(rigid):
    for number in range(3):
        three, ten = (
            Case(g, ('backlash:y_rotate',), number, 9) for g in ('single-3', 'single-10')
        )
        assert draw(three, rigid) == draw(ten, rigid)
        assert three.key != ten.key


def test_without_a_size_effects_are_as_large_as_they_typically_are(rigid):
    effect = find('coulomb_friction')
    typical = effect.typical(rigid, 'x_rotate')['friction']
    for number in range(3):
        case = Case('typical', ('coulomb_friction:x_rotate',), number, 9)
        (hidden,), (size,) = trial._sized(case, draw(case, rigid), 'rigid')
        assert 0.5 * typical <= hidden.values['friction'] <= 1.5 * typical
        assert size > 10.0


def test_all_effects_come_once_before_one_comes_again(rigid):
    names = pairs(rigid)
    order = [
        c.hidden[0] for c in itertools.islice(cases(GROUPS['single-3'], names, 1), 2 * len(names))
    ]
    assert sorted(order[: len(names)]) == sorted(order[len(names) :]) == sorted(names)
    assert order[: len(names)] != order[len(names) :]


def test_a_chosen_effect_has_the_same_cases_alone_as_in_the_whole_matrix(rigid):
    of_all = [c for c in itertools.islice(cases(GROUPS['single-3'], pairs(rigid), 1), 304)]
    alone = set(itertools.islice(cases(GROUPS['single-3'], pairs(rigid, ['backlash']), 1), 2))
    assert alone <= set(of_all)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, scale=st.floats(1e-4, 1.0))
def test_drawn_values_are_ones_that_the_effect_can_have(rigid, seed, scale):
    random = np.random.default_rng(seed)
    name = str(random.choice(pairs(rigid)))
    effect, axis = find(name.split(':')[0]), name.split(':')[1]
    direction = draw_direction(name, rigid, random)
    values = direction.values(scale * direction.largest_scale)
    assert effect.complete(rigid, axis, values) == values
    nothing = direction.values(0.0)
    for item in effect.parameters(rigid, axis):
        assert item.shape or nothing[item.name] == item.neutral


@pytest.mark.parametrize('group', ['several', 'everything-off'])
def test_several_effects_are_drawn_over_all_axes_and_blocks(rigid, group):
    fewest, most = COUNTS[GROUPS[group].kind]
    drawn = [draw(Case(group, (), number, 3), rigid) for number in range(60)]
    assert {len(one.hidden) for one in drawn} == set(range(fewest, most + 1))
    assert all(len(set(one.hidden)) == len(one.hidden) for one in drawn)
    names = [name.split(':') for one in drawn for name in one.hidden]
    assert {axis for _, axis in names} == {'y_linear', 'x_rotate', 'y_rotate'}
    blocks = [find(effect).block.value for effect, _ in names]
    assert {'plant', 'motor', 'amplifier', 'controller', 'sensor'} <= set(blocks)
    # No block is crowded out by one of which the library knows more.
    assert max(blocks.count(block) for block in set(blocks)) < 0.4 * len(blocks)
    own_corrections = {effect for effect, _ in names} & set(deviations.CORRECTED)
    assert not own_corrections if group == 'everything-off' else own_corrections


def test_another_attempt_hides_other_effects_in_the_same_motions(rigid):
    case = Case('everything-off', (), 0, 3)
    first, again, other = (draw(case, rigid, attempt) for attempt in (0, 0, 1))
    assert first == again
    assert other.hidden != first.hidden
    assert (other.finding, other.judging, other.noise) == (
        first.finding,
        first.judging,
        first.noise,
    )
    assert other.deviations == first.deviations


def test_an_unknown_effect_is_among_two_known_ones_that_stay_in_the_library(rigid):
    group = GROUPS['unknown-among-known']
    for case in itertools.islice(cases(group, pairs(rigid), 3), 40):
        assert len({name.split(':')[0] for name in case.hidden}) == 3


def test_empty_logs_have_coloured_forces_and_another_motion_for_validation(rigid):
    for number in range(5):
        drawn = draw(Case('nothing', (), number, 3), rigid)
        assert drawn.hidden == ()
        assert len({motion for motion, _ in (*drawn.finding, *drawn.judging)}) >= 2
    overlay = noise(rigid, 1.0, 1, np.random.default_rng(1))
    forces = overlay.machine['disturbances'].values()
    assert {force['kind'] for force in forces} == {'noise'}
    assert len({force['bandwidth_hz'] for force in forces}) == 3


# Everything a little off


@pytest.fixture(scope='module')
def with_friction(rigid):
    return deviations.with_friction(rigid)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_every_number_is_off_by_two_to_five_percent(with_friction, seed):
    drawn = deviations.draw_deviations(with_friction, np.random.default_rng(seed))
    assert [item.path for item in drawn] == deviations.paths(with_friction)
    assert all(0.02 <= abs(item.factor - 1.0) <= 0.05 for item in drawn)
    machine = deviations.off(with_friction, drawn)
    before, after = with_friction.description, machine.description
    factors = {item.path: item.factor for item in drawn}
    for name, body in before.bodies.items():
        assert after.bodies[name].mass == pytest.approx(factors[f'bodies.{name}'] * body.mass)
    for name, rotor in before.rotors.items():
        found = after.rotors[name].inertia
        assert found == pytest.approx(factors[f'rotors.{name}'] * rotor.inertia)
    for name, motor in before.motors.items():
        found = after.motors[name].back_emf
        assert found == pytest.approx(factors[f'motors.{name}'] * motor.back_emf)
    for name, friction in before.frictions.items():
        found = after.frictions[name].resistances
        assert found == pytest.approx(factors[f'frictions.{name}'] * friction.resistances)
    for name, damper in before.dampers.items():
        found = after.dampers[name].damping
        assert found == pytest.approx(factors[f'dampers.{name}'] * damper.damping)


@pytest.mark.parametrize('model', ['rigid', 'flexible', 'as_built'])
def test_numbers_of_every_shipped_model_can_be_off(model):
    variant = deviations.with_friction(Variant.of(load_model(model)))
    drawn = deviations.draw_deviations(variant, np.random.default_rng(2))
    sections = {item.path.split('.')[0] for item in drawn}
    assert {'bodies', 'rotors', 'motors', 'frictions'} <= sections
    # Friction of a bearing by its part goes with the weight on it, so that masses stay as they are here.
    drawn = tuple(item for item in drawn if item.path.startswith('frictions.'))
    before, after = variant.description, deviations.off(variant, drawn).description
    for name, friction in before.frictions.items():
        ratio = after.frictions[name].resistances / friction.resistances
        factor = next(item.factor for item in drawn if item.path == f'frictions.{name}')
        assert ratio == pytest.approx(factor)


def test_frictions_of_a_model_are_its_own_and_effects_add_to_them(rigid, with_friction):
    assert deviations.with_friction(with_friction) is with_friction
    assert with_friction.base is with_friction
    more = find('coulomb_friction').apply(with_friction, 'x_rotate', {'friction': 1.0})
    found = deviations.equivalents(with_friction, more)
    assert found['coulomb_friction:x_rotate.friction'] == pytest.approx(1.0)
    assert found['coulomb_friction:y_rotate.friction'] == 0.0


@settings(max_examples=20, deadline=None)
@given(
    mass=st.floats(-2.0, 2.0),
    weight=st.floats(-2.0, 2.0),
    x=st.floats(-0.05, 0.05),
    y=st.floats(-0.02, 0.02),
    ratio=st.floats(0.95, 1.05),
)
def test_equivalents_are_the_values_of_the_effects_that_were_applied(
    with_friction, mass, weight, x, y, ratio
):
    applied = {
        'wrong_inertia:y_linear.mass': mass,
        'counterweight_mass:y_linear.mass': weight,
        'wrong_inertia:x_rotate.inertia': x,
        'wrong_inertia:y_rotate.inertia': y,
        'force_constant:x_rotate.ratio': ratio,
        'viscous_friction:y_linear.damping': 3.0,
        'coulomb_friction:y_rotate.friction': 0.2,
    }
    true = with_friction
    for path, value in applied.items():
        name, parameter = path.split('.')
        effect, axis = name.split(':')
        true = find(effect).apply(true, axis, {parameter: value})
    found = deviations.equivalents(with_friction, true)
    for path, value in found.items():
        neutral = 1.0 if path.endswith('.ratio') else 0.0
        assert value == pytest.approx(applied.get(path, neutral), abs=1e-9), path


def test_masses_that_are_off_pull_on_an_axis_that_is_out_of_balance(with_friction):
    (heavier,) = (
        deviations.Deviation(path, 1.05)
        for path in deviations.paths(with_friction)
        if path == 'bodies.y_rotate_load'
    )
    true = deviations.off(with_friction, (heavier,))
    body = with_friction.description.bodies['y_rotate_load']
    # Its weight on its lever about X-Rotate, right-handed: x about the payload's axis, z its lever.
    expected = 0.05 * body.mass * 9.81 * body.centre_of_gravity[2]
    found = deviations.equivalents(with_friction, true)
    assert abs(found['constant_force:x_rotate.force']) == pytest.approx(expected)
    assert found['constant_force:y_linear.force'] == pytest.approx(0.0, abs=1e-9)
    assert found['wrong_inertia:y_linear.mass'] == pytest.approx(0.05 * body.mass)


def test_logs_of_a_machine_that_is_a_little_off_can_be_made_again():
    case = Case('everything-off', (), 1, 77)
    one, other = (trial._laid(case, 'rigid') for _ in range(2))
    assert one.sizes == other.sizes
    assert all(size > 0.0 for size in one.sizes)
    for first, second in zip(one.finding, other.finding, strict=True):
        np.testing.assert_array_equal(first.reading, second.reading)
    # Diagnosed against a model that has the numbers, the frictions too, before they were off.
    assert set(deviations.paths(one.nominal)) == {item.path for item in one.drawn.deviations}
    apart = deviations.equivalents(one.nominal, one.machine)
    assert apart['force_constant:y_linear.ratio'] != 1.0
    assert one.hidden
    assert set(one.size_of) == {cause.name for cause in one.hidden}


def test_an_effect_that_another_one_hides_is_as_small_as_it_looks(rigid):
    case = Case('nothing', (), 1, 5)
    drawn = draw(case, rigid)
    effect = find('coulomb_friction')
    own = Cause(effect, 'x_rotate', effect.typical(rigid, 'x_rotate'))
    gone = Cause(find('output_limit'), 'y_rotate', {'limit': 32767.0})
    records = trial.logs(apply_all(rigid, [own, gone]), 'rigid', drawn.noise, drawn.finding)
    problem = Problem(rigid, records)
    alone = size(Problem(rigid, records), [own])
    found = sizes_of_each(problem, [own, gone])
    assert found[0] == pytest.approx(alone)
    assert found[1] == 0.0


# What differs between two models


def test_nothing_differs_between_a_model_and_itself(rigid):
    assert differences.differing(rigid, rigid) == []


@pytest.mark.parametrize(
    'name',
    [
        'cable_compliance:y_linear', 'belt_compliance:y_rotate', 'coulomb_friction:x_rotate',
        'viscous_friction:y_rotate', 'counterweight_mass:y_linear', 'force_constant:y_rotate',
        'wrong_bias:x_rotate', 'wrong_inertia:y_rotate', 'velocity_strengthening_friction:x_rotate',
        'dead_time:y_linear', 'notch:x_rotate',
    ],
)  # fmt: skip
def test_an_effect_that_was_applied_is_in_the_list_of_what_differs(rigid, name):
    effect, axis = name.split(':')
    real = find(effect).apply(rigid, axis, find(effect).typical(rigid, axis))
    found = differences.differing(rigid, real)
    assert name in found
    # What an axis carries is carried by others as well.
    elsewhere = [one for one in found if not one.endswith(f':{axis}')]
    assert all(one.startswith('wrong_inertia') for one in elsewhere)


def test_the_machine_as_built_differs_in_what_the_thesis_says_and_not_in_what_it_lacks(rigid):
    found = differences.differing(rigid, Variant.of(load_model('as_built')))
    for name in ('cable_compliance:y_linear', 'bearing_moment_compliance:x_rotate',
                 'belt_compliance:y_rotate', 'gearbox_compliance:y_rotate',
                 'gearbox_friction:y_rotate', 'coulomb_friction:y_rotate',
                 'encoder_delay:x_rotate', 'wrong_bias:x_rotate'):  # fmt: skip
        assert name in found
    absent = {
        'backlash', 'cable_slack', 'belt_slip', 'cogging', 'stribeck_friction', 'presliding', 'wafer',
        'direction_dependent_friction', 'winding_temperature', 'wrong_proportional_gain', 'notch',
        'encoder_scale', 'dead_time', 'constant_force', 'transmission_error',
    }  # fmt: skip
    assert not absent & {name.split(':')[0] for name in found}
    assert 'wrong_bias:y_rotate' not in found
    assert 'velocity_strengthening_friction:y_rotate' not in found


# Sizing


@settings(max_examples=30, deadline=None)
@given(ratio=st.floats(0.1, 50.0), deviation=st.floats(1e-6, 1e6), samples=st.integers(500, 5000))
def test_size_in_white_noise_is_the_rms_over_the_smallest_that_can_be_detected(
    ratio, deviation, samples
):
    smallest = deviation * math.sqrt(math.log(samples) / samples)
    change = np.sin(0.37 * np.arange(samples))
    change *= ratio * smallest / math.sqrt(float(np.mean(change**2)))
    found = size_of_change([change / deviation], samples)
    assert found == pytest.approx(ratio, rel=1e-9)


def test_size_in_coloured_noise_is_the_likelihood_ratio_of_a_simulation():
    seed = 20240518
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    taps, deviation, samples = np.array([1.0, -1.6, 0.8]), 0.3, 4000
    change = 0.2 * np.sin(0.05 * np.arange(samples))
    gains = []
    for _ in range(300):
        noise = lfilter([deviation], taps, random.standard_normal(samples))
        with_it, without = (lfilter(taps, 1.0, noise + d)[2:] for d in (change, 0.0))
        gains.append((np.sum(with_it**2) - np.sum(without**2)) / deviation**2)
    # A mean of 300 whose spread is 2 sqrt(gain) each
    white = lfilter(taps, 1.0, change)[2:] / deviation
    expected = size_of_change([white], samples) ** 2 * math.log(samples)
    assert np.mean(gains) == pytest.approx(expected, abs=4.0 * 2.0 * math.sqrt(expected / 300.0))


@given(
    slope=st.floats(1e-3, 1e3),
    power=st.floats(0.6, 2.0),
    wanted=st.sampled_from([1.0, 3.0, 10.0]),
)
def test_the_scale_of_a_size_is_found(slope, power, wanted):
    scale, found = scale_of_size(lambda s: slope * s**power, wanted, math.inf)
    assert found == slope * scale**power
    assert wanted / CLOSE <= found <= wanted * CLOSE


def test_of_an_effect_in_steps_the_smallest_that_is_enough_is_taken():
    scale, found = scale_of_size(lambda s: 40.0 * math.floor(s), 10.0, 50.0)
    assert found == 40.0
    assert scale == pytest.approx(1.0, rel=0.03)


def test_unstable_machines_bound_the_scale():
    def size_at(scale):
        if scale > 0.01:
            raise UserError('unstable')
        return 2000.0 * scale

    _, found = scale_of_size(size_at, 10.0, 50.0)
    assert found == pytest.approx(10.0, rel=CLOSE - 1.0)
    with pytest.raises(OutOfReach):
        scale_of_size(size_at, 100.0, 50.0)


def test_what_cannot_have_the_size_is_said_to_be_out_of_reach():
    with pytest.raises(OutOfReach, match='out of reach'):
        scale_of_size(lambda s: s, 10.0, 2.0)
    with pytest.raises(OutOfReach):
        scale_of_size(lambda s: 0.0, 10.0, 2.0)
    with pytest.raises(NeverNeutral, match='however little'):
        scale_of_size(lambda s: 10.0 + s, 10.0, 2.0)
    with pytest.raises(NeverNeutral, match='however little'):  # a belt let go, never to slip
        scale_of_size(lambda s: 40.0 if s > 1e-15 else 0.0, 10.0, 2.0)


# Scoring


def cause(name, group=(), probability=0.99):
    def member(name):
        effect, axis = name.split(':')
        return {'effect': effect, 'axis': axis}

    return {
        **member(name),
        'credible_set': [member(one) for one in (name, *group)],
        'probability': probability,
    }


def report(*causes, unexplained=(), withdrawn=()):
    verdict = 'partly' if causes and unexplained else 'explained' if causes else 'consistent'
    return {
        'verdict': 'unexplained' if unexplained and not causes else verdict,
        'causes': list(causes),
        'unexplained': [{'axis': axis} for axis in unexplained],
        'withdrawn': list(withdrawn),
    }


def test_a_single_effect_counts_as_named_only_by_name_and_axis_first():
    truth = 'backlash:y_rotate'

    def outcome(*causes, inseparable=False, **rest):
        return scoring.outcome_of_single(report(*causes, **rest), truth, inseparable)

    assert outcome(cause(truth)) == 'right'
    assert outcome(cause(truth), cause('cogging:y_linear')) == 'right'
    assert outcome(cause('cogging:y_linear'), cause(truth)) == 'later'
    assert outcome(cause('backlash:x_rotate')) == 'axis'
    assert outcome(cause('cogging:y_rotate')) == 'wrong'
    assert outcome() == 'missed'
    assert outcome(withdrawn=[truth]) == 'withdrawn'
    assert outcome(unexplained=['y_rotate']) == 'unexplained'


@pytest.mark.parametrize(
    ('others', 'inseparable', 'expected'),
    [
        ([], True, 'group'),
        (['presliding:y_rotate'], True, 'group'),
        (['presliding:y_rotate'], False, 'wrong'),
        (['presliding:y_rotate', 'coulomb_friction:y_rotate'], True, 'wrong'),
    ],
)
def test_a_group_counts_if_it_has_at_most_three_that_the_data_cannot_separate(
    others, inseparable, expected
):
    truth = 'backlash:y_rotate'
    found = report(cause('gearbox_compliance:y_rotate', [truth, *others]))
    assert scoring.outcome_of_single(found, truth, inseparable) == expected


def test_two_effects():
    one, other, false = 'backlash:y_rotate', 'cogging:y_linear', 'wafer:y_rotate'

    def outcome(*names, **rest):
        return scoring.outcome_of_two(report(*map(cause, names), **rest), (one, other), False)

    assert outcome(one, other) == outcome(other, one) == 'both'
    assert outcome(one, other, false) == 'both and a false one'
    assert outcome(one) == 'one'
    assert outcome(one, false) == 'one and a false one'
    assert outcome(false) == 'false in place'
    assert outcome() == 'none'
    assert outcome(withdrawn=[one]) == 'withdrawn'


def test_nothing_and_unknown():
    assert scoring.outcome_of_nothing(report()) == 'right'
    assert scoring.outcome_of_nothing(report(cause('wafer:y_rotate'))) == 'false alarm'
    assert scoring.outcome_of_nothing(report(unexplained=['x_rotate'])) == 'unexplained'
    truth = 'backlash:y_rotate'
    twin = report(cause('presliding:y_rotate'))
    assert scoring.outcome_of_unknown(report(unexplained=['y_rotate']), truth, False) == 'right'
    assert (
        scoring.outcome_of_unknown(report(unexplained=['x_rotate']), truth, False) == 'other axis'
    )
    assert scoring.outcome_of_unknown(report(), truth, False) == 'missed'
    assert scoring.outcome_of_unknown(twin, truth, True) == 'twin'
    assert scoring.outcome_of_unknown(twin, truth, False) == 'wrong'


def test_wrong_and_sure():
    sure, unsure = (report(cause('wafer:y_rotate', probability=c)) for c in (0.95, 0.6))
    assert scoring.wrong_and_sure(sure, 'wrong')
    assert not scoring.wrong_and_sure(unsure, 'wrong')
    assert not scoring.wrong_and_sure(sure, 'right')
    assert not scoring.wrong_and_sure(report(), 'missed')


def test_errors_are_relative_to_what_is_meant(rigid):
    def only(effect, name, real, value, low, high, inertia=1.0):
        found = {
            'effect': effect,
            'parameters': {name: {'value': value, 'low95': low, 'high95': high}},
        }
        parameters = [p for p in find(effect).parameters(rigid, 'y_rotate') if p.name == name]
        (error,) = scoring.parameter_errors(found, {name: real}, parameters, inertia)
        return error

    friction = only('coulomb_friction', 'friction', 2.0, 2.1, 1.9, 2.3)
    assert friction.error == pytest.approx(0.05)
    assert friction.covered
    gain = only('wrong_derivative_gain', 'ratio', 0.9, 0.909, 0.908, 0.91)
    assert (gain.kind, gain.covered) == ('gain', False)
    assert gain.error == pytest.approx(0.01)
    inertia = only('wrong_inertia', 'inertia', 0.25, 0.2, math.nan, math.nan, inertia=0.75)
    assert (inertia.kind, inertia.covered) == ('inertia', None)
    assert inertia.error == pytest.approx(0.05)
    cycle = 1.0 / 9.0  # ms
    late = only('encoder_delay', 'delay', 3.0 * cycle, 3.2 * cycle, 2.0 * cycle, 4.0 * cycle)
    assert late.error == pytest.approx(0.2)


def test_a_parameter_that_is_neutral_in_truth_has_no_relative_error():
    item = Parameter('sine', 'N', 0.0, 1.0, -10.0, 10.0, '')
    found = {
        'effect': 'cogging',
        'parameters': {'sine': {'value': 1.0, 'low95': 0.0, 'high95': 2.0}},
    }
    assert scoring.parameter_errors(found, {'sine': 0.0}, [item], 1.0) == []


def test_several_effects_are_named_by_themselves_or_in_a_set_of_three():
    one, two, other, same = (
        'backlash:y_rotate', 'cogging:y_linear', 'wafer:y_rotate', 'gearbox_friction:y_rotate',
    )  # fmt: skip
    coulomb = 'coulomb_friction:y_rotate'
    hidden = {one: 5.0, two: 1.0, coulomb: 4.0}
    causes = [
        cause(one, probability=0.99),
        cause(other, [two, 'presliding:y_linear'], 0.6),
        cause(same, probability=0.9),
        cause('presliding:x_rotate', probability=0.5),
    ]
    found = scoring.effects_and_names(causes, hidden, {same: coulomb})
    assert [item['became'] for item in found['effects']] == ['named', 'in the set', 'named']
    assert [item['true'] for item in found['names']] == [True, False, True, False]
    assert [item['in_set'] for item in found['names']] == [True, True, True, False]
    assert [scoring.is_false(item) for item in found['names']] == [False, False, False, True]
    assert scoring.outcome_of_several(**found) == 'all and a false one'
    without = scoring.effects_and_names([], hidden, {})
    assert scoring.outcome_of_several(**without) == 'none'
    # What the logs do not show cannot be missed.
    assert scoring.outcome_of_several([without['effects'][1]], []) == 'all'
    wide = [cause(other, [two, 'presliding:y_linear', 'stribeck_friction:y_linear'])]
    found = scoring.effects_and_names(wide, hidden, {})
    assert found['effects'][1]['became'] == 'missed'
    assert scoring.is_false(found['names'][0])


def test_names_that_the_logs_cannot_tell_from_an_unknown_effect_are_neither_true_nor_false():
    known, twin = 'cogging:y_linear', 'presliding:y_rotate'
    found = scoring.effects_and_names([cause(known), cause(twin)], {known: 5.0}, {}, related=True)
    assert [item['related'] for item in found['names']] == [False, True]
    assert not any(map(scoring.is_false, found['names']))


def test_an_unknown_effect_among_known_ones():
    truth, known = 'backlash:y_rotate', ['cogging:y_linear', 'wafer:x_rotate']
    reports = {
        'right': report(*map(cause, known), unexplained=['y_rotate']),
        'missed': report(*map(cause, known)),
        'other axis': report(cause(known[0]), unexplained=['y_linear']),
        'wrong': report(cause(known[0]), cause('presliding:y_rotate')),
    }
    for outcome, found in reports.items():
        assert scoring.outcome_of_unknown(found, truth, False, known) == outcome
    assert scoring.outcome_of_unknown(reports['wrong'], truth, True, known) == 'twin'


def test_corrections_are_scored_by_the_numbers_that_are_off():
    def correction(path, nominal, low, high):
        item = Correction('in words', path, 'kg', nominal, low, low, high)
        return {**dataclasses.asdict(item), 'low': low, 'high': high}

    truth = {'bodies.carriage': 1.02, 'motors.x_rotate': 0.96}
    given = [
        correction('bodies.carriage.mass_kg', 97.0, 98.0, 99.0),
        correction('bodies.carriage.mass_kg', 97.0, 96.0, 98.0),
        correction('motors.x_rotate.back_emf_lead_to_lead_v_s_rad', 2.9, 2.7, 2.8),
        correction('motors.x_rotate.back_emf_lead_to_lead_v_s_rad', 1.0, None, None),
        correction('rotors.another.inertia_kg_m2', 1.0, 0.9, 1.1),
    ]
    found = scoring.corrections({'corrections': given}, truth)
    assert [item['covered'] for item in found] == [True, False, True, None, None]
    assert found[2]['truth'] == pytest.approx(2.784)
    assert scoring.corrections({}, truth) == []


def test_the_demonstration_is_scored_by_what_differs():
    def with_values(name, probability=0.9, **values):
        return {
            **cause(name, probability=probability),
            'parameters': {
                key: {'value': value, 'low95': low, 'high95': high}
                for key, (value, low, high) in values.items()
            },
        }

    found = {
        **report(
            with_values('cable_compliance:y_linear'),
            with_values('force_constant:x_rotate', ratio=(0.55, 0.54, 0.56)),
            with_values('gearbox_friction:y_rotate', friction=(0.05, 0.04, 0.06)),
            with_values('wafer:y_rotate'),
            unexplained=['x_rotate'],
        ),
        'gain': {'axes': {'y_linear': {'improvement_percent': 70.0}}},
        'corrections': [],
    }
    differs = ['cable_compliance:y_linear', 'force_constant:x_rotate', 'coulomb_friction:y_rotate']
    same = {'gearbox_friction:y_rotate': 'coulomb_friction:y_rotate'}
    scored = demonstration.score(found, differs, {'force_constant:x_rotate.ratio': 0.82}, same)
    assert scored['outcome'] == 'a false name'
    assert [item['true'] for item in scored['names']] == [True, True, True, False]
    assert scored['found'] == {
        'cables': True,
        'X-Rotate bearing': False,
        'belt or gearbox': False,
        'Y-Rotate friction': True,
    }
    assert [item['covered'] for item in scored['demo_errors']] == [False]
    rows = rows_of([{**line('demo', '', 0.0, runtime_s=59.0), **scored}])
    group = 'as built against rigid'
    assert rows[group, 'causes named that differ'].met is False
    assert rows[group, 'cables among them'].met is True
    assert rows[group, 'X-Rotate bearing among them'].met is False
    assert rows[group, 'values known within their interval'].met is False
    assert rows[group, 'gain on y_linear'].met is True
    assert rows[group, 'gain on x_rotate'].met is False
    assert rows[group, 'time'].met is True
    (crashed,) = (
        row for key, row in rows_of([line('demo', 'crashed', 0.0)]).items() if key[0] == group
    )
    assert crashed.met is False


def test_the_demonstration_is_that_of_the_command_without_ros(monkeypatch):
    asked = []
    found = {
        **report(cause('cable_compliance:y_linear'), unexplained=['x_rotate']),
        'gain': {'axes': {'y_linear': {'improvement_percent': 70.0}}},
        'corrections': [],
    }
    found['causes'][0]['parameters'] = {}

    def diagnose(model, logs, validation, progress):
        asked.append((model.name, [log.name for log in logs], [log.name for log in validation]))
        return SimpleNamespace(details=found)

    monkeypatch.setattr(waferbot, 'diagnose', diagnose)
    monkeypatch.setattr(demonstration, 'as_dict', lambda found, quick: found)
    done = trial.run(Case('demo', (), 0, 77), 'rigid', False)
    assert done['outcome'] == 'all names true', done.get('reason')
    assert asked == [('rigid', ['moves', 'random_steps'], ['steps'])]
    assert 'encoder_delay:x_rotate' in done['differs']
    assert done['found']['cables']
    json.dumps(done)


def test_what_a_twin_explains_is_diagnosed_again_without_it():
    truth = 'direction_dependent_friction:y_rotate'
    twin, also, other = 'coulomb_friction:y_rotate', 'stribeck_friction:y_rotate', 'wafer:y_rotate'
    asked = []

    def judged(without):
        asked.append(tuple(without))
        reports = [
            report(cause(twin, [also])),
            report(cause(other)),
            report(unexplained=['y_rotate']),
        ]
        found = reports[len(asked) - 1]
        return {
            'outcome': scoring.outcome_of_unknown(found, truth, True),
            'reported': [
                {'name': scoring.name_of(c), 'group': scoring.others_of(c)}
                for c in found['causes']
            ],
            'unexplained': found['unexplained'],
        }

    own = ['direction_dependent_friction']
    found = trial._without_twins(judged(own), own, judged)
    frictions = ('coulomb_friction', 'stribeck_friction')
    assert asked == [tuple(own), (*own, *frictions), (*own, *frictions, 'wafer')]
    assert found['taken_out'] == [*frictions, 'wafer']
    assert found['outcome'] == 'right'

    asked.clear()
    wrong = {'outcome': 'wrong', 'reported': [], 'unexplained': [], 'names': []}
    assert trial._without_twins(wrong, own, judged) == {'taken_out': [], **wrong}
    assert not asked


def test_what_is_known_beside_an_unknown_effect_stays_in_the_library():
    known, twin = 'wafer:y_rotate', 'presliding:y_rotate'
    asked = []

    def judged(without):
        asked.append(tuple(without))
        return {
            'outcome': 'twin' if len(asked) < 3 else 'right',
            'reported': [
                {'name': known, 'group': []},
                *({'name': one, 'group': []} for one in [twin][: 2 - len(asked)]),
            ],
            'unexplained': [],
        }

    trial._without_twins(judged(['backlash']), ['backlash'], judged, [known])
    # Nothing is left to take out: it is not asked for ever.
    assert asked == [('backlash',), ('backlash', 'presliding')]


# A case from beginning to end, with a diagnosis that is told what to say


def said(laid, named, false=(), unexplained=()):
    """A report that names some of what is hidden, with its true values, and corrects all that is off."""
    causes = []
    for one in [*named, *false]:
        values = {
            key: {'value': value, 'low95': value - 1e-9, 'high95': value + 1e-9}
            for key, value in one.values.items()
        }
        causes.append({**cause(one.name), 'log_evidence': 9.0, 'parameters': values})
    corrections = [
        {
            'path': f'{item.path}.key', 'nominal': 2.0, 'found': 2.0 * item.factor,
            'low': 2.0 * item.factor - 1e-9, 'high': 2.0 * item.factor + 1e-9,
        }
        for item in laid.drawn.deviations
    ]  # fmt: skip
    gain = {'rms_before': 2.0, 'rms_after': 1.0, 'improvement_percent': 50.0}
    return {
        **report(*causes, unexplained=unexplained),
        'corrections': corrections,
        'gain': {
            'validation': [record.name for record in laid.judging],
            'axes': dict.fromkeys(('y_linear', 'x_rotate', 'y_rotate'), gain),
        },
        'runtime_s': 1.0,
    }


def run_with(monkeypatch, case, say):
    """The line of a case whose diagnosis is `say(laid, without)`."""
    laid = trial._laid(case, 'rigid')
    monkeypatch.setattr(trial, 'diagnose', lambda *given: say(laid, given[5]))
    monkeypatch.setattr(trial, 'as_dict', lambda found, quick: found)
    return laid, trial.run(case, 'rigid', False)


def test_a_case_with_everything_off_from_drawing_to_score(monkeypatch):
    case = Case('everything-off', (), 1, 77)
    effect = find('force_constant')
    false = Cause(effect, 'x_rotate', effect.typical(trial.nominal('rigid'), 'x_rotate'))
    laid, found = run_with(
        monkeypatch, case, lambda laid, without: said(laid, laid.hidden[:1], [false])
    )
    assert found['outcome'] == 'some and a false one', found.get('reason')
    assert [item['became'] for item in found['effects']] == ['named', 'missed']
    assert [item['true'] for item in found['names']] == [True, False]
    assert found['hidden'] == [one.name for one in laid.hidden]
    assert found['deviations'].keys() == set(deviations.paths(laid.nominal))
    assert len(found['corrections']) > 10
    assert all(item['covered'] for item in found['corrections'])
    assert {error['effect'] for error in found['errors']} == {laid.hidden[0].effect.name}
    assert all(error['covered'] for error in found['errors'])
    rows = rows_of([found])
    as_cause = rows['everything-off', 'names that are a correction reported as a cause']
    assert (as_cause.seen['hits'], as_cause.seen['cases']) == (1, 2)
    json.dumps(found)


def test_a_case_of_several_that_crashes_has_missed_what_was_hidden(monkeypatch):
    def crashes(laid, without):
        raise RuntimeError('a defect')

    laid, found = run_with(monkeypatch, Case('several', (), 1, 77), crashes)
    assert found['outcome'] == 'crashed'
    assert 'a defect' in found['reason']
    assert len(found['effects']) == len(laid.hidden) >= 3
    assert {item['became'] for item in found['effects']} == {'missed'}
    named = rows_of([found])['several', 'effects of size 3 and more named']
    assert (named.seen['hits'], named.met) == (0, False)


@pytest.mark.slow
def test_a_case_with_an_unknown_effect_among_known_ones(monkeypatch, rigid):
    case = next(cases(GROUPS['unknown-among-known'], pairs(rigid), 77))
    asked = []

    def say(laid, without):
        asked.append(list(without))
        unknown = laid.hidden[0]
        return said(laid, laid.hidden[1:], unexplained=[unknown.axis])

    laid, found = run_with(monkeypatch, case, say)
    assert found['outcome'] == 'right', found.get('reason')
    assert asked == [[laid.hidden[0].effect.name]]
    assert [item['name'] for item in found['effects']] == [one.name for one in laid.hidden[1:]]
    assert all(item['true'] for item in found['names'])
    assert found['without_twins']['outcome'] == 'right'
    assert not requirements.has_false_name(found)


# Counting


def line(group, outcome, size, **rest):
    return {
        'group': group,
        'hidden': ['wafer:y_rotate'],
        'outcome': outcome,
        'sizes': [size],
        **rest,
    }


def test_what_is_left_out_is_not_judged_but_a_crash_is():
    lines = [
        line('single-10', 'right', 10.0),
        line('single-10', 'group', 10.0),
        line('single-10', 'crashed', 10.0),
        line('single-10', 'left out', 10.0),
    ]
    found = summary.summarise(lines)
    group = found['groups']['single-10']
    assert (group['right']['hits'], group['right']['cases'], group['left_out']) == (2, 3, 1)
    assert found['left_out'] == {'wafer:y_rotate': 1}
    (confusion,) = found['confusions']
    assert confusion['truth'] == 'wafer:y_rotate'
    assert confusion['reported'] == 'crashed'


def test_what_is_not_right_says_where_the_true_model_itself_wins():
    lines = [
        line('single-10', 'missed', 10.0, gain_of_truth=[200.0, -5.0]),
        line('single-10', 'missed', 10.0, gain_of_truth=[200.0, 30.0]),
    ]
    (row,) = summary.summarise(lines)['confusions']
    assert (row['cases'], row['truth_wins']) == (2, 1)


def test_what_logs_for_judging_could_not_show_is_counted_apart():
    lines = [
        line('single-3', 'missed', 3.0, judging_size=0.9),
        line('single-3', 'missed', 3.0, judging_size=1.1),
        line('single-3', 'right', 3.0, judging_size=5.0),
        line('single-3', 'crashed', 3.0),
        line('single-3', 'left out', 3.0),
    ]
    found = summary.summarise(lines)
    assert found['groups']['single-3']['right']['cases'] == 4
    shown = found['shown_to_judges']['single-3']
    assert (shown['hits'], shown['cases']) == (1, 3)


def test_a_twin_counts_by_what_becomes_of_it_when_it_is_unknown_too():
    lines = [
        line('unknown', 'twin', 10.0, without_twins={'outcome': 'right'}),
        line('unknown', 'twin', 10.0, without_twins={'outcome': 'wrong'}),
        line('unknown', 'right', 10.0),
        line('unknown', 'right', 10.0, without_twins={'outcome': 'right'}),
    ]
    found = summary.summarise(lines)
    assert found['groups']['unknown']['right']['hits'] == 2
    assert found['unknown_without_twins']['hits'] == 3


def test_wilson_interval():
    # E. B. Wilson's score interval by its closed form
    hits, count, z = 3, 40, 1.959963984540054
    share = hits / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * math.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    found = summary.rate(hits, count)
    assert (found['low95'], found['high95']) == pytest.approx((centre - half, centre + half))
    assert summary.rate(0, 0)['share'] is None


def test_the_detection_curve_counts_by_the_size_that_was_had():
    lines = [
        line('single-3', 'missed', 3.1),
        line('single-3', 'right', 9.0),
        line('single-10', 'right', 10.0),
    ]
    rows = {row['from']: row for row in summary.summarise(lines)['detection']}
    assert rows[2.2]['named']['share'] == 0.0
    assert rows[8.0]['named']['hits'] == 2
    assert rows[8.0]['size'] == pytest.approx(math.sqrt(90.0))


def test_results_say_of_which_commits_they_are():
    lines = [
        line('single-10', 'right', 10.0, commit='abc1234'),
        line('single-3', 'right', 3.0, commit='abc1234'),
        line('single-3', 'right', 3.0),
    ]
    assert summary.summarise(lines)['commits'] == {'abc1234': 2, 'not known': 1}


def test_tables_of_nothing_and_of_something(capsys):
    summary.print_tables(summary.summarise([]))
    assert 'Time of a diagnosis' not in capsys.readouterr().out
    lines = [line('single-10', 'right', 10.0, runtime_s=float(s)) for s in range(1, 12)]
    found = summary.summarise(lines)
    assert found['times_s']['single-10'] == {
        'cases': 11,
        'median': 6.0,
        'most': 10.0,
        'longest': 11.0,
    }
    summary.print_tables(found)
    assert 'Time of a diagnosis' in capsys.readouterr().out


# The table of what must be true


def rows_of(lines):
    return {(row.group, row.what): row for row in requirements.table_of(lines, summary.is_named)}


def effect(size, became):
    return {'name': 'wafer:y_rotate', 'size': size, 'became': became}


def name(probability, true, in_set=None, related=False, of='cogging:y_linear'):
    return {
        'name': of,
        'probability': probability,
        'true': true,
        'in_set': true if in_set is None else in_set,
        'related': related,
    }


def test_a_table_of_nothing_knows_nothing():
    rows = rows_of([])
    assert all(row.met is None and row.verdict == '-' for row in rows.values())
    assert {row.shown for row in rows.values()} == {'-'}


def test_the_table_counts_only_effects_that_the_logs_show_and_says_what_lacks():
    names = [name(0.99, True), name(0.7, False, in_set=True), name(0.6, False)]
    lines = [
        line(
            'several', 'some', 10.0, names=names,
            effects=[effect(3.0, 'named'), effect(2.9, 'missed'), effect(9.0, 'in the set')],
        ),
        line('several', 'crashed', 10.0, effects=[effect(20.0, 'missed')]),
        line('several', 'left out', 10.0),
    ]  # fmt: skip
    rows = rows_of(lines)
    named = rows['several', 'effects of size 3 and more named']
    assert (named.seen['hits'], named.seen['cases'], named.met) == (2, 3, False)
    assert named.verdict == 'NOT MET so far, 97 to run'
    true = rows['several', 'names that are true']
    assert (true.seen['hits'], true.seen['cases']) == (2, 3)
    assert true.shown.startswith('2 of 3, 66.7 % (')


def test_a_limit_itself_is_met():
    lines = [line('nothing', 'right', 0.0)] * 99 + [line('nothing', 'false alarm', 0.0)]
    assert rows_of(lines)['nothing', 'a name in an empty log'].met is True
    lines.append(line('nothing', 'crashed', 0.0))
    assert rows_of(lines)['nothing', 'a name in an empty log'].met is False


def test_corrections_count_by_their_intervals_and_not_as_causes():
    def correction(covered):
        return {'path': 'wrong_inertia:y_linear.mass', 'covered': covered}

    off = line(
        'everything-off', 'all', 10.0, effects=[effect(9.0, 'named')],
        corrections=[correction(True)] * 9 + [correction(None)],
        names=[name(0.99, True, of='wafer:y_rotate')],
    )  # fmt: skip
    rows = rows_of([off])
    within = rows['everything-off', 'corrections within their 95 % interval']
    assert (within.seen['hits'], within.seen['cases'], within.met) == (9, 9, True)
    as_cause = 'names that are a correction reported as a cause'
    assert rows['everything-off', as_cause].met is True
    false = {**off, 'names': [name(0.9, False, of='force_constant:x_rotate')]}
    rows = rows_of([off, false])
    assert (
        rows['everything-off', as_cause].seen['hits'],
        rows['everything-off', as_cause].met,
    ) == (
        1,
        False,
    )
    assert rows['everything-off', 'names that are true'].seen['hits'] == 1


def test_of_an_unknown_effect_false_names_count_once_its_twins_are_unknown_too():
    twin = name(0.99, False, related=True)
    lines = [
        line('unknown', 'twin', 10.0, names=[twin], without_twins={'outcome': 'right', 'names': []}),
        line('unknown-among-known', 'right', 10.0, names=[name(0.9, True)]),
        line('unknown-among-known', 'right', 10.0, names=[name(0.9, False)]),
        line('unknown-among-known', 'wrong', 10.0, names=[twin]),
    ]  # fmt: skip
    rows = rows_of(lines)
    seen = rows['unknown', 'unexplained on the right axis'].seen
    assert (seen['hits'], seen['cases']) == (3, 4)
    false = rows['unknown', 'cases with a false name'].seen
    assert (false['hits'], false['cases']) == (1, 4)


def test_calibration_is_met_where_the_interval_meets_the_bin():
    def calibrated(probability, true, false):
        names = [name(probability, True)] * true + [name(probability, False)] * false
        return rows_of([line('two', 'both', 5.0, names=names)])

    def bin_of(rows, text):
        return rows['calibration', f'names given with {text} that are true']

    assert bin_of(calibrated(0.5, 60, 40), '0.5 to 0.8').met is True
    assert bin_of(calibrated(0.79, 20, 80), '0.5 to 0.8').met is False
    # Names that are always true were not given with too much, but with too little.
    assert bin_of(calibrated(0.6, 200, 0), '0.5 to 0.8').met is False
    rows = calibrated(0.8, 3, 1)
    assert bin_of(rows, '0.5 to 0.8').met is None
    assert bin_of(rows, '0.8 to 0.95').seen['cases'] == 4
    rows = calibrated(1.0, 199, 1)
    assert bin_of(rows, '0.95 to 1').seen['cases'] == 200
    assert rows['wrong and sure', 'names with 0.95 and more, and false'].met is True
    assert calibrated(0.95, 198, 2)[
        'wrong and sure', 'names with 0.95 and more, and false'
    ].met is False  # fmt: skip


def test_a_name_in_a_set_with_a_true_one_is_sure_only_of_itself():
    rows = rows_of([line('several', 'all', 5.0, names=[name(0.96, False, in_set=True)])])
    assert rows['several', 'names that are true'].met is True
    assert rows['wrong and sure', 'names with 0.95 and more, and false'].met is False


@pytest.mark.parametrize(('covered', 'met'), [(85, False), (94, True), (100, False)])
def test_intervals_may_neither_be_too_narrow_nor_too_wide(covered, met):
    errors = [{'covered': place < covered} for place in range(100)] + [{'covered': None}]
    rows = rows_of([line('several', 'all', 5.0, errors=errors[:50], other_errors=errors[50:])])
    row = rows['intervals', '95 % intervals that cover']
    assert (row.seen['cases'], row.met) == (100, met)


def test_a_table_is_of_one_commit(capsys):
    lines = [
        line('typical', 'missed', 10.0, commit='aaaaaaa'),
        line('typical', 'right', 10.0, commit='bbbbbbb'),
        line('typical', 'right', 10.0, commit='bbbbbbb'),
    ]
    commit, own, refused = requirements.of_one_commit(lines)
    assert (commit, len(own), refused) == ('bbbbbbb', 2, 1)
    rows = requirements.table_of(own, summary.is_named)
    same = {'gearbox_friction:y_rotate': 'coulomb_friction:y_rotate'}
    requirements.print_table(summary.plain_console(), rows, commit, refused, 4, same)
    printed = capsys.readouterr().out
    assert 'commit bbbbbbb, seed 4' in printed
    assert 'refused: 1 lines' in printed
    assert '2 of 2, 100.0 %' in printed
    assert 'for development' in printed
    assert 'gearbox_friction:y_rotate and coulomb_friction:y_rotate' in printed
    requirements.print_table(summary.plain_console(), rows, 'ccc-dirty-1', 0, 5000, {})
    printed = capsys.readouterr().out
    assert 'no commit' in printed
    assert 'for development' not in printed


def test_a_final_seed_is_run_by_one_commit_only():
    lines = [{'seed': 5000, 'commit': 'aaaaaaa'}, {'seed': 7, 'commit': 'aaaaaaa'}]
    refuse = bench_diagnosis._refuse_second_run
    refuse(lines, 5000, 'aaaaaaa', Path('results'))
    refuse(lines, 7, 'bbbbbbb', Path('results'))
    with pytest.raises(UserError, match='run once'):
        refuse(lines, 5000, 'bbbbbbb', Path('results'))


# The logs


@pytest.mark.slow
def test_a_log_in_memory_is_the_one_that_the_command_writes(tmp_path):
    hidden = 'wrong_inertia:x_rotate,inertia=0.05'
    motion = tmp_path / 'motion.yaml'
    motion.write_text(
        '{"name": "short", "duration_s": 0.2, "motion": {"x_rotate": '
        '{"kind": "step", "start_s": 0.05, "amplitude_counts": 500}}}',
        'utf-8',
    )
    synthesize(
        'rigid', [hidden], str(motion), 0.7, 12, (), tmp_path / 'log', False, lambda *_: None
    )
    variant = find('wrong_inertia').apply(trial.nominal('rigid'), 'x_rotate', {'inertia': 0.05})
    in_memory = trial.log(variant, 'rigid', 0.7, motion.read_text('utf-8'), 12)
    written = record_of_recording(tmp_path / 'log', trial.nominal('rigid'))
    # The host of all effects moves alike but for rounding, which now and then moves a count.
    assert in_memory.ticks == written.ticks
    assert np.abs(in_memory.reading - written.reading).max() <= 1.0
    assert np.mean(in_memory.reading != written.reading) < 0.01
    np.testing.assert_array_equal(in_memory.commanded, written.commanded)
    np.testing.assert_allclose(in_memory.line_current, written.line_current, atol=0.02)
    assert np.ptp(written.reading[:, 1]) > 400.0


def test_a_gain_is_compared_on_the_logs_that_judged():
    finding, judging = ([SimpleNamespace(name=name)] for name in ('log_0', 'log_1'))
    for names, records in ((['log_1'], judging), (['log_0'], finding)):
        report = {'gain': {'validation': names}}
        assert trial._judged_by(report, finding, judging) is records


# Machines of another simulator


def other_report(*causes, verdict='explained', late_s=(), inertia=()):
    return {
        'verdict': verdict,
        'corrections': [
            {'path': path, 'nominal': nominal, 'found': found, 'low': low, 'high': high}
            for path, nominal, several in (
                ('logs.x_rotate.skew_s', 0.0, late_s),
                ('bodies.load.inertia_kg_m2', 2.0, inertia),
            )
            for found, low, high in several
        ],
        'accelerations': [],
        'runtime_s': 1.0,
        'causes': [
            {
                'effect': effect,
                'axis': 'x_rotate',
                'probability': 0.8,
                'credible_set': [
                    {'effect': name, 'axis': 'x_rotate'} for name in (effect, *alike)
                ],
                'parameters': {
                    name: {'value': value, 'low95': low, 'high95': high}
                    for name, (value, low, high) in parameters.items()
                },
            }
            for effect, alike, parameters in causes
        ],
    }


def other_score(expected, *causes, **more):
    return other_simulator.score(
        expected, other_simulator.read_findings(other_report(*causes, **more))
    )


MASS = Answers((Answer('wrong_inertia', {'inertia': 0.2}),), frozenset({'force_constant'}))
DRAG = Answers((Answer('viscous_friction', {'damping': 1.0}),))
NOTED = Answers((*MASS.right, Answer('bodies.load.inertia_kg_m2', {'value': 2.2})), MASS.related)
LATE = Answers(
    (Answer('encoder_delay', {'delay': 3.0}, {'delay': 3.4}), Answer(TIME, {'late_s': -1e-3}))
)


def test_machines_of_another_simulator_are_scored_by_name_set_and_correction():
    inertia = ('wrong_inertia', (), {'inertia': (0.21, 0.19, 0.23)})
    drag = ('viscous_friction', (), {'damping': (1.3, 1.2, 1.4)})
    both = other_score({'mass': MASS, 'viscous': DRAG}, inertia, drag)
    assert both['outcome'] == 'all'
    assert [error['covered'] for error in both['other_errors']] == [True, False]
    in_set = other_score(
        {'mass': MASS, 'viscous': DRAG}, ('force_constant', ('wrong_inertia',), {}), drag
    )
    assert in_set['became'] == {'mass': 'in the set', 'viscous': 'named'}
    # Forces in another measure: their intervals say nothing.
    assert in_set['other_errors'] == []
    related = other_score({'mass': MASS}, ('force_constant', (), {}))
    assert (related['outcome'], related['false']) == ('none', [])
    false = other_score({'mass': MASS}, inertia, ('cogging', ('torque_ripple',), {}))
    assert false['outcome'] == 'all and a false one'
    assert [item['name'] for item in false['false']] == ['cogging']
    late_s = [(-1.02e-3, -1.12e-3, -0.92e-3)]
    noted = other_score({'encoder_delay': LATE}, late_s=late_s, verdict='consistent')
    assert noted['became'] == {'encoder_delay': 'noted'}
    assert noted['other_errors'][0]['covered']
    delay = ('encoder_delay', (), {'delay': (3.4, 3.3, 3.5)})
    for told, covered in (({}, False), ({'late_s': [(4e-4, 3e-4, 5e-4)]}, True)):
        (error,) = other_score({'encoder_delay': LATE}, delay, **told)['other_errors']
        assert error['covered'] == covered
    open_yet = [(-1e-4, -3e-4, 1e-4)]
    assert other_score({'encoder_delay': LATE}, late_s=open_yet)['outcome'] == 'none'
    assert other_score({}, ('skew', (), {}))['outcome'] == 'false alarm'


@pytest.mark.parametrize(
    ('inertia', 'became', 'covered'),
    [
        ((2.15, 2.05, 2.25), 'noted', [True]),
        # The logs tell that it is another one, and not which.
        ((2.1, 2.05, 2.15), 'missed', [False]),
        ((2.1, 1.9, 2.3), 'missed', []),
    ],
)
def test_a_mass_of_another_simulator_may_stand_in_the_table(inertia, became, covered):
    scored = other_score({'mass': NOTED}, inertia=[inertia], verdict='consistent')
    assert scored['became'] == {'mass': became}
    assert [error['covered'] for error in scored['other_errors']] == covered
    assert scored['false'] == []


def test_a_machine_of_another_simulator_with_nothing_hidden_is_to_be_consistent():
    assert other_score({}, verdict='consistent')['outcome'] == 'right'
    assert other_score({}, verdict='unexplained')['outcome'] == 'unexplained'
    assert other_score({}, ('cogging', (), {}))['outcome'] == 'false alarm'


def test_results_of_another_simulator_are_summed_up():
    def line(number, hidden, scored):
        case = Case('other-simulator', (), number, 1)
        assert trial.model_of(case, 'rigid') == other_simulator.MODEL
        assert trial.through(case, False) == 'files'
        return {
            'key': case.key, 'group': case.group, 'seed': 1, 'number': number,
            'model': other_simulator.MODEL, 'hidden': hidden, 'reported': [], **scored,
        }  # fmt: skip

    drag = ('viscous_friction', (), {'damping': (1.3, 1.2, 1.4)})
    lines = [
        line(0, ['viscous'], other_score({'viscous': DRAG}, drag)),
        line(1, ['viscous'], other_score({'viscous': DRAG}, ('cogging', (), {}))),
        line(2, [], other_score({}, verdict='consistent')),
        line(3, [], {'outcome': trial.CRASHED, 'reason': ''}),
    ]
    found = summary.summarise(lines)
    other = found['other_simulator']
    assert other['effects'] == {'viscous': {'named': 1, 'missed': 1}}
    assert (other['named']['hits'], other['named']['cases']) == (1, 2)
    assert other['false_names'] == {'cogging': 1}
    assert (other['empty_right']['hits'], other['empty_right']['cases']) == (1, 1)
    assert (other['coverage']['hits'], other['coverage']['cases']) == (0, 1)
    assert other['calibration'][1]['true']['cases'] == 2
    assert other['calibration'][1]['true']['hits'] == 1
    assert other['crashed'] == 1
    assert found['groups']['other-simulator']['right']['hits'] == 2
    summary.print_tables(found)
