# SPDX-License-Identifier: Apache-2.0
"""How far the parameters of a cause may be from what a fit says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate, standard_errors
from waferbot_twin.estimation.intervals import AS_LIKELY, Rival, averaged, intervals_95
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def nominal():
    return Variant.of(load_model('rigid'))


def log_of(nominal, *causes, motion='random_y_rotate', seconds=0.6):
    timing, variant = Timing(), apply_all(nominal, causes)
    twin = Twin(built(variant, timing), variant.pmac, variant.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(motion), twin.servo_parameters, timing.servo_hz
    )
    return Problem(nominal, [record_of_signals('log', twin.advance(timing.ticks(seconds)))])


def fold_back(continuous, time, axis='y_rotate'):
    return Cause(find('i2t_foldback'), axis, {'continuous': continuous, 'time': time})


def test_what_the_logs_tell_nothing_of_reaches_as_far_as_they_are_as_likely(nominal):
    most = float(np.max(np.abs(log_of(nominal).records[0].command[:, 2])))
    # its peak current, twice the continuous one, cuts off a little; there is no time to fold back
    truth = fold_back(0.48 * most, 0.06)
    problem = log_of(nominal, truth)
    found = fit_causes(problem, (fold_back(0.48 * most, 0.1),))
    assert standard_errors(found)[1] > 1e3  # s
    assert found.log_likelihood == pytest.approx(
        evaluate(problem, (truth,)).log_likelihood, abs=1.0
    )

    intervals = intervals_95(problem, found, 0, standard_errors(found))
    low, high = intervals['continuous']
    assert low <= 0.48 * most <= high
    assert high - low < 0.01 * most
    low, high = intervals['time']
    assert low <= 0.06 <= high
    (cause,) = found.causes
    for end, further in ((low, 0.95), (high, 1.05)):
        inside = evaluate(problem, (cause.with_values({'time': end}),))
        assert 2.0 * (found.log_likelihood - inside.log_likelihood) <= AS_LIKELY
        outside = cause.with_values({'time': end * further})
        bounds = cause.effect.parameters(nominal, cause.axis)[1]
        if bounds.low <= outside.values['time'] <= bounds.high:
            beyond = evaluate(problem, (outside,))
            assert 2.0 * (found.log_likelihood - beyond.log_likelihood) > AS_LIKELY


def test_a_limit_that_acts_anywhere_between_two_ticks_reaches_from_one_to_the_other(nominal):
    level, time = 11.2, 0.005
    truth = fold_back(level, time, 'x_rotate')
    problem = log_of(nominal, truth, motion='step', seconds=0.2)
    right = evaluate(problem, (truth,)).log_likelihood
    times = time * np.linspace(0.7, 1.6, 181)
    each = [evaluate(problem, (truth.with_values({'time': one}),)).log_likelihood for one in times]
    as_likely = times[2.0 * (right - np.array(each)) <= AS_LIKELY]
    print(f'as likely: {as_likely[0]:g} to {as_likely[-1]:g} s')
    assert times[0] < as_likely[0] < as_likely[-1] < times[-1]
    for end in (as_likely[0], as_likely[-1]):  # wherever between the two a fit ends
        found = fit_causes(problem, (truth.with_values({'time': end}),))
        low, high = intervals_95(problem, found, 0, standard_errors(found))['time']
        assert low <= time <= high
        assert low <= as_likely[0] * (1.0 + 0.01)
        assert high >= as_likely[-1] * (1.0 - 0.01)


def test_what_the_logs_tell_reaches_two_standard_errors_and_as_far_as_other_models(nominal):
    held = {'cosine': 2e-5, 'sine': 1e-5, 'period': 2.0 * math.pi}
    own = Cause(find('encoder_eccentricity'), 'y_rotate', held, held=('period',))
    problem = log_of(nominal, own)
    found = fit_causes(problem, (own,))
    errors = standard_errors(found)
    assert (errors > 0.0).all()
    alone = intervals_95(problem, found, 0, errors)
    (cause,) = found.causes
    assert alone.keys() == {'cosine', 'sine'}
    for name, error in zip(('cosine', 'sine'), errors, strict=True):
        value = cause.values[name]
        assert alone[name] == pytest.approx((value - 1.96 * error, value + 1.96 * error), rel=1e-4)

    other = replace(found, causes=(cause.with_values({'sine': 9e-5}),))
    elsewhere = replace(found, causes=())
    both = intervals_95(problem, found, 0, errors, [Rival(other, 0.0), Rival(elsewhere, 9.0)])
    assert both['cosine'] == pytest.approx(alone['cosine'], rel=1e-6)
    assert both['sine'][0] == alone['sine'][0]
    # Two models as probable as one another: 5 % of the other one are beyond.
    assert both['sine'][1] == pytest.approx(9e-5 + norm.ppf(0.95) * errors[1], rel=1e-3)
    assert both.keys() == alone.keys()


ERRORS = st.one_of(st.just(0.0), st.floats(1e-6, 10.0))


@given(
    value=st.floats(-1e3, 1e3),
    error=ERRORS,
    others=st.lists(st.tuples(st.floats(-1e3, 1e3), ERRORS, st.floats(-9.0, 3.0)), max_size=4),
    scale=st.sampled_from([1e-9, 1.0, 1e6]),
)
@settings(derandomize=True, deadline=None)
def test_an_averaged_interval_leaves_as_much_of_all_models_at_either_end(
    value, error, others, scale
):
    """Counted in draws from the models, whatever the unit."""
    of_all = [(scale * one, scale * other, odds) for one, other, odds in others]
    low, high = averaged(scale * value, scale * error, of_all)
    random = np.random.default_rng(20)
    shares = np.exp([0.0, *(odds for _, _, odds in others)])
    chosen = random.choice(len(shares), 20_000, p=shares / shares.sum())
    means, errors, _ = (scale * np.array([(value, error, 0.0), *others])).T
    draws = means[chosen] + errors[chosen] * random.standard_normal(len(chosen))
    slack = 1e-6 * max(float(np.ptp(means)) + float(errors.max()), abs(scale))
    assert np.mean(draws < low - slack) <= 0.025 + 0.006
    assert np.mean(draws > high + slack) <= 0.025 + 0.006
    if error > 0.0 and not others:
        assert high - low == pytest.approx(2.0 * 1.96 * scale * error, rel=1e-3)
