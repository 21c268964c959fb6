# SPDX-License-Identifier: Apache-2.0
"""
The search for effects: one after the other, then all again.

Effects are added as long as one is more probable than not (`settings`); then each is asked for anew
beside all others, as often as one changes: an early choice is revised when the others are known. The
posterior of each is that of `single_effects`, from fits through the simulation for every candidate that
the linear problem puts within reach (`refit`). What no physical cause explains competes with them:
forces over speed and position of an axis without a name (`discrepancy`). Last, what the closed loop has
made of noise is taken out (`instrument`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logit

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy
from waferbot_twin.diagnosis.inference.instrument import instrumented_gain
from waferbot_twin.diagnosis.inference.nuisance import is_nuisance
from waferbot_twin.diagnosis.inference.refit import fitted, to_the_end, within_reach, without
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import (
    Member,
    Posterior,
    SingleEffect,
    posterior_of,
    with_odds,
)
from waferbot_twin.diagnosis.proposals.screening import Screened, untempered
from waferbot_twin.estimation.evidence import gain, log_evidence, log_occam, spread_of
from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

ROUNDING = 0.01
"""Of a probability: fits end where a round gains some hundredths in ln L."""

PASSES = 2
"""How often at most every effect is asked for anew."""


def infer(pool: CandidatePool) -> Posterior:
    """
    Return the posterior over causes of the logs of a pool.

    Raises `UserError` if the nominal model does not run in their motions.
    """
    nothing = evaluate(pool.problem)
    pool.begin(nothing)
    found, effects = _search(pool, nothing, [])
    return Posterior(nothing, found, tuple(effects), len(pool.names))


def infer_from_least_squares(pool: CandidatePool, first: Posterior) -> Posterior:
    """
    Return the more probable of a posterior and of what a search finds that begins with more.

    It begins with what everybody fits first, all together: masses and force constants, Coulomb and
    viscous friction and a constant force of every axis. Where most things are off, a search that adds
    one cause at a time goes wrong: whichever comes first takes what many others leave over, and they
    find nothing any more. Of these each stays that is evident beside all that is found.
    """
    causes = pool.usual()
    begun = fitted(pool.problem, causes) if causes else None
    if begun is None:
        return first
    tentative = [
        SingleEffect(
            (Member(_with_last(pool.problem, begun, one.name), 0.0, pool.log_prior(one), 1.0),),
            0.0,
        )
        for one in causes
    ]
    found, effects = _search(pool, begun, tentative)
    if _odds_against(pool, found, first.found) <= 0.0:
        return first
    return replace(first, found=found, effects=tuple(effects))


def _search(
    pool: CandidatePool, found: Hypothesis, tentative: list[SingleEffect]
) -> tuple[Hypothesis, list[SingleEffect]]:
    """Add effects to some, and ask for all of them anew, until none is added, changed or feigned."""
    effects: list[SingleEffect] = []
    most = pool.settings.most_asked
    while True:
        found, effects, asked = _ask_on(pool, found, effects, tentative, most)
        most -= asked
        found, effects, asked = _ask_again(pool, found, effects, most)
        most -= asked
        feigned, judged = _instrumented(pool, found, effects)
        if feigned is None:
            return found, judged
        pool.leave_out(feigned)
        found, effects = _without(pool.problem, found, effects, feigned)
        tentative = []


def _odds_against(pool: CandidatePool, this: Hypothesis, other: Hypothesis) -> float:
    """Return ln of the posterior odds of a hypothesis with all its causes against another one."""
    occam = [
        sum(
            pool.log_prior(cause)
            + log_occam(
                cause,
                parameters_of(pool.problem, cause),
                spread_of(pool.problem, one, place),
                pool.settings.prior_scales,
            )
            for place, cause in enumerate(one.causes)
        )
        for one in (this, other)
    ]
    return gain(this, other) + occam[0] - occam[1]


def _ask_on(
    pool: CandidatePool,
    found: Hypothesis,
    effects: list[SingleEffect],
    begun: list[SingleEffect],
    most: int,
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Add effects as long as one is included; return how often was asked, too.

    With the most probable candidate come those that are plain on their own and do something else: on
    another axis, in another block. They would be found in the next rounds. They are tentative, too.

    Where many things lack, each is hidden by what the others leave over: along most directions there is
    so much that no single cause stands out of it. So what would be more probable than none if the power
    along it were known is in the model for the time being, too, as is what was `begun` with; it stays
    if it is evident beside all that was found by then.
    """
    asked, effects, tentative = 0, list(effects), list(begun)
    most_causes = pool.settings.most_causes + len(begun)
    while len(effects) + len(tentative) < most_causes and asked < most:
        effect = _ask(pool, found)
        asked += 1
        apart: list[Member] = []
        if effect is not None and _included(effect, pool.settings):
            best = effect.best
            effects.append(effect)
            apart = _apart(pool, found, effect.members)
            tentative += [SingleEffect((one,), effect.none) for one in apart]
        elif effect is not None and (ahead := _ahead(pool.problem, found, effect)) is not None:
            best = ahead
            tentative.append(SingleEffect((ahead,), effect.none))
        else:
            break
        together = (*best.found.causes, *(one.cause for one in apart))
        found = (fitted(pool.problem, together) if apart else None) or to_the_end(
            pool.problem, best.found
        )
    return *_evident(pool, found, effects, tentative), asked


