# SPDX-License-Identifier: Apache-2.0
"""
Heterogeneity: by how much parts of the logs differ in the size of a cause.

A cause that is real has one size, in every log and at any time. Let e be what is left over with it,
d its change of the residuals, both white, and b the parts of the logs, with scores s_b = d_b' e_b and
J_b = d_b' d_b. If the noise model is right, each part's own estimate of the size is s_b / J_b off by
noise of variance 1 / J_b only, and

    Q = sum over b of s_b^2 / J_b - (sum s_b)^2 / sum J_b                                          (1)

is chi squared with B - 1 degrees of freedom (W. G. Cochran, Biometrics 10, 1954). What a model lacks
makes it larger: the direction then stands for something that is in some parts only. Along d there is
then the power

    lambda = max(1, (nu_0 phi_0 + Q) / (nu_0 + B - 1)),     nu = nu_0 + B - 1 degrees of freedom,   (2)

with the prior of Q / (B - 1) over directions, scaled inverse chi squared (phi_0, nu_0), from the
functions of the state of the axis (`misfit`): what is left over, in directions of its kind, disagrees
by as much (empirical Bayes, by the moments of the logarithm: G. K. Smyth, Statistical Applications in
Genetics and Molecular Biology 3, 2004). Where the model is exact, all of them have the spread of chi
squared alone, nu_0 is infinite and phi_0 = 1: nothing changes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, polygamma
from scipy.stats import chi2, f

from waferbot_twin.noise_model.misfit import InLog
from waferbot_twin.noise_model.power import Power

Array = NDArray[np.float64]

PARTS = 4
"""Parts of a log."""


def power_along(left: Sequence[Array], changes: Sequence[Array], logs: Sequence[InLog]) -> Power:
    """
    Return equation (2) in the channels of one axis, log by log.

    `left` and `changes` are e and d, white.
    """
    parts = [
        (few @ own, own @ own)
        for pair in zip(left, changes, strict=True)
        for few, own in zip(*(np.array_split(one, PARTS) for one in pair), strict=True)
    ]
    products, squares = np.array(parts)[:, :, None].transpose(1, 0, 2)
    (own,), (freedom,) = _heterogeneity(products, squares)
    if not freedom or not logs[0].count:
        return Power(1.0, math.inf)
    usual, known = _usual(left, logs)
    if math.isinf(known):
        return Power(max(usual, 1.0), math.inf)
    nu = known + float(freedom)
    return Power(max((known * usual + float(own)) / nu, 1.0), nu)


def _heterogeneity(products: Array, squares: Array) -> tuple[Array, Array]:
    """
    Return Q and its degrees of freedom (k,) of scores and squares (b, k), equation (1).

    Of the parts where there is more of a direction than rounding makes.
    """
    seen = squares > np.finfo(float).eps * squares.sum(axis=0)
    products, squares = (np.where(seen, one, 0.0) for one in (products, squares))
    of_parts = np.divide(products**2, squares, out=np.zeros_like(squares), where=seen)
    total = squares.sum(axis=0)
    common = products.sum(axis=0)
    of_all = np.divide(common**2, total, out=np.zeros_like(total), where=total > 0.0)
    return of_parts.sum(axis=0) - of_all, np.maximum(seen.sum(axis=0) - 1, 0)


def _usual(left: Sequence[Array], logs: Sequence[InLog]) -> tuple[float, float]:
    """Return phi_0 and nu_0 of what is left over, along the functions of the state."""
    parts = [log.along_parts(rows, PARTS) for log, rows in zip(logs, left, strict=True)]
    products, squares = (np.concatenate(some) for some in zip(*parts, strict=True))
    own, freedom = _heterogeneity(products, squares)
    some = freedom > 0
    return prior_of(own[some] / freedom[some], freedom[some])


def prior_of(variances: Array, freedom: Array) -> tuple[float, float]:
    """
    Return phi_0 and nu_0 of variances (k,) with so many degrees of freedom (k,).

    From mean and variance of their logarithms: those of ln(phi_0) and of chi squared of either. One
    variance for all, nu_0 infinite, unless they differ by more than that by Schwarz's criterion.
    """
    if len(variances) < 2:
        return 1.0, math.inf
    common = float(freedom @ variances / freedom.sum())
    half = 0.5 * freedom
    logs = np.log(np.maximum(variances, np.finfo(float).tiny)) - digamma(half) + np.log(half)
    more = float(np.var(logs, ddof=1) - np.mean(polygamma(1, half)))
    if more <= 0.0:
        return common, math.inf
    known = _half_with(more)
    middle = math.exp(float(np.mean(logs)) + float(digamma(known)) - math.log(known))
    alike = chi2.logpdf(variances * freedom / common, freedom) + np.log(freedom / common)
    apart = f.logpdf(variances / middle, freedom, 2.0 * known) - math.log(middle)
    if float(np.sum(apart - alike)) <= 0.5 * math.log(len(variances)):
        return common, math.inf
    return middle, 2.0 * known


def _half_with(variance: float) -> float:
    """
    Return half of the degrees of freedom with which ln of chi squared has a variance.

    Newton's steps for the inverse of the trigamma function, from below (Smyth 2004, appendix).
    """
    half, step = 0.5 + 1.0 / variance, math.inf
    while abs(step) > np.sqrt(np.finfo(float).eps) * half:
        now = float(polygamma(1, half))
        step = now * (1.0 - now / variance) / float(polygamma(2, half))
        half += step
    return half
