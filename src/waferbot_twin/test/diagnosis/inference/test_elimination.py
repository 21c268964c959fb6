# SPDX-License-Identifier: Apache-2.0
"""Backward elimination in the linear problem, against least squares without what is out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_twin.diagnosis.inference.elimination import _eliminated, _linear_odds
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Cause

NAMES = ('one', 'two', 'three', 'four')
POOL = SimpleNamespace(
    problem=SimpleNamespace(nominal=None, size_scales=()),
    settings=Settings(),
    log_prior=lambda cause: -3.0,
)


class Term:
    """An effect of one parameter."""

    def __init__(self, name):
        self.name = name

    def parameters(self, variant, axis):
        return (Parameter('value', '', 0.0, 1.0, -100.0, 100.0, ''),)


def least_squares(columns, wanted, names):
    """Return the hypothesis of least squares in noise of variance 1."""
    covariance = np.linalg.inv(columns.T @ columns)
    values = covariance @ columns.T @ wanted
    causes = tuple(
        Cause(Term(name), 'x', {'value': float(value)})
        for name, value in zip(names, values, strict=True)
    )
    return Hypothesis(causes, {}, {}, covariance)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), out=st.sets(st.sampled_from(NAMES), max_size=3))
def test_what_is_out_leaves_the_others_as_least_squares_without_it_do(seed, out):
    random = np.random.default_rng(seed)
    columns = random.standard_normal((50, 4)) @ random.standard_normal((4, 4))
    wanted = columns @ random.normal(0.0, 0.3, 4) + random.standard_normal(50)
    inside = [place for place, name in enumerate(NAMES) if name not in out]
    names = [NAMES[place] for place in inside]
    found = _linear_odds(
        POOL, least_squares(columns, wanted, NAMES), {f'{name}:x' for name in out}
    )
    truth = _linear_odds(POOL, least_squares(columns[:, inside], wanted, names))
    assert found.keys() == truth.keys()
    assert found == pytest.approx(truth, rel=1e-6, abs=1e-6)


def test_one_of_two_that_do_the_same_stays():
    """Each alone is not evident beside the other, but together they are what is there."""
    seed = 20261126
    print(f'seed {seed}')
    random = np.random.default_rng(seed)
    first, third = random.standard_normal((2, 400))
    columns = np.column_stack([first, first + 0.01 * random.standard_normal(400), third])
    wanted = 2.0 * first + random.standard_normal(400)
    found = least_squares(columns, wanted, NAMES[:3])
    names = [cause.name for cause in found.causes]
    assert all(odds < 0.0 for odds in _linear_odds(POOL, found).values())
    out = _eliminated(POOL, found, names)
    assert 'three:x' in out
    assert len(out) == 2


def test_without_a_covariance_nothing_is_out():
    found = least_squares(np.eye(4), np.zeros(4), NAMES)
    nothing_known = Hypothesis(found.causes, {}, {})
    assert _eliminated(POOL, nothing_known, [cause.name for cause in found.causes]) == []
