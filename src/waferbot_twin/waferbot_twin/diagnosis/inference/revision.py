# SPDX-License-Identifier: Apache-2.0
"""Every effect asked for anew beside all others: early choices are revised when these are known."""

from __future__ import annotations

from dataclasses import replace

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy
from waferbot_twin.diagnosis.inference.elimination import evident
from waferbot_twin.diagnosis.inference.forward_selection import fitted_together, posterior_beside
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at
from waferbot_twin.diagnosis.inference.refit import with_last
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect, with_odds
from waferbot_twin.estimation.conditional import without_by_linear
from waferbot_twin.estimation.hypothesis import Hypothesis

PASSES = 2
"""How often at most every effect is asked for anew."""


def ask_again(
    pool: CandidatePool, found: Hypothesis, effects: list[SingleEffect], most: int
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Ask for every effect anew beside all others until none changes, so many times at `most`.

    Beside the same others each is asked for once in a whole search (`CandidatePool.revised`). Which one
    it is, that is: what no other candidate can do in its place is that one, whatever else might have
    been beside fewer causes. Whether there is any is left to elimination, before or, if anything is
    another one, in the end; so the model without an effect may be the one that the linear problem has.
    Return how often was asked, too.
    """
    left, moved, effects = most, False, list(effects)
    for _ in range(PASSES if len(effects) > 1 else 0):
        changed = False
        for effect in list(effects):
            if left <= 0:
                break
            name = effect.best.cause.name
            others = frozenset(cause.name for cause in found.causes) - {name}
            if (name, others) in pool.revised:
                continue
            pool.revised.add((name, others))
            present = with_last(pool.problem, found, name)
            rivals = pool.in_place_of(present)
            place = next(number for number, one in enumerate(effects) if one is effect)
            if not rivals:
                effects[place] = effect if rivals is None else _alone(effect)
                continue
            left -= 1
            try:
                base = without_by_linear(pool.problem, present, name)
            except UserError:
                continue
            again = posterior_beside(pool, base, rivals, present)
            if again is None:
                continue
            rest = [*effects[:place], *effects[place + 1 :]]
            again = with_odds(again, log_odds_at(effect.inclusion))
            again = _not_without_a_name(again, name, pool.settings)
            if again.best.cause.name != name:
                changed = True
                pool.revised.add((again.best.cause.name, others))
            if again.best.found is not present:
                moved = True
                found = fitted_together(pool, again.best.found, again.best.found.causes, present)
            effects = [*rest[:place], again, *rest[place:]]
        if not changed:
            break
    if moved:  # else they have just been judged beside one another
        found, effects = evident(pool, found, effects)
    by_name = {cause.name: place for place, cause in enumerate(found.causes)}
    effects.sort(key=lambda effect: by_name[effect.best.cause.name])
    return found, effects, most - left


def _not_without_a_name(effect: SingleEffect, name: str, settings: Settings) -> SingleEffect:
    """
    Return an effect with what is there (`name`) as its best where only a force without a name is ahead.

    And where what is there may be it, with 5 % (`Settings.credible_level`). A force without a name is
    what no cause explains; with it in the model, what else goes over speed or position is not evident
    any more.
    """
    there = next((one for one in effect.members if one.cause.name == name), None)
    if there is None or not is_discrepancy(effect.best.cause):
        return effect
    if there.probability < (1.0 - settings.credible_level) * effect.inclusion:
        return effect
    others = tuple(one for one in effect.members if one is not there)
    return replace(effect, members=(there, *others))


def _alone(effect: SingleEffect) -> SingleEffect:
    """Return an effect with its best member alone, as probable as before that there is any."""
    return with_odds(SingleEffect((effect.best,), effect.none), effect.log_odds)
