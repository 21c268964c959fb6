# SPDX-License-Identifier: Apache-2.0
"""
The search for effects: one after the other, then all again.

Effects are added as long as one is more probable than not (`forward_selection`). Then each is
asked for anew beside all others, as often as one changes: an early choice is revised when the others are
known. Where one of those that were asked for has gone, what it stood for may still lack: more are added,
and so on (stepwise selection). The posterior of each is that of `single_effects`, from fits through the
simulation for every candidate that the linear problem puts within reach (`refit`). Last, what the closed
loop has made of noise is taken out (`feigned`).
"""

from __future__ import annotations

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.elimination import evident, log_odds_at
from waferbot_twin.diagnosis.inference.feigned import without_feigned
from waferbot_twin.diagnosis.inference.forward_selection import (
    ask_on,
    fitted_together,
    posterior_beside,
)
from waferbot_twin.diagnosis.inference.refit import to_the_end, with_last
from waferbot_twin.diagnosis.inference.single_effects import Posterior, SingleEffect, with_odds
from waferbot_twin.estimation.conditional import without_by_linear
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate

PASSES = 2
"""How often at most every effect is asked for anew."""


def infer(pool: CandidatePool) -> Posterior:
    """
    Return the posterior over causes of the logs of a pool.

    Raises `UserError` if the nominal model does not run in their motions.
    """
    nothing = evaluate(pool.problem)
    pool.begin(nothing)
    pool.note_noise_of(nothing)
    found, effects = nothing, list[SingleEffect]()
    most = pool.settings.most_asked
    seen = set[frozenset[str]]()
    while True:
        found, effects, wanted, asked = ask_on(pool, found, effects, most, usual=bool(seen))
        most -= asked
        found, effects, asked = _ask_again(pool, found, effects, most)
        most -= asked
        names = frozenset(cause.name for cause in found.causes)
        if most > 0 and not names.issuperset(wanted) and names not in seen:
            seen.add(names)
            continue
        found, effects, feigned = without_feigned(pool, found, effects)
        if not feigned:
            found = to_the_end(pool.problem, found, pool.workers)
            return Posterior(nothing, found, tuple(effects), len(pool.names))
        for name in feigned:
            pool.leave_out(name)


def _ask_again(
    pool: CandidatePool, found: Hypothesis, effects: list[SingleEffect], most: int
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Ask for every effect anew beside all others until none changes, so many times at `most`.

    Beside the same others each is asked for once. Which one it is, that is: what no other candidate can
    do in its place stays as it is. Whether there is any is left to elimination, before or, if anything
    is another one, in the end; so the model without an effect may be the one that the linear problem
    has. Return how often was asked, too.
    """
    left, moved = most, False
    asked = set[str]()
    for _ in range(PASSES if len(effects) > 1 else 0):
        changed = False
        for effect in list(effects):
            if left <= 0:
                break
            name = effect.best.cause.name
            if name in asked:
                continue
            asked.add(name)
            present = with_last(pool.problem, found, name)
            rivals = pool.in_place_of(present)
            if not rivals:
                continue
            left -= 1
            try:
                base = without_by_linear(pool.problem, present, name)
            except UserError:
                continue
            again = posterior_beside(pool, base, rivals, present)
            if again is None:
                continue
            place = next(number for number, one in enumerate(effects) if one is effect)
            rest = [*effects[:place], *effects[place + 1 :]]
            again = with_odds(again, log_odds_at(effect.inclusion))
            if again.best.cause.name != name:
                changed, asked = True, {again.best.cause.name}
            if again.best.found is not present:
                moved = True
                found = fitted_together(pool, again.best.found, again.best.found.causes)
            effects = [*rest[:place], again, *rest[place:]]
        if not changed:
            break
    if moved:  # else they have just been judged beside one another
        found, effects = evident(pool, found, effects)
    by_name = {cause.name: place for place, cause in enumerate(found.causes)}
    effects.sort(key=lambda effect: by_name[effect.best.cause.name])
    return found, effects, most - left