def _apart(pool: CandidatePool, base: Hypothesis, members: Sequence[Member]) -> list[Member]:
    """
    Return those members beside the first which are plain on their own and do something else.

    What two of them change is hardly correlated.
    """
    kept, changes = [members[0]], [_change(base, members[0])]
    plain = _log_odds(pool.settings.named_from)
    for one in sorted(members[1:], key=lambda member: -member.log_odds):
        if one.log_odds <= plain:
            break
        change = _change(base, one)
        by_name = not is_nuisance(one.cause) and not is_discrepancy(one.cause)
        if by_name and all(
            abs(change @ other) < pool.settings.correlated_from for other in changes
        ):
            kept.append(one)
            changes.append(change)
    return kept[1:]


def _change(base: Hypothesis, member: Member) -> Array:
    """Return what a member changes in all channels, in the noise of `base`, of length 1."""
    rows = np.concatenate(
        [
            one
            for block, fit in base.fits.items()
            for one in in_deviations(
                fit.colours,
                [
                    before - after
                    for before, after in zip(
                        base.residuals[block], member.found.residuals[block], strict=True
                    )
                ],
            )
        ]
    )
    length = float(np.linalg.norm(rows))
    return np.asarray(rows / length if length else rows)


def _ahead(problem: Problem, base: Hypothesis, effect: SingleEffect) -> Member | None:
    """Return the most probable member if the power of the noise along each were known; None for none."""

    def log_odds(member: Member) -> float:
        more = gain(member.found, base, power_known=True) - gain(member.found, base)
        return member.log_odds + more

    best = max(effect.members, key=log_odds)
    return best if log_odds(best) > 0.0 else None


