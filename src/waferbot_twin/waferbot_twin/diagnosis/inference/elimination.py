# SPDX-License-Identifier: Apache-2.0
"""
Backward elimination: what is not evident beside all that was found goes, the least evident first.

In the linear problem, where the others are as they are without it (`estimation.conditional`). What is
left is fitted anew through the simulation, and the logs have the last word.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logit

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import (
    CandidatePool,
    Judged,
    signatures_by_name,
)
from waferbot_twin.diagnosis.inference.nuisance import each_once
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at, log_odds_between
from waferbot_twin.diagnosis.inference.refit import (
    ROUGHLY,
    fitted,
    to_the_end,
    with_in_its_place,
    with_last,
    without,
)
from waferbot_twin.diagnosis.inference.single_effects import Posterior, SingleEffect, with_odds
from waferbot_twin.diagnosis.proposals.cogging_orders import with_an_order_less
from waferbot_twin.diagnosis.proposals.repetition import repeats_in
from waferbot_twin.estimation.conditional import conditional, without_by_linear
from waferbot_twin.estimation.evidence import gain, information_of, log_evidence, log_occam
from waferbot_twin.estimation.gauss_newton import ENOUGH, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of
from waferbot_twin.estimation.intervals import on_a_bound
from waferbot_twin.estimation.size_prior import (
    information_of_logs,
    log_prior,
    precision,
    scales_of,
)
from waferbot_twin.residuals.problem import Problem


def evident(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect] = (),
) -> tuple[Hypothesis, list[SingleEffect]]:
    """
    Return a hypothesis without those effects that are not evident beside all others.

    Backward elimination: the one that the linear problem finds least evident goes first, the rest is
    fitted anew without it. Where the logs then want it back, those that were asked for before and are
    evident in the linear problem are so with these odds at least: their own may be from beside other
    causes. All others have to be wanted back themselves, as the linear problem was wrong of one; so has
    what came along (`tentative`), which was never asked for, and what stands for a parameter of a dense
    effect, which is free without it: the linear problem does not have that. One that a fit has brought
    to a bound of what is possible stands in for another one, and so does one with a period that no log
    covers (`proposals.repetition`): the next member of its effect takes its place, or nothing if none is
    left.
    """
    left = [*effects, *tentative]
    # About other values than the best a fit without a cause gains what was not yet gained with it.
    found = to_the_end(pool.problem, found, pool.workers) if left else found
    open_ones = {one.best.cause.name for one in left}
    limit = log_odds_at(pool.settings.included_from)
    odds_of: dict[str, float] = {}
    total = len(open_ones)
    while open_ones:
        pool.progress(f'elimination, {total} causes', total - len(open_ones), total)
        again = _without_some(pool, found, sorted(open_ones))
        if again is not None:
            names = {cause.name for cause in again.causes}
            found, left = again, [one for one in left if one.best.cause.name in names]
            open_ones &= names
            continue
        by_linear = _linear_odds(pool, found)
        on_bounds = {
            one.name
            for place, one in enumerate(found.causes)
            if _stands_in(pool.problem, found, place)
        }
        name = min(sorted(open_ones), key=lambda one: (one not in on_bounds, by_linear[one]))
        instead = _with_next_member(pool, found, left, name) if name in on_bounds else None
        if instead is not None:
            found, left, its_name = instead
            open_ones = open_ones - {name} | {its_name}
            continue
        odds, base = odds_beside(pool, found, name)
        open_ones.discard(name)
        if odds > limit and name not in on_bounds:
            odds_of[name] = odds
            left = [one.as_judged(odds) if one.best.cause.name == name else one for one in left]
            asked = {
                one
                for one in open_ones
                if by_linear[one] > limit and not _stands_for_dense(pool.problem, found, one)
            }
            asked -= {one.best.cause.name for one in tentative}
            odds_of |= {
                one.best.cause.name: max(odds, float(logit(one.inclusion)))
                for one in left
                if one.best.cause.name in asked
            }
            open_ones -= asked
        else:
            left = [one for one in left if one.best.cause.name != name]
            found = base
    return found, [
        with_odds(one, odds_of[one.best.cause.name]) if one.best.cause.name in odds_of else one
        for one in left
    ]


def _stands_in(problem: Problem, found: Hypothesis, place: int) -> bool:
    """Return whether the fitted cause at a place can only stand in for another one."""
    return on_a_bound(problem, found, place) or not repeats_in(problem, found.causes[place])


def _stands_for_dense(problem: Problem, found: Hypothesis, name: str) -> bool:
    """Return whether without a cause a parameter of a dense effect is free that was held for it."""
    rest = tuple(cause for cause in found.causes if cause.name != name)
    return sum(cause.free for cause in each_once(problem, rest)) > sum(one.free for one in rest)


def _with_next_member(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect], name: str
) -> tuple[Hypothesis, list[SingleEffect], str] | None:
    """
    Return a hypothesis with the next member of an effect in place of its best one, fitted to the end.

    With the effects, and the name of that member. None if there is none that can be fitted, or each
    stands in for something else itself.
    """
    there = {cause.name for cause in found.causes}
    place = next(place for place, one in enumerate(effects) if one.best.cause.name == name)
    effect = effects[place]
    members = tuple(
        one
        for one in effect.members[1:]
        if one.cause.name not in there and not _stands_in(pool.problem, one.found, -1)
    )
    if not members:
        return None
    instead = members[0].cause
    causes = [instead if cause.name == name else cause for cause in found.causes]
    again = fitted(pool.problem, each_once(pool.problem, causes), pool.workers, ENOUGH, found)
    if again is None:
        return None
    own = with_odds(SingleEffect(members, effect.none), effect.log_odds)
    return again, [*effects[:place], own, *effects[place + 1 :]], instead.name


def as_evident(pool: CandidatePool, posterior: Posterior) -> Posterior:
    """
    Return a posterior without what is not evident beside all others in it, none surer than before.

    Nor a member that comes in the place of one, than that effect was.
    """
    most = {
        member.cause.name: one.log_odds for one in posterior.effects for member in one.members[1:]
    }
    most |= {one.best.cause.name: one.log_odds for one in posterior.effects}
    found, effects = evident(pool, posterior.found, posterior.effects)
    judged = (with_odds(one, min(one.log_odds, most[one.best.cause.name])) for one in effects)
    return replace(posterior, found=found, effects=tuple(judged))


def odds_beside(
    pool: CandidatePool | Judged, found: Hypothesis, name: str, parts: bool = False
) -> tuple[float, Hypothesis]:
    """
    Return ln of the odds of a cause of `found` beside the others, and these fitted without it.

    The signatures of `found` hold near it, so the first fit without the cause has these and costs few
    simulations. Another one goes on from there and ends with its own, first roughly, so that what it
    ends with is no less likely. It is not made where the odds are too low for the model already, nor
    where what may yet be gained would not make them too low for a name: as much again as the first one
    gained, or what the linear problem promises with the signatures of the last (`Hypothesis`). With
    `parts` by what parts of the logs agree on (`estimation.evidence.gain`). A cause with several orders
    is as probable as the surest of them beside the others.
    """
    odds, base = _odds_as_a_whole(pool, found, name, parts)
    if odds <= log_odds_at(pool.settings.named_from):
        odds = max(odds, _odds_of_surest_order(pool, found, name, parts))
    return odds, base


def _odds_of_surest_order(
    pool: CandidatePool | Judged, found: Hypothesis, name: str, parts: bool
) -> float:
    """
    Return ln of the odds of the surest order of a cause, the strongest first; -inf without several.

    What all of its orders gain together is one direction in the logs, and grows with the logarithm of
    how far it stands out of what is left over there (`noise_model.power`); each of them pays for its
    own size. So several small ones make a cause less probable as a whole, and not the surest of them.
    """
    problem, most = pool.problem, -math.inf
    more = with_last(problem, found, name)
    without_one = with_an_order_less(more.causes[-1])
    known = signatures_by_name(pool, found) if without_one else {}
    for fewer in without_one:
        base = with_in_its_place(problem, more, fewer, known)
        if base is not None:
            most = max(most, log_odds_between(pool, more, base, parts=parts))
        if most > log_odds_at(pool.settings.named_from):
            break
    return most


def _odds_as_a_whole(
    pool: CandidatePool | Judged, found: Hypothesis, name: str, parts: bool
) -> tuple[float, Hypothesis]:
    """Return `odds_beside` of a cause with all of its orders."""
    problem, scales = pool.problem, pool.settings.prior_scales
    more = with_last(problem, found, name)
    prior = pool.log_prior(more.causes[-1])

    def odds_against(base: Hypothesis) -> float:
        gained = gain(more, base, parts=True) if parts else None
        return log_evidence(problem, more, base, scales, gained) + prior

    def is_plain(odds: float, more: float) -> bool:
        too_low = odds <= log_odds_at(pool.settings.included_from)
        return too_low or odds - more > log_odds_at(pool.settings.named_from)

    signatures = signatures_by_name(pool, found)
    begun: Hypothesis | None = None
    try:
        start = without_by_linear(problem, found, name)
        begun = without(problem, found, [name], pool.workers, signatures)
        odds = odds_against(begun)
        if is_plain(odds, max(gain(begun, start), 0.0)):
            return odds, begun
    except UserError:  # the machine does not stand where that begins
        pass
    for roughly in (ROUGHLY, 0.0):
        first = () if begun is None else begun.causes
        base = without(
            problem, found, [name], pool.workers, None, first, begun=signatures, roughly=roughly
        )
        odds = odds_against(base)
        if is_plain(odds, base.promised):
            break
        begun = base
    return odds, base


def _without_some(
    pool: CandidatePool, found: Hypothesis, names: Sequence[str]
) -> Hypothesis | None:
    """
    Return a hypothesis without all causes that the linear problem finds not evident, if those are many.

    Half of them if the logs may want one back, and so on; None if that is less than two. Fitted with the
    signatures of `found`: what that leaves over is no less than what the best fit does.
    """
    out = _eliminated(pool, found, names)
    known = signatures_by_name(pool, found) if len(out) > 1 else {}
    while len(out) > 1:
        again = without(pool.problem, found, out, pool.workers, known)
        if _most_odds_of_one(pool, found, again, out) <= 0.0:
            return again
        out = out[: len(out) // 2]
    return None


def _most_odds_of_one(
    pool: CandidatePool, more: Hypothesis, fewer: Hypothesis, names: Sequence[str]
) -> float:
    """Return ln of the odds of one of some causes at most: as if it alone gained what all of them do."""
    kept = [cause for cause in more.causes if cause.name not in names]
    gained = (
        gain(more, fewer) + log_prior(pool.problem, kept) - log_prior(pool.problem, fewer.causes)
    )
    scales = pool.settings.prior_scales
    return gained + max(
        log_occam(
            cause,
            parameters_of(pool.problem, cause),
            information_of(pool.problem, more, place),
            scales_of(pool.problem, cause, scales),
        )
        + pool.log_prior(cause)
        for place, cause in enumerate(more.causes)
        if cause.name in names
    )


def _eliminated(pool: CandidatePool, found: Hypothesis, names: Sequence[str]) -> list[str]:
    """
    Return which of some causes are not evident beside the others, by the linear problem alone.

    The least evident goes, values and covariance of the others become those without it, and so on. One
    of which the others could do the work beyond their bounds only stays.
    """
    out: list[str] = []
    inside = list(names)
    if len(found.covariance) != len(names_of(pool.problem, found.causes)):
        return out
    while inside:
        odds = _linear_odds(pool, found, out)
        least = min(inside, key=lambda name: odds[name])
        if odds[least] > log_odds_at(pool.settings.included_from):
            break
        inside.remove(least)
        if _within_bounds(pool.problem, found, [*out, least]):
            out.append(least)
    return out


def _within_bounds(problem: Problem, found: Hypothesis, out: Collection[str]) -> bool:
    """Return whether without some causes the others have values that they can have."""
    names, away, _ = conditional(problem, found, out)
    return all(
        item.low <= item.neutral + change <= item.high
        for (place, item), change in zip(names, away, strict=True)
        if not item.shape and found.causes[place].name not in out
    )


def _linear_odds(
    pool: CandidatePool, found: Hypothesis, out: Collection[str] = ()
) -> dict[str, float]:
    """Return ln of the odds of causes without those `out`, by Wald's statistic: value and covariance."""
    names, away, spread = conditional(pool.problem, found, out)
    sizes = np.array([not item.shape for _, item in names], np.bool_)
    odds: dict[str, float] = {}
    for number, cause in enumerate(found.causes):
        if cause.name in out:
            continue
        own = np.array([place == number for place, _ in names], np.bool_)
        parameters = parameters_of(pool.problem, cause)
        values = {
            item.name: item.neutral + change
            for item, change in zip(parameters, away[own], strict=True)
            if not item.shape
        }
        prior, inside = precision(pool.problem, cause), sizes[own]
        known = information_of_logs(spread[np.ix_(own, own)], prior)
        of_sizes = information_of_logs(spread[np.ix_(own & sizes, own & sizes)], prior[inside])
        gained = 0.5 * float(away[own & sizes] @ of_sizes @ away[own & sizes])
        scales = scales_of(pool.problem, cause, pool.settings.prior_scales)
        occam = log_occam(cause.with_values(values), parameters, known, scales)
        odds[cause.name] = gained + occam + pool.log_prior(cause)
    return odds
