# SPDX-License-Identifier: Apache-2.0
"""
Causes in exact blocks, fitted without slopes.

When a drive folds back, its current is cut off from one tick to the next. A limit a little too low that
acts a little too late begins in the right tick and leaves little over: a narrow valley, at an angle to
both parameters, with a step at every tick. Newton's steps end on its flank, where a second cause then
takes what is left. And what changes single bits of a controller's output leaves hardly more over with
values some percent off than with the right ones: a bit is about the noise that a block is taken to have
at least. With the right values an exact block leaves nothing over, so where it does a simplex (Nelder
and Mead) goes on from where the fit ended, towards what is most likely or, in the controller, to where
the least is left over in all. There it begins anew with other corners wherever it ends, until nothing
is left or none of them leads on: the valleys are narrow, with steps. A last fit says how well the values
are known.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from waferbot_lockstep.errors import UserError
from waferbot_twin.estimation.gauss_newton import fit_causes, moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, log_likelihood_ratio
from waferbot_twin.estimation.quantised_fit import acts_on_bits_alone, left_of_bits
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

FIRST_STEP = 0.05
"""
Size of the first simplex, as a share of each parameter. With 0.02 for the level and 0.1 for the time two
of five starts ended where nothing folds back any more, with this none (X-Rotate's drive; level up to 4 %
and time up to 15 % off).
"""

CLOSE, ENOUGH = 1e-6, 0.1
"""
Share of the parameters, and 2 ln L (in a controller noise floors, `left_of_bits`), within which the
simplex has to be at its end.
"""

MOST = 300
"""How often at most the block is simulated by one simplex."""

STEPS = (0.05, -0.05, 0.2, -0.2, 0.01, -0.01)
"""
Sizes of the simplices in a controller, by turns. Of 18 starts near nine notches of some bits one simplex
came to where nothing is left over from 9, these from 15.
"""

WORTH_IT = 0.7
"""
Share of what an axis' controller does otherwise that a cause may leave at most for simplices to go on.

A notch of some bits left 0.34 where its fit ended; most wrong causes beside a false feedforward left
0.93 to 1.02.
"""


def downhill(problem: Problem, begun: Cause, found: Hypothesis) -> Hypothesis:
    """
    Return a fitted hypothesis, better if its last cause leaves some over that right values would not.

    `begun` is that cause where its fit began. The hypothesis is returned as it is if the cause acts on
    other blocks than exact ones, or leaves nothing over on its axis. Raises `UserError` if the
    simulation blows up.
    """
    cause = found.causes[-1]
    if acts_on_bits_alone(problem, cause) and not cause.effect.threshold:
        return _to_the_last_bit(problem, begun, found)
    if not problem.is_exact_limit(cause):
        return found
    blocks = problem.touched(cause.effect, cause.axis)
    plain = (problem.plain_axes(block, found.residuals[block]) for block in blocks)
    return _limit(problem, found, blocks) if any(cause.axis in axes for axes in plain) else found


def _limit(problem: Problem, found: Hypothesis, blocks: Sequence[str]) -> Hypothesis:
    """Return the last cause of a hypothesis, a limit, where its blocks are most likely."""

    def unlikely(tried: Cause) -> float:
        variant = apply_all(problem.nominal, (*found.causes[:-1], tried))
        fits = problem.judge({block: problem.residuals(variant, block) for block in blocks})
        return -2.0 * sum(fit.log_likelihood for fit in fits.values())

    cause = found.causes[-1]
    sizes = np.array([cause.values[item.name] for _, item in names_of(problem, (cause,))])
    best, _ = _simplex(problem, cause, sizes, unlikely, FIRST_STEP)
    return fit_causes(problem, (*found.causes[:-1], best))


def _to_the_last_bit(problem: Problem, begun: Cause, found: Hypothesis) -> Hypothesis:
    """
    Return the last cause of a hypothesis where it leaves least over in the controller.

    As it is where it leaves nearly all that there was: a wrong cause has no end that is worth the way.
    """
    others = found.causes[:-1]
    at_most = WORTH_IT * left_of_bits(problem, others, found.causes[-1].axis)

    def left(tried: Cause) -> float:
        return left_of_bits(problem, (*others, tried), tried.axis)

    for start in (found.causes[-1], begun):
        best, least = start, left(start)
        if least > at_most:
            continue
        sizes = np.array(
            [
                start.values[item.name] - (0.0 if item.shape else item.neutral)
                for _, item in names_of(problem, (start,))
            ]
        )
        failed = 0
        for step in itertools.cycle(STEPS):
            if least == 0.0 or failed == len(STEPS):
                break
            tried, leaves = _simplex(problem, best, sizes, left, step)
            failed = 0 if leaves < least else failed + 1
            if leaves < least:
                best, least = tried, leaves
        better = fit_causes(problem, (*others, best))
        if log_likelihood_ratio(better, found) > 0.0:
            found = better
        if least == 0.0:
            break
    return found


def _simplex(
    problem: Problem, cause: Cause, sizes: Array, cost: Callable[[Cause], float], step: float
) -> tuple[Cause, float]:
    """Return a cause where a simplex with corners a `step` of the `sizes` away ends, and its cost."""
    names = names_of(problem, (cause,))

    def at(shares: Array) -> Cause:
        (tried,) = moved((cause,), names, sizes * shares)
        return tried

    def cost_at(shares: Array) -> float:
        try:
            return cost(at(shares))
        except UserError:
            return math.inf

    def done(intermediate_result: OptimizeResult) -> None:
        if intermediate_result.fun == 0.0:
            raise StopIteration

    corners = step * np.eye(len(names) + 1, len(names), k=-1)
    end = minimize(
        cost_at,
        corners[0],
        method='Nelder-Mead',
        callback=done,
        options={'initial_simplex': corners, 'xatol': CLOSE, 'fatol': ENOUGH, 'maxfev': MOST},
    )
    return at(end.x), float(end.fun)
