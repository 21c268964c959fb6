# SPDX-License-Identifier: Apache-2.0
"""Fit of all parameters of a set of causes, through the simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.hypothesis import Hypothesis, evaluate, parameters_of, signature
from waferbot_twin.diagnosis.jointly import fit_jointly, side_by_side
from waferbot_twin.diagnosis.problem import Cause, Problem
from waferbot_twin.diagnosis.record import Array
from waferbot_twin.effects.effect import Parameter

ROUNDS = 8
ENOUGH = 0.02
"""Gain in ln L below which another round is not worth its time."""

Names = Sequence[tuple[int, Parameter]]


def fit_causes(problem: Problem, causes: tuple[Cause, ...], rounds: int = ROUNDS) -> Hypothesis:
    """
    Return the causes with the values that make the logs most likely.

    Gauss-Newton in the whitened residuals; a step that does not make them more likely is shortened.
    Raises `UserError` if the simulation blows up where the fit begins.
    """
    now = evaluate(problem, causes)
    names = [
        (place, item)
        for place, cause in enumerate(causes)
        for item in parameters_of(problem, cause)
    ]
    for _ in range(rounds if names else 0):
        change, now.covariance = _newton_step(problem, now, names)
        better = _along(problem, now, names, change)
        if better is None:
            break
        better.covariance = now.covariance
        gain = better.log_likelihood - now.log_likelihood
        now = better
        if gain < ENOUGH:
            break
    return now


def _along(problem: Problem, now: Hypothesis, names: Names, change: Array) -> Hypothesis | None:
    """Return the first better hypothesis in the direction of `change`, None if there is none."""
    for share in (1.0, 0.4, 0.1):
        try:
            tried = evaluate(problem, moved(now.causes, names, share * change))
        except UserError:
            continue
        if tried.log_likelihood > now.log_likelihood:
            return tried
    return None


def _newton_step(problem: Problem, now: Hypothesis, names: Names) -> tuple[Array, Array]:
    """Return the linear estimate of the change of all parameters, and its covariance."""
    own = [signature(problem, now, now.causes, place) for place in range(len(now.causes))]
    counts = [len(parameters_of(problem, cause)) for cause in now.causes]
    estimate = fit_jointly(problem, now.residuals, side_by_side(own, counts))
    return estimate.value, estimate.covariance


def moved(causes: tuple[Cause, ...], names: Names, change: Array) -> tuple[Cause, ...]:
    """Return the causes with their parameters changed, within their bounds."""
    values = [dict(cause.values) for cause in causes]
    for (place, item), amount in zip(names, change, strict=True):
        wanted = values[place][item.name] + float(amount)
        values[place][item.name] = float(np.clip(wanted, item.low, item.high))
    return tuple(
        Cause(cause.effect, cause.axis, new) for cause, new in zip(causes, values, strict=True)
    )
