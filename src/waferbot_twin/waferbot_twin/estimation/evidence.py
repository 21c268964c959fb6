# SPDX-License-Identifier: Apache-2.0
"""
How much more the logs speak for one set of causes than for another.

**Gain.** Two hypotheses A and B leave the residuals r_A and r_B over and have the likelihood ratio
L_A / L_B (`hypothesis.log_likelihood_ratio`). With the difference d = r_B - r_A and the power lambda
of what A leaves over along d, both filtered by the noise model of A, known with nu degrees of freedom
(`noise_model.residual_spectrum.powers_along`), in every channel,

    G = sum over channels of (nu + 1) / 2 ln(1 + 2 ln(L_A / L_B) / (lambda nu))                     (1)

is the logarithm of their likelihood ratio. Where the noise model is right, lambda is 1, nu large
and G the usual one; where A lacks something, or noise has another colour, the working likelihood
is corrected as composite likelihoods are (R. E. Chandler, S. Bate, Biometrika 94, 2007): the
weighting, and with it the estimate, stays that of the noise model.

**Evidence.** Of a cause with the estimate w and its covariance V, in a normal scale mixture of
priors N(0, tau_m^2 W) with equal weights (W from the effect's typical size), the Bayes factor
against none of it is

    ln BF = G + ln 1/M sum over m of |V|^1/2 |V_m|^-1/2 exp(-w' V_m^-1 w / 2),  V_m = V + tau_m^2 W   (2)

(Laplace's approximation; G is the w' V^-1 w / 2 of the linear case, V the covariance that the logs
alone give). The priors of the other causes (`size_prior`) count in G, as far as their values differ. A
shape parameter, a phase or a frequency, has no size: its prior has the width of what is possible, so
that whoever tries many frequencies pays for it. Parameters with a usual spread s have their prior in
the fit already (`residuals.prior_block`), and with it in G and V; what is left of (2) is

    ln BF = G + 1/2 ln |V| - sum over n of them of ln s + c(n),                                   (3)

c that of `residuals.prior_block`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis, log_likelihood_ratios, parameters_of
from waferbot_twin.estimation.size_prior import log_prior, precision, without_prior
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.noise_model.residual_spectrum import log_likelihood_ratios_in, powers_along
from waferbot_twin.residuals.prior_block import log_normaliser
from waferbot_twin.residuals.problem import PRIOR, Cause, Problem
from waferbot_twin.residuals.record import Array

SMALLEST = 1e-12
"""Smallest variance of an estimate, as a share of its prior's: rounding, not knowledge."""


def gain(
    more: Hypothesis, fewer: Hypothesis, noise_known: bool = False, power_known: bool = False
) -> float:
    """
    Return equation (1): how much likelier the logs are with `more` than with `fewer`.

    Antisymmetric, channel by channel: each is seen from the one that leaves less over there. Seen
    from the other one, what it lacks would be noise along the very direction in question. Both are
    hypotheses of the same problem. With `noise_known` the noise of both is that of `more`, as where
    both were simulated with the same; with `power_known` lambda is taken for the true one: nu is
    infinite.
    """
    seen = _seen_from(more, fewer, noise_known, power_known)
    if noise_known or all(one >= 0.0 for one in seen):
        return sum(seen)
    back = _seen_from(fewer, more, noise_known, power_known)
    return sum(
        one if one >= 0.0 else -max(other, 0.0) for one, other in zip(seen, back, strict=True)
    )


def _seen_from(
    this: Hypothesis, other: Hypothesis, noise_known: bool, power_known: bool
) -> list[float]:
    """Return equation (1) with the noise that `this` leaves, channel by channel of every block."""
    found: list[float] = []
    for block, fit in this.fits.items():
        if block == PRIOR:
            found.append(fit.log_likelihood - other.fits[block].log_likelihood)
            continue
        if fit is other.fits[block]:
            found += [0.0] * len(fit.colours)
            continue
        left = fit.whitened
        before = in_deviations(fit.colours, other.residuals[block])
        changes = [one - two for one, two in zip(before, left, strict=True)]
        if noise_known or not any(colour.error.order for colour in fit.colours):
            squares = [
                float(one @ one) - float(two @ two) for one, two in zip(before, left, strict=True)
            ]
        else:
            squares = [2.0 * ratio for ratio in log_likelihood_ratios(this, other, block)]
        powers = powers_along(left, changes, fit.colours)
        if power_known:
            powers = [power.as_if_known for power in powers]
        found += log_likelihood_ratios_in(powers, squares)
    return found


