# SPDX-License-Identifier: Apache-2.0
"""
Effects with a threshold: limits that change nothing until something reaches them.

Near its neutral value such an effect has no signature, and from a value that cuts off too much a
Newton step leads back to where it does nothing. So it is tried on rungs between neutral (0) and
well beyond typical (1), in a geometric scale,

    value(u) = neutral (typical / neutral)^u,

and the whole of what it changes there is fitted with a factor. A limit that cuts off too much has a
factor below one, one that cuts off too little (or nothing) has one above: so from the rung that
promises most, the value with a factor of one is found by halving, and there a fit begins. The
likelihood itself is of no help: a limit a little too low is worse than none, and its maximum is too
narrow to be found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of, whole_change
from waferbot_twin.estimation.stacked_least_squares import fit_jointly
from waferbot_twin.residuals.problem import Cause, Problem

STEP, RUNGS = 0.125, 22
"""How far rungs are apart, and how many there are at most: less where a bound is reached before."""

HALVINGS = 14
"""To 1/5000 of the way from neutral to typical at least; a fit does the rest."""


def rungs(problem: Problem, cause: Cause) -> Iterator[Cause]:
    """Give an effect with a threshold at every rung, up to the first that a bound cuts short."""
    given = cause
    for number in range(RUNGS):
        before, given = given, _at(problem, cause, STEP * (number + 1))
        if given.values == before.values:
            return
        yield given


def between_rungs(problem: Problem, base: Hypothesis, cause: Cause) -> Cause:
    """Return the cause, given at a rung, where it changes as much as the logs show beside `base`."""
    weak, strong = 0.0, _share(problem, cause) + STEP
    for _ in range(HALVINGS):
        share = 0.5 * (weak + strong)
        if _factor(problem, base, _at(problem, cause, share)) > 1.0:
            weak = share
        else:
            strong = share
    return _at(problem, cause, strong)


def _at(problem: Problem, cause: Cause, share: float) -> Cause:
    values = {
        item.name: float(
            np.clip(item.neutral * (item.typical / item.neutral) ** share, item.low, item.high)
        )
        for item in parameters_of(problem, cause)
        if not item.shape
    }
    return cause.with_values(values)


def _share(problem: Problem, cause: Cause) -> float:
    """Return how far from neutral to typical a cause is."""
    return max(
        math.log(cause.values[item.name] / item.neutral) / math.log(item.typical / item.neutral)
        for item in parameters_of(problem, cause)
        if not item.shape
    )


def _factor(problem: Problem, base: Hypothesis, cause: Cause) -> float:
    """Return by what factor to change the logs as a cause does; infinite where it changes nothing."""
    try:
        change = whole_change(problem, base, (*base.causes, cause))
    except UserError:
        return 0.0
    shown = {block: matrix for block, matrix in change.items() if matrix.any()}
    return float(fit_jointly(problem, base.residuals, shown).value[0]) if shown else math.inf
