# SPDX-License-Identifier: Apache-2.0
"""Limits that an exact block has: fitted where a fit by slopes stops beside the valley."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.proposals.screening import Screened
from waferbot_twin.diagnosis.screening_rounds import Rounds
from waferbot_twin.diagnosis.search import search
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.shortlist import fit_exact
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import AMPLIFIER, PLAIN, Cause, Problem

AXIS = 'x_rotate'


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log_of(variant):
    timing = Timing()
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, variant.name)
    motion = load_experiment('step')
    twin.commanded = commanded_positions(motion, twin.servo_parameters, timing.servo_hz)
    return record_of_signals('log', twin.advance(timing.ticks(0.2)))


def left(problem, hypothesis):
    return problem.less_likely_than_nothing(AMPLIFIER, hypothesis.residuals[AMPLIFIER])[AXIS]


@pytest.mark.slow
def test_a_fold_back_is_found_where_a_fit_by_slopes_leaves_it(nominal):
    seed = 20261122
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    effect = find('i2t_foldback')
    free = log_of(nominal)
    largest = np.abs(free.command[:, 1]).max()
    left_by_slopes = 0
    for _ in range(4):
        continuous = largest * random.uniform(0.25, 0.4)
        true = {'continuous': continuous, 'time': random.uniform(2e-3, 1e-2)}
        record = log_of(effect.apply(nominal, AXIS, true))
        problem = Problem(nominal, [record])

        start = {name: value * random.uniform(0.97, 1.03) for name, value in true.items()}
        begun = Cause(effect, AXIS, start)
        by_slopes = fit_causes(problem, (begun,))
        left_by_slopes += left(problem, by_slopes) > PLAIN
        found = downhill(problem, begun, by_slopes)
        assert left(problem, found) < PLAIN
        assert found.causes[0].values['continuous'] == pytest.approx(true['continuous'], rel=1e-5)
        assert found.causes[0].values['time'] == pytest.approx(true['time'], rel=0.1)  # a tick's
    assert left_by_slopes, 'none of these needed it'


@pytest.mark.slow
def test_a_limit_that_no_rung_promises_is_fitted_where_an_exact_block_leaves_some_over(nominal):
    effect = find('i2t_foldback')
    true = {'continuous': 9.3, 'time': 0.0043}
    problem = Problem(nominal, [log_of(effect.apply(nominal, AXIS, true))])
    nothing = evaluate(problem)
    state = Search(nothing, nothing, nothing, nothing)
    rung = Cause(effect, AXIS, {'continuous': 7.5, 'time': 0.005})
    elsewhere = Cause(effect, 'y_linear', {'continuous': 7.5, 'time': 0.005})
    screened = [Screened(cause, -5.0, np.zeros(2)) for cause in (elsewhere, rung)]
    (fitted,) = fit_exact(problem, problem, state, screened, [], lambda *_: None)
    found = fitted.found.causes[0]
    assert found.axis == AXIS
    assert found.values['continuous'] == pytest.approx(true['continuous'], rel=1e-5)
    assert not fit_exact(problem, problem, state, screened, [fitted], lambda *_: None)


@pytest.mark.slow
@pytest.mark.parametrize('time', [0.0061, 1.0])
def test_a_cause_whose_values_leave_some_over_in_other_logs_is_looked_for_there_anew(
    nominal, time
):
    effect = find('i2t_foldback')
    true = {'continuous': 10.3, 'time': 0.006}
    problem = Problem(nominal, [log_of(effect.apply(nominal, AXIS, true))])
    known = evaluate(problem, (Cause(effect, AXIS, {**true, 'time': time}),))
    nothing = evaluate(problem)
    state = Search(known, known, nothing, nothing)
    assert (left(problem, known) < PLAIN) == (time < 0.01)
    found = search(Rounds(problem, [effect], lambda *_: None), problem, state).found
    assert [cause.name for cause in found.causes] == [f'i2t_foldback:{AXIS}']
    assert (
        left(problem, found) < PLAIN
    )  # half of the level from the first tick on does the same here


@pytest.mark.slow
def test_what_leaves_nothing_over_or_has_no_threshold_is_left_as_it_is(nominal):
    problem = Problem(nominal, [log_of(nominal)])
    for name in ('i2t_foldback', 'coulomb_friction'):
        effect = find(name)
        neutral = {p.name: p.neutral for p in effect.parameters(nominal, AXIS)}
        fitted = fit_causes(problem, (Cause(effect, AXIS, neutral),), rounds=0)
        assert downhill(problem, fitted.causes[0], fitted) is fitted
