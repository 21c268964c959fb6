# SPDX-License-Identifier: Apache-2.0
"""Experiments that tell causes apart: what is tried, what it is worth, what is said."""

import json
import math
from itertools import permutations

import numpy as np
import pytest

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.report_schema import SCHEMA
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.models import load_model
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.suggestion.candidates import Candidate, changed, designed, strokes
from waferbot_twin.suggestion.report import as_dict, sentence, table_rows, write
from waferbot_twin.suggestion.rivals import named, of_report, read_report
from waferbot_twin.suggestion.separation import TELLS_APART, Load, Machine, Separation, separations
from waferbot_twin.suggestion.suggest import Rated, Suggestion, suggest

TIMING = Timing()


@pytest.fixture(scope='module')
def rigid():
    return Variant.of(load_model('rigid'))


def cause(variant, name, axis, **values):
    effect = find(name)
    return Cause(effect, axis, effect.complete(variant, axis, values))


# What is tried


@pytest.mark.parametrize('axis', ['y_linear', 'x_rotate', 'y_rotate'])
def test_designed_motions_stay_within_stroke_speed_and_acceleration(rigid, axis):
    parameters = servo_parameters(rigid.pmac)
    place = ('y_linear', 'x_rotate', 'y_rotate').index(axis)
    own = parameters[0]
    stroke = strokes(rigid, TIMING)[axis]
    candidates = designed(rigid, [axis], TIMING)
    everything = [*candidates, *(one for item in candidates for one in changed(item))]
    assert len({item.label for item in candidates}) == len(candidates)
    for item in everything:
        path = commanded_positions(item.experiment, parameters, TIMING.servo_hz)[:, place]
        assert np.ptp(path) <= 1.01 * stroke * own['counts_per_unit'][place]
        assert item.experiment.duration_s <= 5.0
        if item.design.kind == 'constant_velocity':
            speed = np.abs(np.diff(path)).max() * TIMING.servo_hz / 1000.0
            named_speed = next(v for k, v in item.design.keys.items() if k.startswith('speed'))
            assert speed == pytest.approx(
                named_speed * own['counts_per_unit'][place] / 1000.0, rel=1e-3
            )
            assert speed <= 1.3 * own['Ixx16'][place]


def test_strokes_are_those_of_the_library(rigid):
    found = strokes(rigid, TIMING)
    assert found['y_linear'] == pytest.approx(0.3, rel=1e-3)
    assert found['x_rotate'] == pytest.approx(math.pi / 2, rel=1e-3)
    assert found['y_rotate'] == pytest.approx(math.pi, rel=1e-3)


def test_an_experiment_of_the_library_has_no_other_sizes():
    assert changed(Candidate('step', load_experiment('step'))) == []


# What is said


NAMES = ('coulomb_friction', 'viscous_friction', 'stribeck_friction')


def rated(label, *evidence, impossible='', names=NAMES[:2]):
    """A candidate with evidence for ordered pairs, in order; None where it was given up."""
    pairs = permutations([f'{name}:x_rotate' for name in names], 2)
    separations = {
        pair: Separation(value, None, 2000, Load(0.5, 0.3, 'x_rotate'))
        for pair, value in zip(pairs, evidence, strict=False)
        if value is not None
    }
    return Rated(Candidate(label, load_experiment('step')), separations, impossible)


def suggestion(rigid, *items, instead=(), names=NAMES[:2]):
    causes = tuple(cause(rigid, name, 'x_rotate') for name in names)
    return Suggestion(causes, items, instead)


