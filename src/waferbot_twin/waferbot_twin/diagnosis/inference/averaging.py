# SPDX-License-Identifier: Apache-2.0
"""
Models that were fitted on the way to one, weighed against it.

An effect that is evident beside all others may be one of several that only together are a little better
than none of them, or than another one: each needs the others. A search that adds and takes away one at a
time does not see that, but it has been there before. So the odds of an effect are against all models
M_n that were fitted without it, too (Bayesian model averaging: J. A. Hoeting, D. Madigan, A. E. Raftery,
C. T. Volinsky, Statistical Science 14, 1999),

    P(effect) = sum over n with it of w_n / (sum over all n of w_n + w_0),                         (1)

w_n the odds of M_n against the model that was found last, and w_0 those of this one without the effect.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.elimination import evident, log_odds_at
from waferbot_twin.diagnosis.inference.refit import to_the_end, with_last
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds
from waferbot_twin.estimation.evidence import gain, information_of, log_occam
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of
from waferbot_twin.estimation.size_prior import log_prior
from waferbot_twin.residuals.problem import Cause


def log_odds_between(pool: CandidatePool, one: Hypothesis, other: Hypothesis) -> float:
    """Return ln of the posterior odds of one hypothesis against another, whatever causes each has."""
    problem, scales = pool.problem, pool.settings.prior_scales
    both = {cause.name for cause in one.causes} & {cause.name for cause in other.causes}

    def own(hypothesis: Hypothesis) -> float:
        total = log_prior(problem, [item for item in hypothesis.causes if item.name in both])
        for place, cause in enumerate(hypothesis.causes):
            if cause.name not in both:
                known = information_of(problem, hypothesis, place)
                total += log_occam(cause, parameters_of(problem, cause), known, scales)
                total += pool.log_prior(cause)
        return total

    return gain(one, other) + own(one) - own(other)


def as_fitted(pool: CandidatePool, found: Hypothesis, cause: Cause) -> SingleEffect:
    """Return a cause of a hypothesis as an effect that was not asked for."""
    last = with_last(pool.problem, found, cause.name)
    return SingleEffect((Member(last, 0.0, pool.log_prior(cause), 1.0),), 0.0)


def averaged(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    visited: Sequence[Hypothesis],
) -> tuple[Hypothesis, list[SingleEffect]]:
    """
    Return the most probable of a model and those on the way to it, and its effects by equation (1).

    Where that is another one than the last, it is fitted to the end, and what is not evident in it goes.
    """
    weights = [log_odds_between(pool, one, found) for one in visited]
    models = [*zip(visited, weights, strict=True), (found, 0.0)]
    best = max(weights, default=0.0)
    if best > 0.0:
        ahead = to_the_end(pool.problem, visited[weights.index(best)], pool.workers)
        asked = {effect.best.cause.name: effect for effect in effects}
        names = [cause.name for cause in ahead.causes]
        tentative = [as_fitted(pool, ahead, one) for one in ahead.causes if one.name not in asked]
        found, effects = evident(
            pool, ahead, [asked[name] for name in names if name in asked], tentative
        )
    return found, [_beside(models, effect) for effect in effects]


def _beside(models: Sequence[tuple[Hypothesis, float]], effect: SingleEffect) -> SingleEffect:
    """Return an effect by equation (1), of models with ln of their odds; its own are against w_0."""
    name = effect.best.cause.name
    with_it, without_it = (
        [
            weight
            for model, weight in models
            if (name in {cause.name for cause in model.causes}) == there
        ]
        for there in (True, False)
    )
    first = float(np.logaddexp.reduce(with_it)) if with_it else 0.0
    alone = first - log_odds_at(effect.inclusion)
    return with_odds(effect, first - float(np.logaddexp.reduce([alone, *without_it])))
