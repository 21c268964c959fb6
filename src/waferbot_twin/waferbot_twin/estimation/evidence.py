# SPDX-License-Identifier: Apache-2.0
"""
How much more the logs speak for one set of causes than for another.

**Gain.** Two hypotheses A and B leave the residuals r_A and r_B over and have the likelihood ratio
L_A / L_B (`hypothesis.log_likelihood_ratio`). With the difference d = r_B - r_A and the power lambda
of what A leaves over along d, both filtered by the noise model of A, known with nu degrees of freedom
(`noise_model.residual_spectrum.powers_along`), in every channel,

    G = sum over channels of (nu + 1) / 2 ln(1 + 2 ln(L_A / L_B) / (lambda nu))                     (1)

is the logarithm of their likelihood ratio, of the plant beside the misfit that A leaves over
(`noise_model.misfit`). Where the noise model is right, lambda is 1, nu large
and G the usual one; where A lacks something, or noise has another colour, the working likelihood
is corrected as composite likelihoods are (R. E. Chandler, S. Bate, Biometrika 94, 2007): the
weighting, and with it the estimate, stays that of the noise model.

**Evidence.** Of a cause with the values w, what the logs say of them L (their information, the inverse
of a covariance), and a normal scale mixture of priors N(0, S_m) with equal weights, S_m = tau_m^2 W (W
from the effect's typical size), the Bayes factor against none of it is

    ln BF = G + ln 1/M sum over m of |1 + S_m L|^-1/2 exp(-w' (L^-1 + S_m)^-1 w / 2)                (2)

(Laplace's approximation). What the logs do not say, a direction along which L is zero, costs nothing.
The priors of the other causes (`size_prior`) count in G, as far as their values differ. A shape
parameter, a phase or a frequency, has no size: its prior has the width of what is possible, so that
whoever tries many frequencies pays for it. Parameters with a usual spread s have their prior in
the fit already (`residuals.prior_block`), and with it in G and L; what is left of (2) is

    ln BF = G - 1/2 ln |L| - sum over n of them of ln s + c(n),                                   (3)

c that of `residuals.prior_block`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    log_likelihood_ratios,
    parameters_of,
    with_next_to_none,
)
from waferbot_twin.estimation.size_prior import (
    LARGEST,
    away_from_neutral,
    information_of_logs,
    log_prior,
    precision,
    scales_of,
)
from waferbot_twin.noise_model import heterogeneity, misfit
from waferbot_twin.noise_model.misfit import InLog
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.noise_model.residual_spectrum import log_likelihood_ratios_in, powers_along
from waferbot_twin.residuals.prior_block import log_normaliser
from waferbot_twin.residuals.problem import PRIOR, Cause, Problem
from waferbot_twin.residuals.record import Array


def gain(
    more: Hypothesis,
    fewer: Hypothesis,
    noise_known: bool = False,
    power_known: bool = False,
    parts: bool = False,
) -> float:
    """
    Return equation (1): how much likelier the logs are with `more` than with `fewer`.

    Antisymmetric, channel by channel: each is seen from the one that leaves less over there. Seen
    from the other one, what it lacks would be noise along the very direction in question. Both are
    hypotheses of the same problem. With `noise_known` the noise of both is that of `more`, as where
    both were simulated with the same; with `power_known` lambda is taken for the true one: nu is
    infinite. With `parts` it is no more than beside what parts of the logs disagree by
    (`noise_model.heterogeneity`).
    """
    seen = _seen_from(more, fewer, noise_known, power_known)
    if noise_known:
        return sum(one.ratio for one in seen)
    count = _apart(more, fewer) if parts else 0
    if all(one.ratio >= 0.0 for one in seen):
        return _beside_misfit([one.ratio for one in seen], seen, (), count)
    back = _seen_from(fewer, more, noise_known, power_known)
    ratios = [
        one.ratio if one.ratio >= 0.0 else -max(other.ratio, 0.0)
        for one, other in zip(seen, back, strict=True)
    ]
    return _beside_misfit(ratios, seen, back, count)


def _apart(one: Hypothesis, other: Hypothesis) -> int:
    """Return how many parameters one of two hypotheses has more than the other, 1 at least."""
    free = [sum(cause.free for cause in causes) for causes in (one.causes, other.causes)]
    return max(abs(free[0] - free[1]), 1)


@dataclass(frozen=True)
class _Channel:
    """
    What a channel says of a change: equation (1) of it alone, and by how much its squares are less.

    With what is `left` over and the `change`, white, where it shows an axis that moves, and `of_state`
    as in `noise_model.leverage.Leverage`.
    """

    ratio: float
    squares: float = 0.0
    left: Array = field(default_factory=lambda: np.zeros(0))
    change: Array = field(default_factory=lambda: np.zeros(0))
    state: InLog | None = None
    of_state: Array = field(default_factory=lambda: np.zeros((0, 0)))


def _seen_from(
    this: Hypothesis, other: Hypothesis, noise_known: bool, power_known: bool
) -> list[_Channel]:
    """Return equation (1) with the noise that `this` leaves, channel by channel of every block."""
    found: list[_Channel] = []
    for block, fit in this.fits.items():
        if block == PRIOR:
            found.append(_Channel(fit.log_likelihood - other.fits[block].log_likelihood))
            continue
        if fit is other.fits[block]:
            found += [_Channel(0.0)] * len(fit.colours)
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
        powers = powers_along(left, changes, fit.colours, fit.leverages)
        if power_known:
            powers = [power.as_if_known for power in powers]
        ratios = log_likelihood_ratios_in(powers, squares)
        states = [noise.state for noise in fit.noises]
        taken = [one.of_state if one else np.zeros((0, 0)) for one in fit.leverages]
        found += [
            _Channel(*one)
            for one in zip(ratios, squares, left, changes, states, taken, strict=True)
        ]
    return found


def _beside_misfit(
    ratios: Sequence[float], seen: Sequence[_Channel], back: Sequence[_Channel], count: int
) -> float:
    """
    Return what is gained in all channels, on every axis no more than beside its misfit.

    `ratios` are equation (1), which takes what is left over along d for noise, log by log. Misfit is the
    same in all logs; so what is gained on an axis is the less of what either says. It is that of the
    model that is ahead there: `seen` from the one, `back` from the other. With a `count` of parameters
    that one has more, no more than beside what parts of the logs disagree by, either.
    """
    states = [channel.state for channel in seen]
    total = sum(ratio for ratio, state in zip(ratios, states, strict=True) if state is None)
    for places, logs in misfit.of_axes(states):
        gained = sum(ratios[place] for place in places)
        ahead = seen if gained >= 0.0 or not back else back
        squares = abs(sum(ahead[place].squares for place in places))
        left = [ahead[place].left for place in places]
        changes = [ahead[place].change for place in places]
        taken = misfit.taken_by([ahead[place].of_state for place in places])
        most = [misfit.power_along(left, changes, logs, taken).log_likelihood_ratio(squares)]
        if count:
            power = heterogeneity.power_along(left, changes, logs)
            most.append(power.log_likelihood_ratio(squares, count))
        total += math.copysign(min(abs(gained), *most), gained)
    return total


def log_occam(
    cause: Cause, parameters: Sequence[Parameter], information: Array, scales: Sequence[float]
) -> float:
    """
    Return what equation (2) adds to the gain of a cause of which logs say `information` (k, k).

    It is zero or negative, the more so the better the logs know the values, and for a size that is not
    usual.
    """
    if not parameters:
        return 0.0
    if all(item.spread > 0.0 for item in parameters):
        spreads = np.array([item.spread for item in parameters])
        known = np.linalg.eigvalsh(information * np.outer(spreads, spreads))
        return -0.5 * float(np.sum(np.log(np.clip(known, 1.0 / LARGEST, LARGEST)))) + (
            log_normaliser(len(spreads))
        )
    away = away_from_neutral(cause, parameters)
    widths = np.array([_width(item, cause.values[item.name]) for item in parameters])
    sizes = np.array(
        [0.0 if item.shape else abs(item.typical - item.neutral) for item in parameters]
    )
    shapes = np.array([item.shape for item in parameters], np.bool_)
    terms = []
    for scale in scales:
        unit = np.where(shapes, widths, scale * sizes)
        known, directions = np.linalg.eigh(information * np.outer(unit, unit))
        known = np.clip(known, 0.0, LARGEST)
        size = directions.T @ (away / unit)
        terms.append(-0.5 * float(np.sum(known * size**2 / (1.0 + known) + np.log1p(known))))
    return float(logsumexp(terms) - math.log(len(terms)))


def _width(item: Parameter, value: float) -> float:
    """
    Return the standard deviation of what a shape parameter can be.

    Uniform over its range, uniform in its logarithm where that spans decades.
    """
    if item.low > 0.0 and item.high > 10.0 * item.low:
        return abs(value) * math.log(item.high / item.low) / math.sqrt(12.0)
    return (item.high - item.low) / math.sqrt(12.0)


def information_of(problem: Problem, hypothesis: Hypothesis, place: int) -> Array:
    """Return what the logs say (k, k) of the parameters of one cause of a fit, the others unknown."""
    counts = [len(parameters_of(problem, cause)) for cause in hypothesis.causes]
    first = sum(counts[:place])
    own = slice(first, first + counts[place])
    if hypothesis.covariance.shape[0] != sum(counts):
        raise ValueError('the hypothesis was not fitted')
    prior = precision(problem, hypothesis.causes[place])
    return information_of_logs(np.asarray(hypothesis.covariance[own, own]), prior)


def log_evidence(
    problem: Problem,
    more: Hypothesis,
    fewer: Hypothesis,
    scales: Sequence[float],
    gained: float | None = None,
) -> float:
    """Return ln BF of the last cause of `more` against `fewer`, which is without it (`evidence_of`)."""
    return evidence_of(problem, more, fewer, scales, gained)[0]


def evidence_of(
    problem: Problem,
    more: Hypothesis,
    fewer: Hypothesis,
    scales: Sequence[float],
    gained: float | None = None,
) -> tuple[float, float]:
    """
    Return ln BF of the last cause of `more` against `fewer`, which is without it, and the gain in it.

    And against next to none of it: a machine with that is one without, in other springs
    (`hypothesis.with_next_to_none`). `gained` is equation (1), if somebody has a better one.
    """
    cause = more.causes[-1]
    own = parameters_of(problem, cause)
    known = information_of(problem, more, len(more.causes) - 1)
    occam = log_occam(cause, own, known, scales_of(problem, cause, scales))
    gained = gain(more, fewer) if gained is None else gained
    next_to_none = with_next_to_none(problem, more)
    if next_to_none is not None:
        gained = min(gained, gain(more, next_to_none))
    others = log_prior(problem, more.causes[:-1]) - log_prior(problem, fewer.causes)
    return gained + others + occam, gained
