# SPDX-License-Identifier: Apache-2.0
"""What is known of parameters that the logs do not tell, from how far off the others are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.usual_spread import scales_of_spread, with_usual_spread
from waferbot_twin.residuals.prior_block import KNOWN_FROM
from waferbot_twin.residuals.problem import Cause

SPREAD = 0.03


class Dense:
    """Parameters that are usually a little off."""

    name = 'dense'

    def __init__(self, count):
        self.count = count

    def parameters(self, variant, axis):
        return tuple(
            Parameter(f'p{n}', '', 0.0, SPREAD, -1.0, 1.0, '', spread=SPREAD)
            for n in range(self.count)
        )


class Known:
    nominal = None


def fitted(away, error, held=()):
    """Return values `away` by the most probable k, and their covariance: of logs with `error` each."""
    values = {f'p{n}': float(x) for n, x in enumerate(away)}
    cause = Cause(Dense(len(away)), 'x', values, tuple(held))
    square = (KNOWN_FROM + np.sum((away / SPREAD) ** 2)) / (KNOWN_FROM + len(away))
    free = [n for n in range(len(away)) if f'p{n}' not in held]
    precision = 1.0 / error[free] ** 2 + 1.0 / (square * SPREAD**2)
    return Hypothesis((cause,), {}, {}, np.diag(1.0 / precision))


def test_what_logs_do_not_tell_is_as_far_off_as_what_they_tell():
    """Ten of thirty are told, each two spreads off: the others may be, too."""
    away = np.array([2.0 * SPREAD] * 10 + [0.0] * 20)
    error = np.array([1e-4] * 10 + [np.inf] * 20)
    found = with_usual_spread(Known(), fitted(away, error))
    k = np.sqrt((KNOWN_FROM + 40.0) / (KNOWN_FROM + 10.0))
    errors = np.sqrt(np.diag(found.covariance))
    assert errors[:10] == pytest.approx(1e-4, rel=1e-3)
    assert errors[10:] == pytest.approx(k * SPREAD, rel=1e-3)
    assert scales_of_spread(Known(), found) == pytest.approx(
        {f'p{n}': k for n in range(30)}, rel=1e-3
    )


def test_what_is_held_says_nothing_of_the_others():
    away = np.array([2.0 * SPREAD] * 3 + [0.0] * 9)
    error = np.array([1e-4] * 3 + [np.inf] * 9)
    held = [f'p{n}' for n in range(6, 12)]
    some = with_usual_spread(Known(), fitted(away, error, held)).covariance
    none = with_usual_spread(Known(), fitted(away[:6], error[:6])).covariance
    np.testing.assert_allclose(some, none, rtol=1e-4)


def test_intervals_hold_what_the_logs_do_not_tell():
    """Machines drawn from the prior, a third of each told: the others lie within as often as said."""
    seed = 20261130
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    inside = before = 0
    machines, told, count = 2000, 4, 12
    error = np.array([1e-3 * SPREAD] * told + [np.inf] * (count - told))
    for _ in range(machines):
        k = np.sqrt(KNOWN_FROM / chi2(KNOWN_FROM).rvs(random_state=random))
        truth = k * SPREAD * random.standard_normal(count)
        found = fitted(np.where(np.arange(count) < told, truth, 0.0), error)
        reach = 1.96 * np.sqrt(np.diag(with_usual_spread(Known(), found).covariance))
        inside += int(np.sum(np.abs(truth[told:]) <= reach[told:]))
        before += int(
            np.sum(np.abs(truth[told:]) <= 1.96 * np.sqrt(np.diag(found.covariance))[told:])
        )
    total = machines * (count - told)
    print(f'held {inside / total:.3f}, before {before / total:.3f}')
    # An interval of 1.96 standard errors, where what is drawn is Student's t with nu and four more.
    normal = 1.0 - 2.0 * student(KNOWN_FROM + told).sf(1.96)
    assert inside / total == pytest.approx(normal, abs=0.015)
    assert before / total < normal - 0.05


@pytest.mark.parametrize('more', [0.7, 1.4, 3.0])
def test_what_is_not_told_is_known_as_well_as_before_whatever_a_rough_fit_has_of_its_prior(more):
    """Never less: a covariance that has the prior `more` often than its values say made it endless."""
    away = np.array([2.0 * SPREAD] * 4 + [0.0] * 8)
    error = np.array([1e-4] * 4 + [np.inf] * 8)
    rough = fitted(away, error)
    told = np.diag(rough.covariance).copy()
    told[4:] *= more
    found = with_usual_spread(Known(), Hypothesis(rough.causes, {}, {}, np.diag(told)))
    k = scales_of_spread(Known(), found)['p0']
    errors = np.sqrt(np.diag(found.covariance))
    assert (errors <= k * SPREAD * (1.0 + 1e-6)).all()
    assert k**2 <= (KNOWN_FROM + 16.0) / (KNOWN_FROM + 4.0) * (1.0 + 1e-4)
    assert errors[:4] == pytest.approx(1e-4, rel=1e-2)


def test_without_a_fit_or_without_such_parameters_nothing_changes():
    nothing = Hypothesis((), {}, {})
    assert with_usual_spread(Known(), nothing) is nothing
    unfitted = Hypothesis(fitted(np.zeros(2), np.ones(2)).causes, {}, {})
    assert with_usual_spread(Known(), unfitted) is unfitted
    assert scales_of_spread(Known(), unfitted) == {}
