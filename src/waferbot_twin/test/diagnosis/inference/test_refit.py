# SPDX-License-Identifier: Apache-2.0
"""A hypothesis without some of its causes."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.diagnosis.inference import refit
from waferbot_twin.diagnosis.inference.nuisance import each_once, nuisance, prior_groups
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.screening import at_its_sizes
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.gauss_newton import all_signatures
from waferbot_twin.estimation.hypothesis import evaluate, parameters_of
from waferbot_twin.models import load_model
from waferbot_twin.residuals.closed_loop_record import run_commanded
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem


@pytest.mark.parametrize(
    ('name', 'frees'), [('force_constant', True), ('coulomb_friction', False)]
)
def test_what_is_free_again_without_a_cause_is_fitted_though_signatures_are_known(
    monkeypatch, name, frees
):
    """Beside a force constant the dense effect holds its own: known signatures have no column for it."""
    nominal = Variant.of(load_model('rigid'))
    timing = Timing()
    commanded = commanded_positions(
        load_experiment('step'), servo_parameters(nominal.pmac, nominal.name), timing.servo_hz
    )
    signals = run_commanded(nominal, timing, commanded, timing.ticks(0.1))
    record = record_of_signals('log', signals)
    (dense, _), numbers = nuisance(nominal, [record], Settings())
    problem = Problem(nominal, [record]).with_prior(prior_groups(numbers))
    effect = find(name)
    cause = Cause(effect, 'x_rotate', effect.typical(nominal, 'x_rotate'))
    spreads = {item.name: item.spread for item in dense.parameters(nominal, 'y_linear')}
    off = Cause(dense, 'y_linear', {name: 0.1 * spread for name, spread in spreads.items()})
    found = evaluate(problem, each_once(problem, (cause, off)))
    assert bool(found.causes[1].held) == frees
    known = dict(
        zip([one.name for one in found.causes], all_signatures(problem, found), strict=True)
    )
    rounds = []
    of_apart = refit.fitted_apart

    def fitted_apart(problem, causes, workers, enough, known, most, *_):
        rounds.append((bool(known), most))
        return of_apart(problem, causes, workers, enough, known, 1)

    monkeypatch.setattr(refit, 'fitted_apart', fitted_apart)
    monkeypatch.setattr(
        refit,
        'fitted_without',
        lambda p, found, place, workers, enough, known, most, *_: fitted_apart(
            p, (found.causes[1],), workers, enough, known, most
        ),
    )
    (left,) = refit.without(problem, found, [cause.name], 1, known).causes
    assert left.held == ()
    assert rounds == [(not frees, refit.TO_CONVERGENCE if frees else refit.ROUNDS)]


def test_of_what_is_held_without_a_cause_the_columns_go():
    """Without what gives its damping says nothing: signatures of the others are known as before."""
    nominal = Variant.of(load_model('rigid'))
    (_, dampings), _ = nuisance(nominal, [], Settings())
    effect = find('cable_compliance')
    cause = Cause(effect, 'y_linear', effect.typical(nominal, 'y_linear'))
    dense = Cause(dampings, 'y_linear', dampings.typical(nominal, 'y_linear'))
    problem = Problem(nominal, [])
    both = each_once(problem, (cause, dense))
    (alone,) = each_once(problem, (dense,))
    free = [item.name for item in parameters_of(problem, both[1])]
    assert free
    matrix = np.arange(6.0 * len(free)).reshape(6, len(free))
    known = {cause.name: {'plant': np.ones((6, 1))}, dense.name: {'plant': matrix}}
    kept = refit._of_free(problem, both, (alone,), known)
    left = [free.index(item.name) for item in parameters_of(problem, alone)]
    assert len(left) < len(free)
    np.testing.assert_array_equal(kept[dense.name]['plant'], matrix[:, left])
    assert (
        refit._of_free(problem, (alone,), both[1:], {dense.name: {'plant': matrix[:, left]}}) == {}
    )
    assert refit._of_free(problem, both, (alone,), None) is None


@pytest.mark.parametrize(('true', 'start'), [(0.3, 3.0), (1.0, 10.0), (3.0, 0.3)])
def test_what_rings_is_found_from_a_wrong_maximum(true, start):
    """Sizes in typical ones: a fit from `start` ends where the ring is in step with the true one."""
    nominal, timing = Variant.of(load_model('rigid')), Timing()
    effect = find('cable_compliance')
    (parameter,) = effect.parameters(nominal, 'y_linear')

    def cause(times):
        return Cause(effect, 'y_linear', {'compliance': times * parameter.typical})

    def size(hypothesis):
        return hypothesis.causes[0].values['compliance'] / parameter.typical

    commanded = commanded_positions(
        load_experiment('random_y_linear'),
        servo_parameters(nominal.pmac, nominal.name),
        timing.servo_hz,
    )
    real = effect.apply(nominal, 'y_linear', cause(true).values)
    signals = run_commanded(real, timing, commanded, timing.ticks(0.6))
    problem = Problem(nominal, [record_of_signals('log', signals)])
    found = refit.fitted(problem, (cause(start),))
    assert abs(size(found) / true - 1.0) > 0.2
    known = dict(
        zip([one.name for one in found.causes], all_signatures(problem, found), strict=True)
    )
    (stuck,) = found.causes
    trials = list(at_its_sizes(effect.parameters(nominal, 'y_linear'), stuck))
    better = refit.to_the_end(problem, refit.begun_elsewhere(problem, found, trials, known))
    assert size(better) == pytest.approx(true, rel=0.01)
    assert better.log_likelihood > found.log_likelihood + 100.0
    again = refit.begun_elsewhere(problem, better, trials, known)
    assert size(again) == pytest.approx(true, rel=0.01)
