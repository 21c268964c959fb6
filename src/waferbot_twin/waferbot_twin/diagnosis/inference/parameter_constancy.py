# SPDX-License-Identifier: Apache-2.0
"""
Parameter constancy: a cause that is real has one size, in all parts of all logs.

What a model lacks is seldom the same twice: the next homing turns an eccentricity, the next day warms a
bearing, another motion shows other parts of a curve. A cause that stands for such a thing explains some
parts of the logs and makes others worse. So when the causes are known, each is judged once more, by a
gain that is worth no more than beside what its parts disagree by (`noise_model.heterogeneity`). One that
is not more probable than none by that is as likely as not: it stays in the model and has no name.
"""

from __future__ import annotations

from dataclasses import replace

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy
from waferbot_twin.diagnosis.inference.elimination import log_odds_at, odds_beside
from waferbot_twin.diagnosis.inference.nuisance import is_nuisance
from waferbot_twin.diagnosis.inference.refit import with_last
from waferbot_twin.diagnosis.inference.single_effects import Posterior, SingleEffect, with_odds
from waferbot_twin.estimation.conditional import without_by_linear
from waferbot_twin.estimation.evidence import gain
from waferbot_twin.estimation.hypothesis import Hypothesis


def as_sure_as_constant(pool: CandidatePool, posterior: Posterior) -> Posterior:
    """Return a posterior whose causes are no more probable than beside how their sizes vary."""
    effects: list[SingleEffect] = []
    for cause, effect in zip(posterior.found.causes, posterior.effects, strict=True):
        pool.progress('parameter constancy', len(effects), len(posterior.effects))
        without_name = is_nuisance(effect.best.cause) or is_discrepancy(effect.best.cause)
        effects.append(
            effect if without_name else _judged(pool, posterior.found, cause.name, effect)
        )
    return replace(posterior, effects=tuple(effects))


def _judged(
    pool: CandidatePool, found: Hypothesis, name: str, effect: SingleEffect
) -> SingleEffect:
    """
    Return an effect with odds that have the heterogeneity of its size in them.

    Where there is none in the linear problem, it stays as it is; else the others are fitted without it.
    """
    problem = pool.problem
    more = with_last(problem, found, name)
    try:
        base = without_by_linear(problem, found, name)
        if gain(more, base, parts=True) == gain(more, base):
            return effect
        odds, _ = odds_beside(pool, found, name, parts=True)
    except UserError:  # the machine does not stand without it
        return effect
    limits = log_odds_at(pool.settings.included_from), log_odds_at(effect.inclusion)
    return with_odds(effect, min(max(odds, limits[0]), limits[1]))
