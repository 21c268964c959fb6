# SPDX-License-Identifier: Apache-2.0
"""
Limits in exact blocks, fitted without slopes.

When a drive folds back, its current is cut off from one tick to the next. A limit a little too low that
acts a little too late begins in the right tick and leaves little over: a narrow valley, at an angle to
both parameters, with a step at every tick. Newton's steps end on its flank, where a second cause then
takes what is left. With the right values an exact block leaves nothing over, so where it does a simplex
(Nelder and Mead) goes on from where the fit ended, and a last fit from there says how well the values
are known.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.fitting import fit_causes, moved, names_of
from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.problem import Problem, apply_all
from waferbot_twin.diagnosis.record import Array

FIRST_STEP = 0.05
"""
Size of the first simplex, as a share of each parameter. With 0.02 for the level and 0.1 for the time two
of five starts ended where nothing folds back any more, with this none (X-Rotate's drive; level up to 4 %
and time up to 15 % off).
"""

CLOSE, ENOUGH = 1e-6, 0.1
"""Share of the parameters, and 2 ln L, within which the simplex has to be at its end."""

MOST = 300
"""How often at most the block is simulated."""


def downhill(problem: Problem, found: Hypothesis) -> Hypothesis:
    """
    Return a fitted hypothesis, better if its last cause is a limit that leaves some over.

    It is returned as it is if that cause has no threshold, acts on other blocks than exact ones, or
    leaves nothing over on its axis. Raises `UserError` if the simulation blows up.
    """
    cause = found.causes[-1]
    blocks = problem.touched(cause.effect, cause.axis)
    if not cause.effect.threshold or not set(blocks) <= set(problem.exact_blocks):
        return found
    if not any(
        cause.axis in problem.plain_axes(block, found.residuals[block]) for block in blocks
    ):
        return found
    names = names_of(problem, (cause,))
    sizes = np.array([cause.values[item.name] for _, item in names])

    def unlikely(shares: Array) -> float:
        (tried,) = moved((cause,), names, sizes * (shares - 1.0))
        try:
            variant = apply_all(problem.nominal, (*found.causes[:-1], tried))
            fits = problem.judge({block: problem.residuals(variant, block) for block in blocks})
        except UserError:
            return np.inf
        return -2.0 * sum(fit.log_likelihood for fit in fits.values())

    corners = 1.0 + FIRST_STEP * np.eye(len(names) + 1, len(names), k=-1)
    end = minimize(
        unlikely,
        corners[0],
        method='Nelder-Mead',
        options={'initial_simplex': corners, 'xatol': CLOSE, 'fatol': ENOUGH, 'maxfev': MOST},
    )
    (best,) = moved((cause,), names, sizes * (end.x - 1.0))
    return fit_causes(problem, (*found.causes[:-1], best))
