# SPDX-License-Identifier: Apache-2.0
"""What goes back from its bound beside a candidate, by the conditions of Karush, Kuhn and Tucker."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies

from waferbot_twin.diagnosis.proposals.screening import _away

ROWS = 40


@given(strategies.integers(0, 2**32 - 1), strategies.integers(0, 5), strategies.integers(0, 3))
def test_what_moves_away_lessens_what_is_left_and_nothing_else_would(seed, held, alone):
    random = np.random.default_rng(seed)
    left = random.standard_normal(ROWS)
    columns = random.standard_normal((ROWS, held)) * 10.0 ** random.uniform(-3.0, 3.0, held)
    candidate = random.standard_normal((ROWS, alone))
    moves = _away(left, columns, candidate)
    system = np.hstack([columns[:, moves], candidate])
    values = -np.linalg.lstsq(system, left, rcond=None)[0]
    assert (values[: moves.sum()] > 0.0).all()
    after = left + system @ values
    slopes = columns.T @ after / np.linalg.norm(columns, axis=0)
    assert (slopes > -1e-6).all()


def test_what_changes_nothing_stays_where_it_is():
    left, nothing = np.ones(ROWS), np.zeros((ROWS, 2))
    assert not _away(left, nothing, nothing).any()
    assert not _away(left, nothing[:, :0]).any()
    pushed = np.column_stack([np.zeros(ROWS), -np.ones(ROWS)])
    assert _away(left, pushed, nothing).tolist() == [False, True]
