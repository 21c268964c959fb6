# SPDX-License-Identifier: Apache-2.0
"""
95 % intervals of the parameters of a cause.

Where the logs tell a parameter, noise moves its estimate by 1.96 standard errors; in a block that
calculates in whole numbers it can go on beyond that until another bit differs. Where they tell nothing
of it (how long a drive takes to fold back, where it never had to), its standard error is longer than
all that it can be, the others known, too; it can go as far, these as they are, as the logs become by no
more than

    2 (ln L_best - ln L) = 3.84

less likely, the 95 % point of chi-squared with one degree of freedom (likelihood ratio; S. S. Wilks,
Annals of Mathematical Statistics 9, 1938). So can a limit that acts from one tick to the next: up to
the next tick no log knows of it, whatever a difference quotient says.

These are the values in one model. Where the logs leave open which of several models M it is, a value is
known as well as all of them tell, with the density

    p(x) = sum over M of P(M) p(x | M),                                                          (1)

each a normal one (Bayesian model averaging: J. Hoeting, D. Madigan, A. Raftery, C. Volinsky, Statistical
Science 14, 1999). An interval reaches to where 2.5 % of (1) are left on either side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import bisect
from scipy.special import softmax
from scipy.stats import chi2, norm

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.conditional import by_name, conditional_errors
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    log_likelihood_ratio,
    parameters_of,
    standard_errors,
)
from waferbot_twin.estimation.quantised_fit import same_bits
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array

NORMAL_95 = float(norm.ppf(0.975))
"""Standard errors to either side of a normally distributed estimate that hold 95 % of all."""

AS_LIKELY = float(chi2(1).ppf(0.95))
"""Difference in 2 ln L up to which a value is in the interval of one parameter."""

FINEST, COARSER = 0.01, 1.5
"""First step of a parameter of which the logs may tell nothing, as a share of its value; its growth."""

HALVINGS = 6
"""How often the last step is halved to find the end: to a hundredth of how far that is."""

Intervals = dict[str, tuple[float, float]]
"""By name of a parameter, the ends of its interval."""


@dataclass(frozen=True)
class Rival:
    """Another model of the same logs, and ln of its posterior odds against the one that was found."""

    found: Hypothesis
    log_odds: float


def errors_by_name(problem: Problem, hypothesis: Hypothesis) -> dict[tuple[str, str], float]:
    """Return the standard error of every parameter that was fitted, by its cause's name and its own."""
    return by_name(problem, hypothesis, standard_errors(hypothesis)) or {}


def averaged(
    value: float, error: float, others: Sequence[tuple[float, float, float]]
) -> tuple[float, float]:
    """
    Return the ends of the 95 % interval of a value by equation (1).

    `error` is its standard error in the model that was found; `others` are value, standard error and ln
    of the odds of each other model against that one. One in which nobody knows the error has no say.
    """
    others = [one for one in others if math.isfinite(one[1])]
    if not others:
        return value - NORMAL_95 * error, value + NORMAL_95 * error
    values, errors, log_odds = np.array([(value, error, 0.0), *others]).T
    shares = softmax(log_odds)
    far = 2.0 * NORMAL_95 * errors
    first, last = float(np.min(values - far)), float(np.max(values + far))
    if first == last:
        return value, value
    margin = 1e-9 * (last - first)

    def end(side: float) -> float:
        """Return where 2.5 % are left beyond, below (-1) or above (1)."""

        def left(x: float) -> float:
            beyond = side * (values - x)
            sure = np.where(beyond >= 0.0, np.inf, -np.inf)
            steps = np.divide(beyond, errors, out=sure, where=errors > 0.0)
            return float(shares @ norm.cdf(steps) - norm.sf(NORMAL_95))

        return float(bisect(left, first - margin, last + margin, xtol=margin))

    return end(-1.0), end(1.0)