def log_occam(
    cause: Cause, parameters: Sequence[Parameter], spread: Array, scales: Sequence[float]
) -> float:
    """
    Return the second term of equation (2) of a cause whose estimates have the covariance `spread`.

    It is zero or negative for a size that is usual, the more so the better the logs know the
    values.
    """
    if not parameters:
        return 0.0
    if all(item.spread > 0.0 for item in parameters):
        spreads = np.array([item.spread for item in parameters])
        return _half_log_det(spread / np.outer(spreads, spreads)) + log_normaliser(len(spreads))
    away, sizes, widths = [], [], []
    for item in parameters:
        value = cause.values[item.name]
        if item.shape:
            away.append(0.0)
            sizes.append(0.0)
            widths.append(_width(item, value) ** 2)
        else:
            away.append(value - item.neutral)
            sizes.append((item.typical - item.neutral) ** 2)
            widths.append(0.0)
    offset, size, width = np.array(away), np.array(sizes), np.array(widths)
    unit = np.sqrt(np.where(size > 0.0, size, np.where(width > 0.0, width, 1.0)))
    scaled = spread / np.outer(unit, unit)
    scaled = scaled + np.diag(np.maximum(SMALLEST - np.diag(scaled), 0.0))
    scaled = 0.5 * (scaled + scaled.T)
    terms = []
    for scale in scales:
        prior = scaled + np.diag((size * scale**2 + width) / unit**2)
        difference = _half_log_det(scaled) - _half_log_det(prior)
        terms.append(
            difference - 0.5 * float((offset / unit) @ np.linalg.pinv(prior) @ (offset / unit))
        )
    return float(logsumexp(terms) - math.log(len(terms)))


def _half_log_det(matrix: Array) -> float:
    """Return half of the logarithm of a determinant; directions without any variance count as tiny."""
    return 0.5 * float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(matrix), SMALLEST))))


def _width(item: Parameter, value: float) -> float:
    """
    Return the standard deviation of what a shape parameter can be.

    Uniform over its range, uniform in its logarithm where that spans decades.
    """
    if item.low > 0.0 and item.high > 10.0 * item.low:
        return abs(value) * math.log(item.high / item.low) / math.sqrt(12.0)
    return (item.high - item.low) / math.sqrt(12.0)


def spread_of(problem: Problem, hypothesis: Hypothesis, place: int) -> Array:
    """Return the covariance (k, k) that the logs give the parameters of one cause of a fit."""
    counts = [len(parameters_of(problem, cause)) for cause in hypothesis.causes]
    first = sum(counts[:place])
    own = slice(first, first + counts[place])
    if hypothesis.covariance.shape[0] != sum(counts):
        return np.zeros((counts[place], counts[place]))
    prior = precision(problem, hypothesis.causes[place])
    return without_prior(np.asarray(hypothesis.covariance[own, own]), prior)


def log_evidence(
    problem: Problem,
    more: Hypothesis,
    fewer: Hypothesis,
    scales: Sequence[float],
    gained: float | None = None,
) -> float:
    """
    Return ln BF of the last cause of `more` against `fewer`, which is without it.

    `gained` is equation (1), if somebody has a better one.
    """
    cause = more.causes[-1]
    own = parameters_of(problem, cause)
    occam = log_occam(cause, own, spread_of(problem, more, len(more.causes) - 1), scales)
    others = log_prior(problem, more.causes[:-1]) - log_prior(problem, fewer.causes)
    return (gain(more, fewer) if gained is None else gained) + others + occam
