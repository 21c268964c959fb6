# SPDX-License-Identifier: Apache-2.0
"""
What a fitted set of causes says of itself without some of them, in the linear problem.

With w the values of those causes that go, v those of the others, the curvature B = A' A + P with which
they were fitted (`hypothesis.Hypothesis`) and their covariance V = B^-1 M B^-1, M that of the products
A' e, the others without them are

    v + B_vv^-1 B_vw w    with the covariance    B_vv^-1 M_vv B_vv^-1,                            (1)

as if fitted again. If all noise is as assumed, M = B, and that is what the conditional distribution of
v has for w = 0; where there is more of it along some directions, the weights of a fit are still B.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.estimation.gauss_newton import Names, Shown, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.estimation.size_prior import LARGEST, information_of_logs
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
    if len(found.covariance) != len(names):  # nothing was fitted
        return names, away, np.zeros((len(names), len(names)))
    gone = np.array([found.causes[place].name in out for place, _ in names], np.bool_)
    return names, *_fitted_without(away, found.covariance, found.curvature, gone)


def _fitted_without(
    values: Array, covariance: Array, curvature: Array, gone: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return values (k,) and covariance (k, k), equation (1), with those that are `gone` zero."""
    if not gone.any():
        return values, covariance
    kept = ~gone
    unit = 1.0 / np.sqrt(np.where(np.diag(curvature) > 0.0, np.diag(curvature), 1.0))
    scaled = curvature * np.outer(unit, unit)
    scores = scaled @ (covariance / np.outer(unit, unit)) @ scaled
    inverse = np.linalg.pinv(scaled[np.ix_(kept, kept)], rcond=1.0 / LARGEST, hermitian=True)
    moved, spread = np.zeros(len(values)), np.zeros(covariance.shape)
    follows = inverse @ scaled[np.ix_(kept, gone)] @ (values / unit)[gone]
    moved[kept] = values[kept] + unit[kept] * follows
    spread[np.ix_(kept, kept)] = inverse @ scores[np.ix_(kept, kept)] @ inverse
    return moved, spread * np.outer(unit, unit)


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


def shown_by(problem: Problem, hypothesis: Hypothesis) -> Shown | None:
    """Return `conditional_errors` by name: with them a fit near here begins; None without a fit."""
    errors = conditional_errors(hypothesis)
    return None if errors is None else by_name(problem, hypothesis, errors)


def by_name(
    problem: Problem, hypothesis: Hypothesis, errors: Array
) -> dict[tuple[str, str], float] | None:
    """Return errors (k,) of all parameters by the cause's name and their own; None without a fit."""
    names = names_of(problem, hypothesis.causes)
    if len(errors) != len(names):
        return None
    return {
        (hypothesis.causes[place].name, item.name): float(error)
        for (place, item), error in zip(names, errors, strict=True)
    }
