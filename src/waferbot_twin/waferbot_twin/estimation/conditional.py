# SPDX-License-Identifier: Apache-2.0
"""
What a fitted set of causes says of itself without some of them, in the linear problem.

With w the values of those causes that go, V_ww their covariance and V_vw that with the values v of the
others,

    v - V_vw V_ww^-1 w    with the covariance    V_vv - V_vw V_ww^-1 V_wv                        (1)

are those of the others without them.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from waferbot_twin.estimation.gauss_newton import Names, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.estimation.size_prior import information_of_logs
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array


def conditional(
    problem: Problem, found: Hypothesis, out: Collection[str]
) -> tuple[Names, Array, Array]:
    """
    Return all parameters, how far they are from neutral without the causes `out`, and their covariance.

    By equation (1). What has no covariance, as nothing was fitted, stays as it is.
    """
    names = names_of(problem, found.causes)
    away = np.array(
        [
            0.0 if item.shape else found.causes[place].values[item.name] - item.neutral
            for place, item in names
        ]
    )
    spread = found.covariance
    if len(spread) != len(names):  # nothing was fitted
        spread = np.zeros((len(names), len(names)))
    gone = np.array([found.causes[place].name in out for place, _ in names], np.bool_)
    if gone.any():
        follows = spread[:, gone] @ np.linalg.pinv(spread[np.ix_(gone, gone)], hermitian=True)
        away = away - follows @ away[gone]
        spread = spread - follows @ spread[gone]
    return names, away, spread


def others_without(problem: Problem, found: Hypothesis, out: Collection[str]) -> tuple[Cause, ...]:
    """Return the causes of a hypothesis but some, as equation (1) has them within their bounds."""
    names, away, _ = conditional(problem, found, out)
    values = [dict(cause.values) for cause in found.causes]
    for (place, item), change in zip(names, away, strict=True):
        if not item.shape:
            values[place][item.name] = float(np.clip(item.neutral + change, item.low, item.high))
    return tuple(
        cause.with_values(own)
        for cause, own in zip(found.causes, values, strict=True)
        if cause.name not in out
    )


def without_by_linear(problem: Problem, found: Hypothesis, name: str) -> Hypothesis:
    """
    Return a hypothesis without one cause, the others as equation (1) has them within their bounds.

    Raises `UserError` if the machine blows up so.
    """
    return evaluate(problem, others_without(problem, found, {name}))


def conditional_errors(hypothesis: Hypothesis) -> Array | None:
    """Return the standard error (k,) of every parameter, all others known; None without a fit."""
    spread = hypothesis.covariance
    if not len(spread):
        return None
    information = information_of_logs(spread, np.zeros(len(spread)))
    return np.asarray(np.diag(information) ** -0.5)
