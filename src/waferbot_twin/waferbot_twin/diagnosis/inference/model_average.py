# SPDX-License-Identifier: Apache-2.0
"""
Models that the logs leave open: what a value may be is what all of them say of it.

The one that was found is the most probable one, and not the only one. Beside it are those with another
member of a credible set, those with one cause more that was not more probable than not, and whole models
that other choices led to (`rival_models`). Those that are less probable than one in twenty of it
(1 - `credible_level`) say nothing (Occam's window: D. Madigan, A. Raftery, Journal of the American
Statistical Association 89, 1994). Intervals are averages over the others
(`estimation.intervals`, equation (1)).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at, log_odds_between
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.intervals import Rival
from waferbot_twin.estimation.usual_spread import with_usual_spread


def open_models(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> tuple[Hypothesis, ...]:
    """Return the models that were fitted beside the one that was found."""
    there = _names(found)
    level = pool.settings.credible_level
    instead = [
        member.found
        for effect in effects
        for member in effect.credible_set(level)[1:]
        if _names(member.found) - {member.cause.name} == there - {effect.best.cause.name}
    ]
    return (*instead, *(one.found for one in _one_more(pool, there)), *pool.rivals)


def _one_more(pool: CandidatePool, there: frozenset[str]) -> tuple[Member, ...]:
    """Return what may be there beside causes; what went again after it had been asked may be left in."""
    answers = [
        effect
        for asked, effect in pool.asked_beside.items()
        if effect is not None and asked >= there
    ]
    return answers[-1].members if answers else ()


def rivals_of(
    pool: CandidatePool,
    found: Hypothesis,
    models: Iterable[Hypothesis],
    refuted: Collection[str] = (),
) -> list[Rival]:
    """Return the models in Occam's window about the one that was found, without any refuted cause."""
    least = -log_odds_at(pool.settings.credible_level)
    rivals: dict[frozenset[str], Rival] = {}
    for model in models:
        names = _names(model)
        if names == _names(found) or not names.isdisjoint(refuted):
            continue
        log_odds = log_odds_between(pool, model, found)
        rival = Rival(with_usual_spread(pool.problem, model), log_odds)
        before = rivals.get(names)
        if rival.log_odds > least and (before is None or rival.log_odds > before.log_odds):
            rivals[names] = rival
    return list(rivals.values())


def _names(model: Hypothesis) -> frozenset[str]:
    return frozenset(cause.name for cause in model.causes)
