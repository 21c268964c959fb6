# SPDX-License-Identifier: Apache-2.0
"""
Models that other choices lead to, weighed against the one that was found.

The posterior of one effect knows the others as they are. Where an early choice was wrong, others were
chosen beside it and make up for it: then none of them gives way alone, and each is certain beside the
others. So the nearest rival of an effect is put in its place, the search goes on from there, and whole
models are compared: with A the one that was found and B the other,

    P(B) / P(A) = L_B pi_B / (L_A pi_A).                                                            (1)

If B is ahead, it is the one that was found, and A the other. The other one is what else the logs may
mean: a cause that only A has is at most as probable as A beside B (D. Madigan, A. Raftery, Journal of
the American Statistical Association 89, 1994: models in Occam's window).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.discrepancy import is_physical
from waferbot_twin.diagnosis.inference.elimination import evident
from waferbot_twin.diagnosis.inference.forward_selection import ask_on
from waferbot_twin.diagnosis.inference.nuisance import is_nuisance
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at, log_odds_between
from waferbot_twin.diagnosis.inference.revision import ask_again
from waferbot_twin.diagnosis.inference.single_effects import Member, SingleEffect, with_odds
from waferbot_twin.estimation.hypothesis import Hypothesis


def beside_rival_models(
    pool: CandidatePool, found: Hypothesis, effects: list[SingleEffect], most: int
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Return the most probable of the models that rivals lead to, its effects as sure as the others let.

    The nearest rivals first, as long as `most` allows to ask; return how often was asked, too.
    """
    left, seen = most, set[frozenset[str]]()
    while True:
        ahead: tuple[Hypothesis, list[SingleEffect]] | None = None
        for name, rival in _nearest_rivals(found, effects):
            names = frozenset(cause.name for cause in rival.found.causes)
            if left <= 0 or names in seen or not _may_catch_up(pool, found, rival):
                continue
            seen.add(names)
            others = [effect for effect in effects if effect.best.cause.name != name]
            effect = next(effect for effect in effects if effect.best.cause.name == name)
            there, own, tentative, _, asked = ask_on(
                pool, rival.found, [*others, _led_by(effect, rival)], left, usual=True
            )
            there, its_effects = evident(pool, there, own, tentative)
            left -= asked
            pool.rivals += [there, found]
            log_odds = log_odds_between(pool, there, found)
            if log_odds > 0.0:
                ahead = there, _beside(its_effects, there, found, -log_odds)
                seen.add(frozenset(cause.name for cause in found.causes))
                break
            pool.note_noise_of(found)
            effects = _beside(effects, found, there, log_odds)
        if ahead is None:
            return found, effects, most - left
        found, effects, asked = ask_again(pool, *ahead, left)
        left -= asked


def _nearest_rivals(
    found: Hypothesis, effects: Sequence[SingleEffect]
) -> list[tuple[str, Member]]:
    """
    Return the most probable rival of each effect that was fitted beside all others, the nearest first.

    Those with a physical name that the model does not have, each with the name of the effect.
    """
    there = {cause.name for cause in found.causes}
    nearest = []
    for effect in effects:
        name = effect.best.cause.name
        for member in effect.members[1:]:
            others = {cause.name for cause in member.found.causes[:-1]}
            rival = member.cause
            if others != there - {name} or rival.name in there:
                continue
            if is_physical(rival):
                nearest.append((member.probability / effect.best.probability, name, member))
                break
    return [(name, member) for _, name, member in sorted(nearest, key=lambda item: -item[0])]


def _led_by(effect: SingleEffect, rival: Member) -> SingleEffect:
    """Return an effect with a rival in the place of the best; how probable the others are is open."""
    others = (replace(one, probability=0.0) for one in effect.members if one is not rival)
    return with_odds(SingleEffect((replace(rival, probability=1.0), *others), 0.0), rival.log_odds)


def _may_catch_up(pool: CandidatePool, found: Hypothesis, rival: Member) -> bool:
    """
    Return whether the model of a rival may come near with all that the linear problem promises it.

    By what candidates changed at first: they need not be found anew to see that a rival has no hope.
    """
    promised: dict[str, float] = {}
    for item in pool.screen_as_at_first(rival.found):
        more = item.likelihood + pool.log_prior(item.cause)
        promised[item.cause.name] = max(more, promised.get(item.cause.name, 0.0))
    behind = log_odds_between(pool, rival.found, found)
    return behind + sum(promised.values()) > -log_odds_at(pool.settings.credible_level)


def _beside(
    effects: Sequence[SingleEffect], found: Hypothesis, there: Hypothesis, log_odds: float
) -> list[SingleEffect]:
    """
    Return effects as sure as another model leaves them; `log_odds` are its odds against this one.

    What only this model has is as probable as this model. Where the other one has something else that
    may be in the place of an effect, that is a member of the effect, so probable; where not, there may
    be no such effect at all.
    """
    here, its = ({cause.name for cause in one.causes} for one in (found, there))
    result = []
    for effect in effects:
        rivals = [one for one in effect.members[1:] if one.cause.name in its - here]
        if effect.best.cause.name in its or is_nuisance(effect.best.cause):
            result.append(effect)
        elif rivals:
            result.append(_with_member(effect, rivals[0], math.exp(log_odds)))
        else:
            result.append(with_odds(effect, min(effect.log_odds, -log_odds)))
    return result


def _with_member(effect: SingleEffect, rival: Member, ratio: float) -> SingleEffect:
    """Return an effect whose rival is at least that `ratio` as probable as the best member."""
    least = ratio * effect.best.probability
    members = [
        replace(one, probability=max(one.probability, least))
        if one.cause.name == rival.cause.name
        else one
        for one in effect.members
    ]
    ranked = sorted(members[1:], key=lambda one: -one.probability)
    log_odds = effect.log_odds
    return with_odds(SingleEffect((members[0], *ranked), effect.none), log_odds)