def on_a_bound(problem: Problem, hypothesis: Hypothesis, place: int) -> bool:
    """
    Return whether a fit has brought its cause at a place to a bound: then it stands in for another one.

    It is as large as it can be, in all sizes that the logs tell from none by their 95 % intervals; or a
    shape has left its range, and the effect is its limit there: friction that rises with speed, over
    next to none, is Coulomb friction by another name.
    """
    place %= len(hypothesis.causes)
    cause = hypothesis.causes[place]
    parameters = parameters_of(problem, cause)
    first = sum(len(parameters_of(problem, one)) for one in hypothesis.causes[:place])
    errors = standard_errors(hypothesis)[first : first + len(parameters)]
    if len(errors) != len(parameters):  # it was not fitted
        errors = np.zeros(len(parameters))

    def bound(item: Parameter) -> bool:
        value = cause.values[item.name]
        return value in (item.low, item.high) and value != item.neutral

    own = [
        (item, error) for item, error in zip(parameters, errors, strict=True) if item.spread == 0.0
    ]
    told = [
        item
        for item, error in own
        if not item.shape and abs(cause.values[item.name] - item.neutral) > NORMAL_95 * error
    ]
    left = any(item.shape and bound(item) for item, _ in own)
    return left or (bool(told) and all(bound(item) for item in told))


def intervals_95(
    problem: Problem, found: Hypothesis, place: int, errors: Array, rivals: Sequence[Rival] = ()
) -> Intervals:
    """
    Return the intervals of the parameters of `found.causes[place]`.

    `errors` are their standard errors, `rivals` other models: those with this cause tell of its values.
    One that was held at one of a few has no interval.
    """
    cause = found.causes[place]
    elsewhere = [
        (one.log_odds, other.values, errors_by_name(problem, one.found))
        for one in rivals
        for other in one.found.causes
        if other.name == cause.name
    ]
    same = same_bits(problem, found, place)
    intervals: Intervals = {}
    first = sum(len(parameters_of(problem, one)) for one in found.causes[:place])
    alone = conditional_errors(found)
    alone = errors if alone is None else alone[first : first + len(same)]
    # A cause whose covariance nobody knows has fewer errors than parameters: no intervals.
    of_each = zip(parameters_of(problem, cause), errors, alone, same, strict=False)
    for item, error, least, more in of_each:
        value, reach = cause.values[item.name], float(NORMAL_95 * error + more)
        if least > item.high - item.low:
            reach = 0.0
        low, high = value - reach, value + reach
        if reach == 0.0 or problem.is_exact_limit(cause):
            low = min(low, _as_likely(problem, found, place, item, item.low))
            high = max(high, _as_likely(problem, found, place, item, item.high))
        others = [
            (values[item.name], theirs.get((cause.name, item.name), error), log_odds)
            for log_odds, values, theirs in elsewhere
            if item.name in values
        ]
        if others and math.isfinite(error):
            ends = averaged(value, error, others)
            low, high = min(low, ends[0]), max(high, ends[1])
        intervals[item.name] = (low, high)
    return intervals


def _as_likely(
    problem: Problem, found: Hypothesis, place: int, item: Parameter, bound: float
) -> float:
    """Return how far a parameter can go towards a bound, alone, before the logs are less likely."""
    causes, cause = found.causes, found.causes[place]

    def likely(value: float) -> bool:
        moved = cause.with_values({item.name: value})
        try:
            there = evaluate(problem, (*causes[:place], moved, *causes[place + 1 :]))
        except UserError:
            return False
        return 2.0 * log_likelihood_ratio(found, there) <= AS_LIKELY

    reached = beyond = cause.values[item.name]
    step = math.copysign(FINEST * abs(reached or bound), bound - reached)
    while beyond != bound:
        beyond = bound if abs(bound - reached) <= abs(step) else reached + step
        if not likely(beyond):
            break
        reached, step = beyond, COARSER * step
    for _ in range(HALVINGS if beyond != reached else 0):
        middle = 0.5 * (reached + beyond)
        reached, beyond = (middle, beyond) if likely(middle) else (reached, middle)
    return reached