def test_the_best_is_the_one_whose_smaller_evidence_is_largest(rigid, tmp_path):
    one_sided, both = rated('one-sided', 900.0, 20.0), rated('both', 120.0, 90.0)
    found = suggestion(rigid, both, one_sided, rated('no', impossible='unstable'))
    assert found.best is both
    assert 'both tells' in sentence(found)
    assert [row[0] for row in table_rows(found)] == ['both', 'one-sided']
    assert both.detectable(found.told) == pytest.approx(math.sqrt(90.0 / math.log(2000)))
    write(found, tmp_path)
    assert load_experiment(tmp_path / 'experiment.yaml').name == 'step'
    report = json.loads((tmp_path / 'report.json').read_text('utf-8'))
    assert report['experiments'][2]['impossible'] == 'unstable'


def test_a_special_case_and_an_equivalent_pair_are_told_from_one_another(rigid):
    nested = suggestion(rigid, rated('a', 0.1, 5000.0), rated('b', 0.0, 3.0))
    assert nested.best is nested.rated[0]
    assert nested.imitated == (('coulomb_friction:x_rotate', 'viscous_friction:x_rotate'),)
    assert 'a tells whatever can be told apart' in sentence(nested)
    assert 'viscous_friction:x_rotate can do whatever coulomb_friction:x_rotate does' in sentence(
        nested
    )
    same = suggestion(rigid, rated('a', 0.1, 5.0), rated('b', 0.0, 3.0))
    assert same.told == ()
    assert 'equivalent for every motion' in sentence(same)
    assert 'scales' in sentence(same)
    other = suggestion(rigid, rated('a', 0.1, 5.0), instead=('log voltages as well',))
    assert 'Instead, log voltages' in sentence(other)
    assert as_dict(same)['best'] is None


def test_a_group_of_three_with_a_special_case_and_two_that_are_equivalent(rigid):
    """Coulomb in Stribeck friction; viscous and Coulomb friction the same."""
    nobody_tells = (0.1, 0.2, 0.3, 25.0, 30.0, 40.0)
    given_up = (0.1, 0.2, 0.3, 2.0, None, None)
    found = suggestion(
        rigid, rated('a', *nobody_tells, names=NAMES), rated('b', *given_up, names=NAMES),
        names=NAMES,
    )  # fmt: skip
    assert found.best is found.rated[0]
    assert len(found.told) == 3
    said = sentence(found)
    assert 'a tells whatever can be told apart of' in said
    assert '2 ln L = 25' in said
    assert said.count('are equivalent for every motion') == 1
    assert 'stribeck_friction:x_rotate can do whatever coulomb_friction:x_rotate does' in said
    rows = as_dict(found)['experiments']
    assert [row['given_up'] for row in rows] == [False, True]
    assert ['coulomb_friction:x_rotate', 'viscous_friction:x_rotate'] in as_dict(found)['imitated']


def test_where_no_experiment_tells_all_apart_the_best_of_each_pair_is_named(rigid):
    found = suggestion(rigid, rated('a', 50.0, 1.0), rated('b', 2.0, 70.0))
    assert found.best is None
    assert 'No experiment tells all' in sentence(found)
    assert 'a tells coulomb_friction:x_rotate from viscous_friction:x_rotate' in sentence(found)
    assert 'b tells viscous_friction:x_rotate from coulomb_friction:x_rotate' in sentence(found)


