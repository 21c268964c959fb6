# SPDX-License-Identifier: Apache-2.0
"""Named parameters, what signals say about them, and estimates with intervals that hold."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.estimation.known_values import Known
from waferbot_twin.identification.conditioning import conditioning, in_words
from waferbot_twin.identification.estimation import estimate, with_known
from waferbot_twin.identification.identify import identify
from waferbot_twin.identification.named_parameters import NamedParameter, parse, parse_all
from waferbot_twin.identification.report import as_dict
from waferbot_twin.identification.whiteness import whiteness
from waferbot_twin.models import load_model
from waferbot_twin.noise_model.prediction_error import Noise
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import PLANT, Problem
from waferbot_twin.synthesis import noise

WIDE = math.log(10.0)


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


def silent(done, total):
    pass


# Names


@pytest.mark.parametrize(
    ('path', 'value', 'unit'),
    [
        ('bodies.carriage.mass_kg', 4.5628, 'kg'),
        ('bodies.x_rotate_load.centre_of_gravity_m[2]', 0.11162, 'm'),
        ('bodies.x_rotate_load.inertia_kg_m2.xx', 0.52472, 'kg m²'),
        ('parts.payload_bearing.loss_factor', 0.02, ''),
        ('pmac.x_rotate.Ixx30', 197258.0, ''),
        ('copley.x_rotate.motor_resistance', 4.0, 'ohm'),
        ('connections.gearbox.stiffness_nm_rad', None, 'Nm/rad'),
    ],
)
def test_a_path_finds_value_and_unit_and_sets_it_alone(rigid, path, value, unit):
    found = parse(path, rigid)
    assert found.unit == unit
    if value is not None:
        assert found.start == value
    again = parse(path, rigid.with_overlay(found.overlay(rigid, 0.97 * found.start)))
    assert again.start == pytest.approx(0.97 * found.start, rel=1e-5)
    if path.startswith('bodies'):
        other = 'bodies.x_rotate_load.centre_of_gravity_m[0]'
        changed = rigid.with_overlay(found.overlay(rigid, 0.97 * found.start))
        assert parse(other, changed).start == parse(other, rigid).start
        assert changed.description.bodies.keys() == rigid.description.bodies.keys()


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('bodies.cariage.mass_kg', "did you mean 'carriage'"),
        ('bodies.carriage.mass', "did you mean 'mass_kg'"),
        ('bodys.carriage.mass_kg', "did you mean 'bodies'"),
        ('bodies.carriage.centre_of_gravity_m', 'centre_of_gravity_m[1]'),
        ('bodies.carriage.centre_of_gravity_m[3]', 'has 3 values'),
        ('bodies.carriage.mass_kg.x', 'nothing below it'),
        ('bodies.carriage', 'is not a number'),
        ('bodies.carriage.mass_kg=1', 'give low:high'),
        ('bodies.carriage.mass_kg=8:1', 'must be less'),
        ('bodies.carriage.mass_kg=8:9', 'out of this range'),
        ('bodies.carriage.centre_of_gravity_m[1]', 'is 0 in the model'),
        ('pmac.x_rotat.Ixx30', "did you mean 'x_rotate'"),
        ('pmac.x_rotate.Ixx3', 'did you mean'),
        ('pmac.x_rotate.Ixx30=1:1e12', 'can be'),
        ('pmac.x_rotate', 'pmac.AXIS.NAME'),
        ('connections.cabel.stiffness_n_m', "did you mean 'cable'"),
        ('connections.cable.stiffness_nm_rad', 'stiffness_n_m'),
    ],
)
def test_a_wrong_name_or_range_is_told(rigid, text, part):
    with pytest.raises(UserError) as error:
        parse(text, rigid)
    assert part in str(error.value)


def test_a_parameter_given_twice_is_refused(rigid):
    with pytest.raises(UserError, match='twice'):
        parse_all(['bodies.carriage.mass_kg', 'bodies.carriage.mass_kg=1:9'], rigid)


@given(st.floats(0.11, 9.9), st.booleans(), st.sampled_from((1.0, -1.0)))
def test_scaled_values_come_back(factor, zero_inside, sign):
    start = 3.0 * sign
    bounds = sorted((start / 10.0, start * 10.0))
    if zero_inside:
        bounds = [-40.0, 40.0]
    one = NamedParameter('x', '', start, *bounds, False, lambda variant, value: Overlay())
    assert one.logarithmic != zero_inside
    assert one.value(one.scaled(factor * start)) == pytest.approx(factor * start)
    assert one.scaled(start) == 0.0


# What signals say


def test_covariance_is_that_of_least_squares():
    random = np.random.default_rng(1)
    sensitivity = random.normal(size=(400, 3)) @ np.array([[5.0, 1, 0], [0, 40, 2], [0, 0, 9]])
    found = conditioning(sensitivity, np.zeros_like(sensitivity), [WIDE] * 3)
    expected = np.linalg.inv(sensitivity.T @ sensitivity)
    assert found.covariance == pytest.approx(expected, rel=1e-3)
    assert found.singular_values == pytest.approx(np.linalg.svd(sensitivity)[1])
    assert found.condition_number == pytest.approx(np.linalg.cond(sensitivity))
    assert found.combinations == ()
    assert not any(found.open)


@pytest.mark.parametrize(
    ('factor', 'expected'),
    [
        (-1.0, 'only the ratio a / b is known'),
        (1.0, 'only the product a * b is known'),
        (-2.0, 'only a * b^-2 is known'),
    ],
)
def test_a_pair_that_cannot_be_told_apart_is_said_to_be_one(factor, expected):
    one = np.random.default_rng(2).normal(size=(500, 2)) * 100.0
    # a, b seen together only; c by itself; the quotients have errors.
    sensitivity = np.column_stack([one[:, 0], factor * one[:, 0], one[:, 1]])
    error = 1e-4 * np.random.default_rng(3).normal(size=sensitivity.shape)
    found = conditioning(sensitivity + error, error, [WIDE] * 3)
    assert found.open == (True, True, False)
    assert found.condition_number == math.inf
    (pair,) = found.combinations
    assert in_words(pair, ['a', 'b', 'c'], [True] * 3) == expected
    assert found.standard_errors[2] == pytest.approx(1.0 / np.linalg.norm(one[:, 1]), rel=0.01)


def test_two_pairs_are_told_as_two():
    one = np.random.default_rng(4).normal(size=(500, 2)) * 50.0
    sensitivity = np.column_stack([one[:, 0], one[:, 1], -one[:, 0], one[:, 1]])
    found = conditioning(sensitivity, np.zeros_like(sensitivity), [WIDE] * 4)
    said = [in_words(item, list('abcd'), [True] * 4) for item in found.combinations]
    assert said == ['only the ratio a / c is known', 'only the product b * d is known']


def test_no_influence_is_no_interval():
    one = np.random.default_rng(5).normal(size=(500, 1)) * 50.0
    sensitivity = np.column_stack([one, np.zeros(500)])
    found = conditioning(sensitivity, np.zeros_like(sensitivity), [WIDE, WIDE])
    assert found.no_influence == (1,)
    assert found.open == (False, True)
    assert found.standard_errors[1] == pytest.approx(WIDE)


def test_whiteness_knows_white_from_coloured_and_what_comes_from_the_input():
    random = np.random.default_rng(6)
    white, driving = random.normal(size=(2, 4000))
    coloured = lfilter([1.0], [1.0, -0.2], white)
    driven = white + 0.2 * np.roll(driving, 5)
    assert whiteness(white, 0, driving).probability > 0.01
    assert whiteness(white, 0, driving).input_probability > 0.01
    assert whiteness(coloured, 0).probability < 1e-6
    assert whiteness(driven, 0, driving).input_probability < 1e-6
    assert int(np.argmax(whiteness(driven, 0, driving).input_correlation)) == 5


# Estimates


@dataclasses.dataclass(frozen=True)
class LinearModel:
    """Stands for a variant: what it "simulates" is a matrix times its values."""

    values: dict

    @property
    def base(self):
        return self

    def with_overlay(self, overlay):
        return LinearModel({**self.values, **overlay.machine})


class LinearProblem(Problem):
    """Residuals y - A v."""

    def __init__(self, nominal, matrix, measured):
        self.nominal, self._matrix, self._measured = nominal, matrix, measured
        self.records, self.known_noise = (), {}
        self.blocks = {PLANT: [self]}
        self.channels = ['y']

    def noises(self, block):
        return [Noise(1e-9, 24)]

    def touched(self, effect, axis):
        return (PLANT,)

    def between(self, one, other):
        return (PLANT,)

    def residuals(self, variant, block, workers=1):
        values = np.array([variant.values[name] for name in sorted(variant.values)])
        return [self._measured - self._matrix @ values]


def named(name, start):
    return NamedParameter(
        name, '', start, start / 10.0, start * 10.0, False,
        lambda variant, value: Overlay({name: value}),
    )  # fmt: skip


def test_intervals_hold_what_they_promise():
    """In a linear problem with coloured noise: 95 % of the intervals hold the truth."""
    seed, runs = 11, 100
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    truth = np.array([1.2, 0.7])
    time = np.arange(700) / 700.0
    matrix = np.column_stack(
        [np.sin(40.0 * time), np.exp(-8.0 * (time % 0.5)) * np.cos(60.0 * (time % 0.5))]
    )
    deviations = []
    for _ in range(runs):
        coloured = lfilter([1.0, 0.5], [1.0, -0.9], random.normal(size=900))[200:]
        problem = LinearProblem(
            LinearModel({'a': 1.0, 'b': 1.0}), matrix, matrix @ truth + 0.05 * coloured
        )
        found = estimate(problem, [named('a', 1.0), named('b', 1.0)], silent)
        assert found.settled
        deviations.append((found.scaled - np.log(truth)) / found.conditioning.standard_errors)
    inside = np.abs(deviations) < 1.96
    # 200 intervals: the share lies in 0.95 +- 4 standard deviations of 0.0154.
    assert 0.888 <= inside.mean() <= 0.995
    assert np.abs(np.mean(deviations, axis=0)) == pytest.approx(0.0, abs=4.0 / math.sqrt(runs))


def test_standard_errors_with_white_noise_are_analytic():
    random = np.random.default_rng(12)
    matrix = random.normal(size=(4000, 2)) @ np.array([[1.0, 0.6], [0.0, 1.0]])
    truth = np.array([2.0, 0.5])
    problem = LinearProblem(
        LinearModel({'a': 1.0, 'b': 1.0}), matrix, matrix @ truth + 0.1 * random.normal(size=4000)
    )
    found = estimate(problem, [named('a', 1.0), named('b', 1.0)], silent)
    expected = 0.1 * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))) / truth
    assert found.conditioning.standard_errors == pytest.approx(expected, rel=0.1)


def test_half_the_data_and_what_was_known_have_the_same_intervals_and_hold_the_truth():
    """Of a first log and half a second one; against the second one alone, whole."""
    random = np.random.default_rng(13)
    truth = np.array([1.3, 0.6])
    matrix = random.normal(size=(2000, 2)) @ np.array([[1.0, 0.6], [0.0, 1.0]])
    parameters = [named('a', 1.0), named('b', 1.0)]
    deviations = []
    for _ in range(50):
        logs = [
            LinearProblem(
                LinearModel({'a': 1.0, 'b': 1.0}),
                matrix[:rows],
                matrix[:rows] @ truth + 0.3 * random.normal(size=rows),
            )
            for rows in (2000, 2000, 1000)
        ]
        first, whole = (estimate(one, parameters, silent) for one in logs[:2])
        known = {
            one.path: Known(one.value(scaled), one.value(scaled) * error)
            for one, scaled, error in zip(
                parameters, first.scaled, first.conditioning.standard_errors, strict=True
            )
        }
        half, told = with_known(logs[2], estimate(logs[2], parameters, silent), known)
        assert all(note.endswith('that took part') for note in told)
        assert (half.conditioning.standard_errors < whole.conditioning.standard_errors).all()
        deviations.append((half.scaled - np.log(truth)) / half.conditioning.standard_errors)
    # 100 intervals; what is known of two parameters is passed on without their correlation, -0.6.
    assert 0.87 <= (np.abs(deviations) < 1.96).mean() <= 1.0


def log(variant, experiment, seed, duration_s):
    shaking = noise(variant.base, 1.0, seed, np.random.default_rng(seed))
    timing = Timing()
    twin = Twin.of(variant.with_overlay(shaking).model(), timing, load_experiment(experiment))
    record = record_of_signals(experiment, twin.advance(timing.ticks(duration_s)))
    # The mechanism alone: with voltages the back-EMF would tell the force constant.
    return dataclasses.replace(record, terminals=None)


def changed(variant, values):
    for path, factor in values.items():
        one = parse(path, variant.base)
        variant = variant.with_overlay(one.overlay(variant, factor * one.start))
    return variant


@pytest.mark.slow
def test_parameters_of_plant_and_controller_come_back(rigid):
    truth = {
        'bodies.x_rotate_load.inertia_kg_m2.xx': 1.1,
        'motors.x_rotate.back_emf_lead_to_lead_v_s_rad': 0.95,
        'pmac.x_rotate.Ixx31': 1.2,
    }
    machine = changed(rigid, truth)
    names = [*truth, 'bodies.counterweight.inertia_kg_m2.xx']
    result = identify(
        rigid,
        [log(machine, 'step_x_rotate', 21, 0.6)],
        [log(machine, 'random_x_rotate', 22, 0.4)],
        parse_all(names, rigid),
        silent,
    )
    report = as_dict(result)
    for path, factor in truth.items():
        row = report['parameters'][path]
        assert row['identified']
        width = row['high95'] - row['low95']
        # Two intervals wide on either side: four standard errors.
        assert abs(row['value'] - factor * row['start']) <= width + 0.5
        assert width < 0.02 * row['value']
    assert report['no_influence'] == ['bodies.counterweight.inertia_kg_m2.xx']
    assert report['parameters']['bodies.counterweight.inertia_kg_m2.xx']['low95'] is None
    assert report['gain']['axes']['x_rotate']['improvement_percent'] > 80.0
    assert changed(rigid, truth).description.bodies['x_rotate_load'].inertia[0, 0] == (
        pytest.approx(
            result.identified.description.bodies['x_rotate_load'].inertia[0, 0], rel=0.02
        )
    )


def test_two_workers_identify_the_same_to_the_last_bit(rigid):
    machine = changed(rigid, {'bodies.x_rotate_load.inertia_kg_m2.xx': 1.1})
    logs = [log(machine, 'step_x_rotate', seed, 0.2) for seed in (24, 25)]
    names = ['bodies.x_rotate_load.inertia_kg_m2.xx', 'pmac.x_rotate.Ixx31']
    one, two = (
        identify(rigid, logs, [], parse_all(names, rigid), silent, workers=workers).estimate
        for workers in (1, 2)
    )
    np.testing.assert_array_equal(one.scaled, two.scaled)
    np.testing.assert_array_equal(one.conditioning.covariance, two.conditioning.covariance)
    assert one.scaled[0] == pytest.approx(math.log(1.1), abs=0.02)


@pytest.mark.slow
def test_force_constant_and_inertia_of_a_frictionless_axis_are_known_as_a_ratio(rigid):
    names = [
        'bodies.y_rotate_load.inertia_kg_m2.yy',
        'motors.y_rotate.back_emf_lead_to_lead_v_s_rad',
    ]
    record = log(changed(rigid, {names[1]: 1.05}), 'step_y_rotate', 23, 0.5)
    report = as_dict(identify(rigid, [record], [], parse_all(names, rigid), silent))
    assert not any(row['identified'] for row in report['parameters'].values())
    assert report['condition_number'] == math.inf
    (pair,) = report['cannot_tell_apart']
    # What moves is k / J, J the inertia about the axis of load, offset of its mass, and rotors.
    load, motor = (report['parameters'][name]['value'] for name in names)
    whole = load + 10.025 * 0.11081**2 + 48.0**2 * (1.9092e-5 + 1.3e-5)
    move = dict(zip(pair['parameters'], pair['move'], strict=True))
    assert move[names[0]] / move[names[1]] == pytest.approx(whole / load, rel=0.02)
    start = 0.12665 + 10.025 * 0.11081**2 + 48.0**2 * (1.9092e-5 + 1.3e-5)
    assert motor / whole == pytest.approx(1.05 * 0.1386 / start, rel=0.01)


@pytest.mark.slow
def test_a_second_identification_of_a_machine_needs_half_the_data(rigid):
    truth = {'bodies.x_rotate_load.inertia_kg_m2.xx': 1.1}
    machine = changed(rigid, truth)
    (path,) = truth
    parameters = parse_all([path], rigid)

    def found(seed, duration_s, known=None):
        logs = [log(machine, 'random_x_rotate', seed, duration_s)]
        result = identify(rigid, logs, logs, parameters, silent, known)
        return result, as_dict(result)['parameters'][path]

    _, first = found(31, 0.8)
    error = (first['high95'] - first['low95']) / (2.0 * NORMAL_95)
    known = {path: Known(first['value'], error, 'the first')}
    _, whole = found(33, 0.8)  # noise of the same level: each seed has its own
    result, half = found(33, 0.4, known)
    assert half['high95'] - half['low95'] <= whole['high95'] - whole['low95']
    off = abs(half['value'] - 1.1 * half['start'])
    assert off < half['high95'] - half['low95']  # two intervals
    assert any('the first); that took part' in note for note in result.notes)
    far = {path: Known(0.8 * first['value'], error, 'the first')}
    result, _ = found(33, 0.4, far)
    assert any('what has changed?' in note for note in result.notes)
