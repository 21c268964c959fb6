# SPDX-License-Identifier: Apache-2.0
"""
How alike two causes look in the logs at hand.

A cause's signature is what it takes out of the residuals of all blocks, white and in units of the
noise. The correlation of two signatures is the cosine of the angle between them; with it close to 1, one
cause does in these logs what the other does, and no test can tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import prediction_errors
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array


def signature_correlation(
    problem: Problem, found: Hypothesis, cause: Cause, rival: Cause
) -> float:
    """
    Return the correlation, -1 to 1, of the signatures of a cause of `found` and of one in its place.

    Both as they are fitted, beside the other causes; 0 if one of them shows nothing. Raises `UserError`
    if the model cannot be simulated with them.
    """
    others = tuple(item for item in found.causes if item.name != cause.name)
    own, other = (_signature(problem, found, others, (*others, item)) for item in (cause, rival))
    sizes = math.sqrt(float(own @ own) * float(other @ other))
    return float(own @ other) / sizes if sizes > 0.0 else 0.0


def _signature(
    problem: Problem, found: Hypothesis, fewer: Sequence[Cause], more: Sequence[Cause]
) -> Array:
    """Return what the causes in `more` beyond those in `fewer` change, white."""
    parts: list[Array] = []
    for block, fit in found.fits.items():
        before, after = (
            problem.residuals(apply_all(problem.nominal, causes), block)
            for causes in (fewer, more)
        )
        change = [one - two for one, two in zip(before, after, strict=True)]
        parts += prediction_errors(fit, change)
    return np.concatenate(parts)