def test_rivals_by_name_and_from_a_report(rigid, tmp_path):
    group = named(['coulomb_friction:x_rotate,friction=2', 'viscous_friction:x_rotate'], rigid)
    assert [item.name for item in group.rivals] == [
        'coulomb_friction:x_rotate',
        'viscous_friction:x_rotate',
    ]
    assert group.rivals[0].values == {'friction': 2.0}
    coulomb = {'effect': 'coulomb_friction', 'axis': 'x_rotate'}
    viscous = {'effect': 'viscous_friction', 'axis': 'x_rotate', 'values': {'damping': 0.2}}
    row = {
        **coulomb,
        'parameters': {'friction': {'value': 1.5}},
        'credible_set': [{**coulomb, 'values': {'friction': 1.5}}, viscous],
    }
    known = {
        'effect': 'wrong_bias',
        'axis': 'y_linear',
        'parameters': {'difference': {'value': 20.0}},
        'credible_set': [],
    }
    (tmp_path / 'report.json').write_text(
        json.dumps({'schema': SCHEMA, 'causes': [known, row]}), 'utf-8'
    )
    group = of_report(read_report(tmp_path), rigid, None)
    assert [item.values for item in group.rivals] == [{'friction': 1.5}, {'damping': 0.2}]
    assert [item.name for item in group.others] == ['wrong_bias:y_linear']
    with pytest.raises(UserError, match="did you mean 'coulomb_friction:x_rotate'"):
        of_report(read_report(tmp_path), rigid, 'coulomb_friction:y_rotate')
    with pytest.raises(UserError, match='no cause that could not be told'):
        of_report({'causes': [known]}, rigid, None)
    with pytest.raises(UserError, match='give the axis'):
        named(['coulomb_friction', 'viscous_friction:x_rotate'], rigid)
    with pytest.raises(UserError, match='cannot be read'):
        read_report(tmp_path / 'other')


# What it is worth


def short(axis, motion):
    return load_experiment(
        f'{{name: short, duration_s: 0.4, motion: {{{axis}: {{start_s: 0.05, {motion}}}}}}}'
    )


@pytest.mark.slow
def test_force_constant_and_inertia_without_other_forces_are_equivalent(rigid):
    """With Y-Rotate upright and without friction only their ratio counts, however it moves."""
    mechanism = Machine(rigid, 1.0, 3, TIMING, without=('currents',))
    weak = cause(rigid, 'force_constant', 'y_rotate', ratio=0.95)
    heavy = cause(rigid, 'wrong_inertia', 'y_rotate', inertia=0.01)
    whole = 0.12665 + 10.025 * 0.11081**2 + 48.0**2 * (1.9092e-5 + 1.3e-5)
    for motion in (
        'kind: step, amplitude_rad: 3.0e-3',
        'kind: swept_sine, first_frequency_hz: 2, last_frequency_hz: 40, amplitude_rad: 1.0e-3',
    ):
        [found] = separations(mechanism, weak, [heavy], short('y_rotate', motion))
        assert found.evidence < 1.0
        assert found.refitted.values['inertia'] == pytest.approx(whole / 0.95 - whole, rel=0.02)
    # The windings know the back-EMF, and a constant force looks otherwise.
    logged = Machine(rigid, 1.0, 3, TIMING)
    fast = short('y_rotate', 'kind: step, amplitude_rad: 6.0e-3')
    assert separations(logged, weak, [heavy], fast)[0].evidence > 10.0
    pushed = cause(rigid, 'constant_force', 'y_rotate')
    assert separations(mechanism, weak, [pushed], fast)[0].evidence > 5.0 * TELLS_APART


@pytest.mark.slow
def test_what_is_expected_is_what_a_noisy_log_then_gives(rigid):
    """Both causes fitted to a noisy log, against what was expected of it."""
    viscous = cause(rigid, 'viscous_friction', 'x_rotate')
    coulomb = cause(rigid, 'coulomb_friction', 'x_rotate', friction=0.1)
    motion = short('x_rotate', 'kind: step, amplitude_counts: 600')
    for seed in (40, 41, 42):
        machine = Machine(rigid, 1.0, seed, TIMING)
        expected = separations(machine, viscous, [coulomb], motion)[0].evidence
        log = machine.record(machine.run((viscous,), motion, noisy=True))
        problem = Problem(rigid, [log])
        own, rival = (fit_causes(problem, (one,)) for one in (viscous, coulomb))
        measured = 2.0 * gain(own, rival)
        print(f'seed {seed}: expected {expected:.1f}, measured {measured:.1f}')
        assert expected > TELLS_APART
        # A difference of likelihoods of mean E has the variance 4 E; the colour is estimated, too.
        assert measured == pytest.approx(expected, abs=8.0 * math.sqrt(expected), rel=0.2)


