# SPDX-License-Identifier: Apache-2.0
"""Known values beside an estimate, against the least squares of both data sets together."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_twin.estimation.known_values import (
    DISAGREES,
    Known,
    disagree,
    together,
    without_prior,
)


def fitted(rows, readings):
    covariance = np.linalg.inv(rows.T @ rows)
    return covariance @ rows.T @ readings, covariance


def test_two_data_sets_one_after_the_other_are_both_at_once():
    """Of one parameter that the first set alone tells: what is passed on then loses nothing."""
    random = np.random.default_rng(1)
    first, second = np.zeros((40, 3)), random.normal(size=(30, 3)) * [1.0, 1e-3, 1e3]
    first[:, 1] = random.normal(size=40)
    y, z = random.normal(size=40), random.normal(size=30)
    alone = float(first[:, 1] @ y / (first[:, 1] @ first[:, 1]))
    known = Known(alone, float((first[:, 1] @ first[:, 1]) ** -0.5))
    found, covariance = together(*fitted(second, z), [1], [known])
    expected, spread = fitted(np.vstack([first, second]), np.concatenate([y, z]))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_allclose(covariance, spread, rtol=1e-9, atol=1e-18)


def test_a_value_with_as_much_information_halves_the_variance():
    found, covariance = together(np.array([2.0]), np.array([[0.04]]), [0], [Known(3.0, 0.2)])
    assert found[0] == pytest.approx(2.5)
    assert covariance[0, 0] == pytest.approx(0.02)


def test_the_prior_of_before_counts_once():
    """Readings y with variance 1 each, a prior N(m, s^2): what it was made of comes back."""
    y, centre, spread = np.array([1.1, 0.7, 1.4]), 0.2, 0.5
    precision = len(y) + spread**-2
    after = Known(float((y.sum() + centre * spread**-2) / precision), precision**-0.5)
    own = without_prior(after, centre, spread**-2)
    assert own.value == pytest.approx(y.mean())
    assert own.error == pytest.approx(len(y) ** -0.5)
    assert without_prior(Known(centre, spread), centre, spread**-2) is None


def test_what_differs_by_more_than_chance_is_told():
    known, error = Known(1.0, 0.3), 0.4  # together 0.5
    assert not disagree(known, 1.0 + 0.49 * DISAGREES, error**2)
    assert disagree(known, 1.0 + 0.51 * DISAGREES, error**2)
    assert pytest.approx(3.29, abs=0.001) == DISAGREES


def test_nothing_known_changes_nothing():
    values, covariance = np.array([1.0, 2.0]), np.eye(2)
    found = together(values, covariance, [], [])
    assert found[0] is values
    assert found[1] is covariance