def _evident(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> tuple[Hypothesis, list[SingleEffect]]:
    """
    Return a hypothesis without those tentative effects that are not evident beside all others.

    The one that the linear problem finds least evident goes first, and each is refitted without it.
    """
    problem, left, sure = pool.problem, list(tentative), list[SingleEffect]()
    while left:
        by_linear = [_linear_odds(pool, found, effect.best.cause.name) for effect in left]
        least = left.pop(int(np.argmin(by_linear)))
        name = least.best.cause.name
        base, _ = _without(problem, found, (), name)
        more = _with_last(problem, found, name)
        evidence = log_evidence(problem, more, base, pool.settings.prior_scales)
        odds = evidence + least.best.log_prior
        if odds > _log_odds(pool.settings.included_from):
            sure.append(with_odds(least, odds))
        else:
            found = base
    return found, [*effects, *sure]


def _linear_odds(pool: CandidatePool, found: Hypothesis, name: str) -> float:
    """Return ln of the odds of one cause by Wald's statistic: by its value and the covariance alone."""
    place = next(place for place, cause in enumerate(found.causes) if cause.name == name)
    cause, own = found.causes[place], spread_of(pool.problem, found, place)
    parameters = parameters_of(pool.problem, cause)
    away = np.array([cause.values[item.name] - item.neutral for item in parameters])
    gained = 0.5 * float(away @ np.linalg.pinv(own) @ away)
    return (
        gained
        + log_occam(cause, parameters, own, pool.settings.prior_scales)
        + pool.log_prior(cause)
    )


def _included(effect: SingleEffect, settings: Settings) -> bool:
    """Return whether an effect is in the model; where no log tells, odds are even but for rounding."""
    return effect.inclusion > settings.included_from + ROUNDING


def _log_odds(probability: float) -> float:
    return float(logit(probability))


def _without(
    problem: Problem, found: Hypothesis, effects: Sequence[SingleEffect], name: str
) -> tuple[Hypothesis, list[SingleEffect]]:
    """Return a hypothesis and its effects without one cause, the others fitted anew."""
    rest = [effect for effect in effects if effect.best.cause.name != name]
    again = without(problem, found, name)
    if again is None:
        again = evaluate(problem, tuple(one for one in found.causes if one.name != name))
    return again, rest


def _instrumented(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> tuple[str | None, list[SingleEffect]]:
    """
    Return which cause the closed loop's noise has made most plainly, if any; and effects as judged now.

    Hausman's test presumes that nothing else lacks: what another cause leaves over goes with the
    command, too. So it is asked last, when no further cause is found. Where it speaks against the logs,
    the instrument's odds are those of the effect.
    """
    problem, settings = pool.problem, pool.settings
    judged: list[SingleEffect] = []
    worst, feigned = _log_odds(settings.included_from), None
    for effect in effects:
        cause = effect.best.cause
        base, _ = _without(problem, found, (), cause.name)
        more = _with_last(problem, found, cause.name)
        gained = instrumented_gain(problem, base, more, settings.endogeneity_level)
        if gained is None:
            judged.append(effect)
            continue
        evidence = log_evidence(problem, more, base, settings.prior_scales, gained)
        odds = evidence + pool.log_prior(more.causes[-1])
        judged.append(with_odds(effect, odds))
        if odds < worst:
            worst, feigned = odds, cause.name
    return feigned, judged


def _with_last(problem: Problem, found: Hypothesis, name: str) -> Hypothesis:
    """Return the same hypothesis with one of its causes behind the others."""
    places = sorted(range(len(found.causes)), key=lambda place: found.causes[place].name == name)
    counts = [len(parameters_of(problem, cause)) for cause in found.causes]
    firsts = np.cumsum([0, *counts])
    order = [n for place in places for n in range(firsts[place], firsts[place + 1])]
    spread = found.covariance
    if len(spread) == len(order):
        spread = spread[np.ix_(order, order)]
    causes = tuple(found.causes[place] for place in places)
    return replace(found, causes=causes, covariance=spread)


def _ask_again(
    pool: CandidatePool, found: Hypothesis, effects: list[SingleEffect], most: int
) -> tuple[Hypothesis, list[SingleEffect], int]:
    """
    Ask for every effect anew beside all others until none changes, so many times at `most`.

    Return how often was asked, too.
    """
    left = most
    for _ in range(PASSES if len(effects) > 1 else 0):
        changed = False
        for effect in list(effects):
            name = effect.best.cause.name
            settled = len(effect.members) > 1 and not _bent(pool, found, name)
            if left <= 0 or settled:
                continue
            left -= 1
            present = _with_last(pool.problem, found, name)
            base = without(pool.problem, found, name)
            again = _ask(pool, base, present) if base is not None else None
            if again is None:
                continue
            place = next(number for number, one in enumerate(effects) if one is effect)
            rest = [*effects[:place], *effects[place + 1 :]]
            if not _included(again, pool.settings):
                assert base is not None
                found, effects, changed = base, rest, True
                continue
            changed |= again.best.cause.name != name
            if again.best.found is not present:
                found = to_the_end(pool.problem, again.best.found)
            effects = [*rest[:place], again, *rest[place:]]
        if not changed:
            break
    by_name = {cause.name: place for place, cause in enumerate(found.causes)}
    effects.sort(key=lambda effect: by_name[effect.best.cause.name])
    return found, effects, most - left


def _bent(pool: CandidatePool, found: Hypothesis, name: str) -> bool:
    """Return whether the values of a cause depend on those of the others: so may its name."""
    own = np.array(
        [found.causes[place].name == name for place, _ in names_of(pool.problem, found.causes)]
    )
    if len(own) != len(found.covariance):
        return True
    deviations = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    correlation = found.covariance / np.outer(deviations, deviations)
    most = float(np.max(np.abs(correlation[np.ix_(own, ~own)]), initial=0.0))
    return most > pool.settings.correlated_from


def _ask(
    pool: CandidatePool, base: Hypothesis, present: Hypothesis | None = None
) -> SingleEffect | None:
    """
    Return the posterior of one more effect beside those of `base`.

    `present` has as its last cause what is there now, fitted with the others: from `base`, whose causes
    have taken what they can of its work, a fit may not find back there. None if nothing could be fitted.
    """
    problem, settings = pool.problem, pool.settings
    screened = _promising(pool, pool.screen(base))
    if present is None and not screened:
        screened = _promising(pool, pool.damped_rings(base))
    if present is not None:
        screened = [item for item in screened if item.cause.name != present.causes[-1].name]
    chosen = within_reach(problem, screened, settings)
    known_causes = base.causes if present is None else present.causes
    there = {cause.name for cause in (*known_causes, *(item.cause for item in chosen))}
    chosen += [untempered(cause, 0.0) for cause in pool.dense if cause.name not in there]
    known = pool.signatures_of(base)
    refitted = pool.refits(base, chosen, known)
    refitted += [present] if present is not None else []
    refitted = [one for one in refitted if not _on_a_bound(problem, one.causes[-1])]
    members = [
        Member(
            one,
            log_evidence(problem, one, base, settings.prior_scales),
            pool.log_prior(one.causes[-1]),
        )
        for one in refitted
    ]
    return posterior_of(problem, base, members, settings.prior_scales)


def _promising(pool: CandidatePool, screened: Sequence[Screened]) -> list[Screened]:
    """Return what the linear problem finds more probable than none in noise of known power."""
    return [item for item in screened if item.likelihood + pool.log_prior(item.cause) > 0.0]


def _on_a_bound(problem: Problem, cause: Cause) -> bool:
    """Return whether a size of a cause is as large as it can be: then it stands in for another one."""
    return any(
        cause.values[item.name] in (item.low, item.high)
        and cause.values[item.name] != item.neutral
        for item in parameters_of(problem, cause)
        if not item.shape and item.spread == 0.0
    )