def test_what_one_experiment_alone_tells_is_found_though_it_was_given_up(rigid, monkeypatch):
    """The small one is given up over the first cause; the third is told from the second by it alone."""
    causes = [cause(rigid, name, 'x_rotate') for name in NAMES]
    first, second, third = (one.name for one in causes)
    told_by = {
        'full_stroke_x_rotate': {(first, second), (first, third), (second, first), (third, first)},
        'step': {(first, third), (third, second)},
    }
    asked, shown = [], []

    def look_up(machine, true, rivals, experiment):
        asked.extend((experiment.name, true.name, rival.name) for rival in rivals)
        load = Load(0.5, 0.3, 'x_rotate')
        return [
            Separation(
                100.0 if (true.name, rival.name) in told_by[experiment.name] else 1.0,
                rival,
                2000,
                load,
            )
            for rival in rivals
        ]

    candidates = [Candidate(name, load_experiment(name)) for name in told_by]
    monkeypatch.setattr('waferbot_twin.suggestion.suggest.separations', look_up)
    monkeypatch.setattr('waferbot_twin.suggestion.suggest.library', lambda variant: candidates)
    monkeypatch.setattr('waferbot_twin.suggestion.suggest.designed', lambda *arguments: [])
    monkeypatch.setattr('waferbot_twin.suggestion.suggest._instead', lambda machine, found: [])
    machine = Machine(rigid, 1.0, 0, TIMING)
    found = suggest(machine, causes, lambda done, total: shown.append((done, total)))
    assert found.imitated == ((second, third),)
    assert found.best is None
    assert found.best_for((third, second)).candidate.label == 'step'
    assert ('step', second, first) not in asked  # given up by then, and told by the other
    assert len(set(asked)) == len(asked)
    assert shown[-1][0] == shown[-1][1]
    assert [done for done, _ in shown] == list(range(1, len(shown) + 1))


@pytest.mark.slow
def test_a_pair_that_a_small_step_leaves_open_is_told_apart_by_what_is_suggested(
    rigid, monkeypatch
):
    seed = 60
    print(f'seed {seed}')
    viscous = cause(rigid, 'viscous_friction', 'x_rotate')
    coulomb = cause(rigid, 'coulomb_friction', 'x_rotate', friction=0.05)
    small = Candidate('small', short('x_rotate', 'kind: step, amplitude_counts: 16'))
    move = (
        'kind: jog, distance_rad: 0.2, speed_rad_per_s: 1.0, acceleration_time_s: 0.1,'
        ' s_curve_time_s: 0.02'
    )
    large = Candidate('large', short('x_rotate', move))
    monkeypatch.setattr('waferbot_twin.suggestion.suggest.library', lambda variant: [small, large])
    monkeypatch.setattr('waferbot_twin.suggestion.suggest.designed', lambda *arguments: [])
    found = suggest(
        Machine(rigid, 1.0, seed, TIMING), [viscous, coulomb], lambda done, total: None
    )
    assert found.best is not None
    assert found.best.candidate is large
    assert found.rated[1].evidence(found.told) < TELLS_APART
    assert len(found.rated[1].separations) == 1  # it was not asked the other way round
    machine = Machine(rigid, 1.0, seed + 1, TIMING)
    for candidate, told in ((small, False), (large, True)):
        log = machine.record(machine.run((viscous,), candidate.experiment, noisy=True))
        problem = Problem(rigid, [log])
        own, rival = (fit_causes(problem, (one,)) for one in (viscous, coulomb))
        assert (2.0 * gain(own, rival) > TELLS_APART) == told


def test_the_same_cause_twice_is_refused(rigid):
    machine = Machine(rigid, 1.0, 0, TIMING)
    one = cause(rigid, 'coulomb_friction', 'x_rotate')
    with pytest.raises(UserError, match='two different causes'):
        suggest(machine, [one, one], lambda done, total: None)
