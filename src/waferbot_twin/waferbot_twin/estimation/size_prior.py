# SPDX-License-Identifier: Apache-2.0
"""
The prior of an effect's sizes as a part of every fit.

Of a cause with n sizes w, W the squares of their typical values,

    p(w) = 1/M sum over m of N(w; 0, tau_m^2 W),        w'W^-1 w = q                               (1)

(a normal scale mixture). The fit ends where likelihood times prior is largest. Where the logs say what
a size is, that is where the likelihood is largest; where they say only a sum or a difference of some, as
of a force that repeats over a way of which the axis went a tenth, each is as small as it can be. Without
a prior they run away against each other as far as their bounds.

About given sizes (1) is as a normal distribution with the precision

    P = W^-1 sum over m of p_m / tau_m^2,    p_m ~ tau_m^-n exp(-q / (2 tau_m^2)),                  (2)

with which every step of the fit makes (1) larger (expectation-maximisation: A. Dempster, N. Laird,
D. Rubin, J. Royal Statistical Society B 39, 1977). A shape parameter has no size. Those of the dense
effect have a prior of their own (`residuals.prior_block`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp, softmax

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import parameters_of
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

LARGEST = 1e12
"""Most that is known of anything, over the least that is: the rest is rounding, not knowledge."""


def scales_of(problem: Problem, cause: Cause, scales: Sequence[float]) -> tuple[float, ...]:
    """
    Return the scales of the prior of a cause's sizes, of those that hold where a drive has a rating.

    A drive that carries next to nothing has a hundredth of its rated current: a size that follows from
    the currents of a log may be as much too small.
    """
    if scales and problem.sized_by_log(cause.effect, cause.axis):
        return (*scales, *problem.unrated_scales)
    return tuple(scales)


def log_prior(problem: Problem, causes: Sequence[Cause]) -> float:
    """Return ln of equation (1) of all causes, up to a constant for each; 0 without a prior."""
    total = 0.0
    for cause in causes if problem.size_scales else ():
        count, square = _of(cause, parameters_of(problem, cause))
        terms = _log_terms(count, square, scales_of(problem, cause, problem.size_scales))
        total += float(logsumexp(terms)) if count else 0.0
    return total


def precision(problem: Problem, cause: Cause) -> Array:
    """Return the diagonal (k,) of equation (2) for the parameters of a cause; zeros without a prior."""
    scales = scales_of(problem, cause, problem.size_scales)
    return precision_at(cause, parameters_of(problem, cause), scales)


def precision_at(cause: Cause, parameters: Sequence[Parameter], scales: Sequence[float]) -> Array:
    """Return the diagonal (k,) of equation (2) for some parameters of a cause."""
    count, square = _of(cause, parameters)
    if not scales or not count:
        return np.zeros(len(parameters))
    weights = softmax(_log_terms(count, square, scales))
    mean = float(weights @ np.array(scales) ** -2.0)
    return np.array([mean / size(item) ** 2 if size(item) > 0.0 else 0.0 for item in parameters])


def size(item: Parameter) -> float:
    """Return the typical size of a parameter; 0 of one that has none, or a prior of its own."""
    return 0.0 if item.shape or item.spread else abs(item.typical - item.neutral)


def away_from_neutral(cause: Cause, parameters: Sequence[Parameter]) -> Array:
    """Return how far each parameter (k,) is from there being none of it; 0 of a shape."""
    return np.array(
        [0.0 if item.shape else cause.values[item.name] - item.neutral for item in parameters]
    )


def posterior_covariance(information: Array, prior: Array) -> Array:
    """
    Return the covariance (k, k) of what the logs say (`information`) with a prior, (L + P)^-1.

    `prior` is the diagonal of its precision, equation (2). What neither says has `LARGEST`.
    """
    total = information + np.diag(prior)
    unit = _errors(total)
    size, directions = np.linalg.eigh(total / np.outer(unit, unit))
    found = directions / np.maximum(size, 1.0 / LARGEST) @ directions.T
    return np.asarray(found / np.outer(unit, unit))


def information_of_logs(spread: Array, prior: Array) -> Array:
    """
    Return what the logs alone say (k, k), of the covariance to which a prior has contributed.

    Its inverse less `prior`, the diagonal of that one's precision. Along what the logs do not say that
    is zero but for rounding.
    """
    unit = _errors(spread)
    size, directions = np.linalg.eigh(spread / np.outer(unit, unit))
    total = directions / np.maximum(size, 1.0 / LARGEST) @ directions.T
    return np.asarray(total / np.outer(unit, unit) - np.diag(prior))


def _errors(spread: Array) -> Array:
    """Return standard errors to scale by; 1 where there is none."""
    return np.sqrt(np.where(np.diag(spread) > 0.0, np.diag(spread), 1.0))


def _of(cause: Cause, parameters: Sequence[Parameter]) -> tuple[int, float]:
    """Return how many sizes a cause has, and q of equation (1)."""
    sizes = np.array([size(item) for item in parameters])
    there = sizes > 0.0
    away = away_from_neutral(cause, parameters)[there] / sizes[there]
    return int(there.sum()), float(away @ away)


def _log_terms(count: int, square: float, scales: Sequence[float]) -> Array:
    """Return ln of the terms of equation (1), up to a constant."""
    return np.array(
        [-count * math.log(scale) - 0.5 * square / scale**2 for scale in scales]
    ) - math.log(len(scales) or 1)
