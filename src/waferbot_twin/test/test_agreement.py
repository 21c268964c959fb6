# SPDX-License-Identifier: Apache-2.0
"""The logs agree on the values of a true cause, and not on those of one that stands in for another."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import commanded_positions, load_experiment
from waferbot_twin.diagnosis.agreement import Wanted, disagreement, disagreements
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.effects import find
from waferbot_twin.effects.variant import Variant, built
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import evaluate
from waferbot_twin.models import load_model
from waferbot_twin.residuals.from_recording import record_of_signals
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.synthesis import with_noise


def wanted(change, covariance):
    change, covariance = np.atleast_1d(change), np.atleast_2d(covariance)
    return Wanted('log', change, np.linalg.inv(covariance), {})


def test_of_two_logs_it_is_the_square_of_their_difference_over_its_variance():
    square, degrees = disagreement([wanted(1.0, 0.04), wanted(2.0, 0.12)])
    assert square == pytest.approx(1.0 / 0.16)
    assert degrees == 1


def test_a_log_that_says_nothing_of_a_parameter_does_not_count():
    silent = Wanted('log', np.zeros(2), np.diag([4.0, 0.0]), {})
    square, degrees = disagreement([silent, wanted([1.0, 7.0], np.eye(2))])
    assert square == pytest.approx(1.0 / (0.25 + 1.0))
    assert degrees == 1
    assert disagreement([silent]) == (0.0, 0)
    assert disagreement([]) == (0.0, 0)


def test_of_true_causes_it_has_a_chi_squared_distribution():
    random = np.random.default_rng(11)
    print('seed 11')
    covariances = [np.array([[2.0, 0.9], [0.9, 0.5]]), np.diag([0.3, 4.0]), np.eye(2)]
    squares = []
    for _ in range(2000):
        logs = [wanted(random.multivariate_normal([3.0, -1.0], c), c) for c in covariances]
        square, degrees = disagreement(logs)
        assert degrees == 4
        squares.append(square)
    beyond = np.mean(np.array(squares) > chi2.isf(0.1, 4))
    assert beyond == pytest.approx(0.1, abs=4.0 * np.sqrt(0.1 * 0.9 / 2000))


def log_of(nominal, experiment, seed, *causes):
    """Return the noisy log of a machine with causes."""
    variant = apply_all(nominal, causes)
    noisy = with_noise(variant, nominal, 1.0, np.random.default_rng(seed))
    timing = Timing()
    twin = Twin(built(noisy, timing), noisy.pmac, noisy.copley, timing, 'rigid')
    twin.commanded = commanded_positions(
        load_experiment(experiment), twin.servo_parameters, timing.servo_hz
    )
    return record_of_signals(f'{experiment}_{seed}', twin.advance(timing.ticks(0.6)))


def friction(value):
    return Cause(find('coulomb_friction'), 'x_rotate', {'friction': value})


@pytest.mark.slow
@pytest.mark.parametrize(('in_other_log', 'agree'), [(1.5, True), (3.0, False)])
def test_a_value_that_is_another_in_each_log_is_no_value(in_other_log, agree):
    nominal = Variant.of(load_model('rigid'))
    finding = Problem(nominal, [log_of(nominal, 'random_x_rotate', 1, friction(1.5))])
    judging = Problem(nominal, [log_of(nominal, 'random_x_rotate', 2, friction(in_other_log))])
    found = fit_causes(finding, (friction(1.0),))
    search = Search(found, evaluate(judging, found.causes), evaluate(finding), evaluate(judging))
    doubted = disagreements(finding, judging, search)
    assert [item.cause.name for item in doubted] == (
        [] if agree else ['coulomb_friction:x_rotate']
    )
    for item in doubted:
        assert item.axes == ('x_rotate',)
        values = [found.causes[0].values['friction'] + one.change[0] for one in item.wanted]
        assert values == pytest.approx([1.5, in_other_log], rel=0.1)
        assert f'random_x_rotate_2 wants friction {values[1]:.4g} +- ' in str(item)
