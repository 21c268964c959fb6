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
the next tick no log knows of it, whatever a difference quotient says. And so can the whole cause, if a
fit from another trial explains the logs as well: an interval reaches to the values there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2, norm

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.conditional import conditional_errors
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    log_likelihood_ratio,
    parameters_of,
    standard_errors,
)
from waferbot_twin.estimation.quantised_fit import same_bits
from waferbot_twin.residuals.problem import Cause, Problem
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
    problem: Problem, found: Hypothesis, place: int, errors: Array, trials: Sequence[Cause]
) -> Intervals:
    """
    Return the intervals of the parameters of `found.causes[place]`.

    `errors` are their standard errors, `trials` the same cause with other values that explain the logs
    as well. One that was held at one of a few has no interval unless these differ in it.
    """
    cause = found.causes[place]
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
        intervals[item.name] = (low, high)
    for other in trials:
        for name, value in other.values.items():
            low, high = intervals.get(name, (cause.values[name], cause.values[name]))
            if name in intervals or value != cause.values[name]:
                intervals[name] = (min(low, value), max(high, value))
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
