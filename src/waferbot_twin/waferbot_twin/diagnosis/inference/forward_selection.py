# SPDX-License-Identifier: Apache-2.0
"""
Forward selection: effects are added as long as one is more probable than not.

What rings is then begun at other sizes, too. What is not evident beside all that was found goes again
later (`elimination`). What no physical cause explains competes with the others: forces over speed and
position of an axis without a name (`discrepancy`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, signatures_by_name
from waferbot_twin.diagnosis.inference.discrepancy import is_discrepancy, is_physical
from waferbot_twin.diagnosis.inference.feigned import beside_noise
from waferbot_twin.diagnosis.inference.nuisance import each_once, is_damping, is_nuisance
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at, log_odds_between
from waferbot_twin.diagnosis.inference.refit import (
    ROUGHLY,
    Refits,
    begun_elsewhere,
    fitted,
    fitted_on,
    with_last,
    within_reach,
)
from waferbot_twin.diagnosis.inference.single_effects import (
    Member,
    SingleEffect,
    posterior_of,
    with_odds,
)
from waferbot_twin.diagnosis.proposals.cogging_orders import has_orders, measured_by_others
from waferbot_twin.diagnosis.proposals.screening import Screened, at_its_sizes, untempered
from waferbot_twin.estimation.evidence import evidence_of, gain
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    is_nothing,
    lets_go,
    parameters_of,
)
from waferbot_twin.estimation.intervals import on_a_bound
from waferbot_twin.estimation.separable import part_of
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.noise_model.residual_spectrum import log_likelihood_ratios_in, powers_along
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

Found = tuple[Hypothesis, list[SingleEffect], list[SingleEffect]]
"""A hypothesis, its effects that were asked for, and those that are tentative."""

WholeModels = Callable[[CandidatePool, Hypothesis, list[SingleEffect], list[SingleEffect]], Found]
"""Weighs other models as a whole against the one that was found."""

ROUNDING = 0.01
"""Of a probability: fits end where a round gains some hundredths in ln L."""


def ask_on(
    pool: CandidatePool,
    found: Hypothesis,
    effects: list[SingleEffect],
    most: int,
    usual: bool,
    as_a_whole: WholeModels = lambda pool, *found: found,
) -> tuple[Hypothesis, list[SingleEffect], list[SingleEffect], set[str], int]:
    """
    Add effects as long as one is included.

    Return the hypothesis, its effects, those that are tentative, the names of whatever was asked for,
    and how often was asked.

    With the most probable candidate come those that are plain beside it, too (`_apart`): they were asked
    for as well, and would be found in the next rounds.

    Where many things lack, each is hidden by what the others leave over: along most directions there is
    so much that no single cause stands out of it. So what would be more probable than none if the power
    along it were known is in the model for the time being, too. And whichever came first would take what
    many others leave over. So where a second cause is sure enough to be named, and is not feigned by
    noise (`feigned`), what everybody fits first comes along: masses and force constants, Coulomb and
    viscous friction and a constant force of every axis (`CandidatePool.usual`). The damping of what
    gives, which nobody knows, is no such cause. What
    came so is tentative: each stays if it is evident beside all that was found by then. A force without
    a name is asked for again beside them, and not there before: it would do what several of them do
    together. `usual` says that they have been there. Where it is ahead again, other causes may still do
    together what it does (`_by_names`).

    When they have come, and in the end, what only many causes together explain is weighed `as_a_whole`:
    what is asked for beside a rigid machine with the wrong load would stand in for what rings and is
    heavy.
    """
    asked, sure, along = 0, list[SingleEffect](), set[str]()
    effects, tentative = list(effects), list[SingleEffect]()
    beside: dict[frozenset[str], SingleEffect | None] = {}
    while len(effects) + len(tentative) < pool.settings.most_causes and asked < most:
        effect = ask(pool, found)
        asked += 1
        included = effect is not None and _included(effect, pool)
        beside[frozenset(cause.name for cause in found.causes)] = None if included else effect
        if effect is None:
            break
        if included and usual and is_discrepancy(effect.best.cause):
            named, instead, more = _by_names(pool, found, effect, most - asked)
            asked += more
            if named:
                effects += named
                found, effects, tentative = some_of_each(pool.problem, instead, effects, tentative)
                continue
        best, odds = effect.best, effect.log_odds
        if not included:
            best, odds = _ahead(pool.problem, found, effect)
        if odds <= 0.0 or is_nothing(pool.problem, best.cause):
            break
        causes = found.causes
        without_name = is_discrepancy(best.cause) and not usual
        if not without_name:
            causes = best.found.causes
            (effects if included else tentative).append(
                effect if included else SingleEffect((best,), effect.none)
            )
            for own in _apart(pool, found, effect.members) if included else ():
                effects.append(own)
                causes = (*causes, own.best.cause)
        first: list[Cause] = []
        come = False
        if not usual:
            now = with_odds(SingleEffect((best,), 0.0), odds)
            sure = _sure(pool, [*sure, now], best.found)
            come = usual = len(sure) > 1 or without_name
        if come:
            there = {cause.name for cause in causes}
            first = [cause for cause in pool.usual() if cause.name not in there]
        if without_name:
            together = each_once(pool.problem, (*causes, *first))
            known = signatures_by_name(pool, found)
            found = fitted(pool.problem, together, pool.workers, near=found, begun=known) or found
        else:
            found = fitted_together(pool, best.found, (*causes, *first), found)
        names = {cause.name for cause in found.causes}
        along |= {one.name for one in first}
        tentative += [as_fitted(pool, found, one) for one in first if one.name in names]
        found = _with_their_orders(pool, found)
        found, effects, tentative = some_of_each(pool.problem, found, effects, tentative)
        if come:
            beside.clear()  # what follows is another one where the usual has been there
            found, effects, tentative = as_a_whole(pool, found, effects, tentative)
        pool.note_noise_of(found)
    pool.asked_beside |= beside
    found = _begun_elsewhere(pool, found)
    wanted = {one.best.cause.name for one in (*effects, *tentative)} - along
    if usual:
        found, effects, tentative = as_a_whole(pool, found, effects, tentative)
    return found, effects, tentative, wanted, asked


def _sure(
    pool: CandidatePool, effects: Sequence[SingleEffect], found: Hypothesis
) -> list[SingleEffect]:
    """
    Return the effects that are sure enough to be named; of several in `found` beside noise, too.

    The damping of what gives, which nobody knows, is none of them.
    """
    limit = log_odds_at(pool.settings.named_from)
    names = {cause.name for cause in found.causes}

    def among(some: Sequence[SingleEffect]) -> list[SingleEffect]:
        return [one for one in some if one.log_odds > limit]

    own = [
        one
        for one in among(effects)
        if one.best.cause.name in names and not is_damping(one.best.cause)
    ]
    return among(beside_noise(pool, found, own)) if len(own) > 1 else own


def _with_their_orders(pool: CandidatePool, found: Hypothesis) -> Hypothesis:
    """
    Return a hypothesis whose cogging has the orders that its logs show beside the other causes.

    When it was added others lacked, and hid lines or took their place.
    """
    for cause in found.causes if measured_by_others(pool.problem) else ():
        if not has_orders(cause):
            continue
        present = with_last(pool.problem, found, cause.name)
        try:
            tuned = pool.with_orders(present)
        except UserError:  # the machine does not stand without it
            continue
        if not tuned or tuned[0].cause.values.keys() == cause.values.keys():
            continue
        known = pool.signatures_of(present)[:-1]
        base = evaluate(pool.problem, present.causes[:-1])
        for one in Refits(pool.problem, pool.progress)(base, tuned[:1], known):
            if log_odds_between(pool, one, found) > 0.0:
                found = fitted_together(pool, one, one.causes, present)
    return found


def _begun_elsewhere(pool: CandidatePool, found: Hypothesis) -> Hypothesis:
    """Return a hypothesis with each cause that rings at the most probable size it is tried at."""
    for cause in found.causes:
        if not cause.effect.rings:
            continue
        trials = list(at_its_sizes(parameters_of(pool.problem, cause), replace(cause, narrow=())))
        known = signatures_by_name(pool, found)
        found = begun_elsewhere(pool.problem, found, trials, known, pool.workers)
    return found


def _by_names(
    pool: CandidatePool, base: Hypothesis, effect: SingleEffect, most: int
) -> tuple[list[SingleEffect], Hypothesis, int]:
    """
    Return causes that together are more probable than a force without a name, and they fitted.

    Several causes may do what such a force does alone, and each of them less of it. They are added to
    `base`, one after the other, as long as one is included, until they are ahead. None if they never
    are. `effect` is what was asked for beside `base`; return how often more was asked for, too.
    """
    unnamed = with_last(pool.problem, effect.best.found, effect.best.cause.name)
    there, chosen, asked = base, list[SingleEffect](), 0
    members = effect.members
    while True:
        own = posterior_of(there, [one for one in members if not is_discrepancy(one.cause)])
        if own is None or not _included(own, pool):
            return [], base, asked
        chosen.append(own)
        there = fitted_together(pool, own.best.found, own.best.found.causes, there)
        if log_odds_between(pool, there, unnamed) > 0.0:
            return chosen, there, asked
        if asked >= most:
            return [], base, asked
        more = ask(pool, there)
        asked += 1
        if more is None:
            return [], base, asked
        members = more.members


def fitted_together(
    pool: CandidatePool, found: Hypothesis, causes: tuple[Cause, ...], beside: Hypothesis
) -> Hypothesis:
    """
    Return causes roughly fitted, no number in two places (`each_once`).

    The fit begins with the signatures of those causes `beside` which it was asked. Where the causes are
    the ones of `found`, or the machine does not stand with them, that one with its last cause fitted on.
    """
    together, known = each_once(pool.problem, causes), signatures_by_name(pool, beside)
    if together == found.causes:
        return fitted_on(pool.problem, found, pool.workers, known)
    joint = fitted(pool.problem, together, pool.workers, near=found, begun=known, roughly=ROUGHLY)
    return joint or fitted_on(pool.problem, found, pool.workers, known)


def as_fitted(pool: CandidatePool, found: Hypothesis, cause: Cause) -> SingleEffect:
    """Return a cause of a hypothesis as an effect that was not asked for."""
    last = with_last(pool.problem, found, cause.name)
    return SingleEffect((Member(last, 0.0, pool.log_prior(cause), 1.0),), 0.0)


def _apart(pool: CandidatePool, base: Hypothesis, members: Sequence[Member]) -> list[SingleEffect]:
    """
    Return those members beside the first that are plain beside the others, too, as effects.

    One after the other, each by its gain in the linear problem without what those before it change.
    Where another candidate could stand for one, which it is has to be asked: it is one effect with all
    members of its axis, if nothing of that was chosen. And of an axis only one that lets a part go: with
    that it is another machine, and what each changes alone does not add up.
    """
    plain = log_odds_at(pool.settings.named_from)
    chosen, changes = [members[0]], [_change(base, members[0])]
    effects: list[SingleEffect] = []
    own = [one for one in members[1:] if one.log_odds > plain and is_physical(one.cause)]
    for_each = pool.could_stand_for(base, [one.found for one in own]) if own else []
    could_stand_for = dict(zip(map(id, own), for_each, strict=True))
    rest = [(one, _change(base, one)) for one in own]
    while rest:
        odds = [
            one.log_odds - gain(one.found, base) + _gain_beside(base, changes, change)
            for one, change in rest
        ]
        best = int(np.argmax(odds))
        if odds[best] <= plain:
            break
        one, change = rest.pop(best)
        go = [item for item in (one, *chosen) if item.cause.axis == one.cause.axis]
        if sum(lets_go(pool.problem, base.causes, item.cause) for item in go) > 1:
            continue
        names = {item.cause.name for item in chosen}
        rivals = [rival for rival in could_stand_for[id(one)] if rival.name not in names]
        if not rivals:
            effects.append(with_odds(SingleEffect((one,), 0.0), one.log_odds))
        elif {rival.axis for rival in rivals} == {one.cause.axis} and len(go) == 1:
            effect = posterior_of(base, _on(one.cause.axis, members))
            if effect is None or effect.best.cause.name != one.cause.name:
                continue
            effects.append(effect)
        else:
            changes.append(change)
            continue
        chosen.append(one)
        changes.append(change)
    return effects


def _on(axis: str, members: Sequence[Member]) -> list[Member]:
    """Return the members on an axis that have a physical name."""
    return [one for one in members if one.cause.axis == axis and is_physical(one.cause)]


def _gain_beside(base: Hypothesis, others: Sequence[list[Array]], own: list[Array]) -> float:
    """Return the gain of a change of `base`, in any size, beside others, in the linear problem."""
    white = [one for fit in base.fits.values() for one in fit.whitened]
    colours = [colour for fit in base.fits.values() for colour in fit.colours]
    columns, _ = np.linalg.qr(np.column_stack([np.concatenate(one) for one in others]))
    left, change = (
        rows - columns @ (columns.T @ rows)
        for rows in (np.concatenate(white), np.concatenate(own))
    )
    square = float(change @ change)
    size = float(change @ left) / square if square else 0.0
    ends = np.cumsum([len(one) for one in white])[:-1]
    before, after, moved = (
        np.split(rows, ends) for rows in (left, left - size * change, size * change)
    )
    squares = [float(one @ one - two @ two) for one, two in zip(before, after, strict=True)]
    return sum(log_likelihood_ratios_in(powers_along(after, moved, colours), squares))


def _change(base: Hypothesis, member: Member) -> list[Array]:
    """Return what a member takes away in every channel, in the noise of `base`."""
    return [
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


def _ahead(problem: Problem, base: Hypothesis, effect: SingleEffect) -> tuple[Member, float]:
    """
    Return the most probable member if the power of the noise along each were known, and ln of its odds.

    Dampings, which nobody knows, are not hidden by what else lacks: they come with what gives.
    """

    def log_odds(member: Member) -> float:
        if is_damping(member.cause):
            return -math.inf
        more = gain(member.found, base, power_known=True) - gain(member.found, base)
        return member.log_odds + more

    best = max(effect.members, key=log_odds)
    return best, log_odds(best)


def some_of_each(
    problem: Problem,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> tuple[Hypothesis, list[SingleEffect], list[SingleEffect]]:
    """Return a fitted hypothesis and its effects without those causes of which there is nothing."""
    places = [place for place, one in enumerate(found.causes) if not is_nothing(problem, one)]
    kept = part_of(problem, found, places, frozenset(problem.blocks))
    names = {cause.name for cause in kept.causes}
    effects, tentative = (
        [one for one in some if one.best.cause.name in names] for some in (effects, tentative)
    )
    return kept, effects, tentative


def _included(effect: SingleEffect, pool: CandidatePool) -> bool:
    """
    Return whether an effect is in the model: more probable than not, and there is something of its best.

    Where no log tells, odds are even but for rounding.
    """
    likely = effect.inclusion > pool.settings.included_from + ROUNDING
    return likely and not is_nothing(pool.problem, effect.best.cause)


def ask(pool: CandidatePool, base: Hypothesis) -> SingleEffect | None:
    """
    Return the posterior of one more effect beside those of `base`; None if none could be fitted.

    Where nothing is more probable than none by the linear problem, of what may be there all the same,
    with 5 % (`Settings.credible_level`): values are averaged over that (`model_average`).
    """
    screened = pool.screen(base)
    promising = _promising(pool, screened) or _promising(pool, pool.damped_rings(base))
    if promising:
        return posterior_beside(pool, base, promising)
    least = -log_odds_at(pool.settings.credible_level)
    others = _promising(pool, screened, least)
    return posterior_beside(pool, base, others, also=pool.in_place_of_bounds(base))


def posterior_beside(
    pool: CandidatePool,
    base: Hypothesis,
    screened: Sequence[Screened],
    present: Hypothesis | None = None,
    also: Sequence[Hypothesis] = (),
) -> SingleEffect | None:
    """
    Return the posterior of one effect, from fits of what the linear problem puts within reach.

    `present` has as its last cause what is there now, fitted with the others: from `base`, whose causes
    have taken what they can of its work, a fit may not find back there. So what may be in its place is
    also fitted from where it was screened, beside the others as they are (`CandidatePool.in_place_of`).
    `also` have candidates as their last causes that were fitted otherwise. None if nothing could be
    fitted.
    """
    problem, settings = pool.problem, pool.settings
    chosen = within_reach(problem, screened, settings)
    if present is None:
        there = {item.cause.name for item in chosen}
        dense = (one for one in pool.dense_beside(base.causes) if one.name not in there)
        chosen += [untempered(cause, 0.0) for cause in dense]
    known = pool.signatures_of(base) if present is None else pool.signatures_of(present)[:-1]
    refitted = pool.refits(base, chosen, known)
    if present is not None:
        refitted += pool.refits(evaluate(problem, present.causes[:-1]), chosen, known)
    refitted += [*also, *([present] if present is not None else [])]
    refitted = [
        one
        for one in refitted
        if not on_a_bound(problem, one, -1) and _is_there(problem, one.causes[-1])
    ]
    members = []
    for one in refitted:
        evidence, gained = evidence_of(problem, one, base, settings.prior_scales)
        members.append(Member(one, evidence, pool.log_prior(one.causes[-1]), gained=gained))
    return posterior_of(base, members)


def _is_there(problem: Problem, cause: Cause) -> bool:
    """Return whether there is anything of a fitted cause, or, of a dense one, may be as well."""
    return is_nuisance(cause) or not is_nothing(problem, cause)


def _promising(
    pool: CandidatePool, screened: Sequence[Screened], least: float = 0.0
) -> list[Screened]:
    """Return what the linear problem finds more probable than `least` in noise of known power, in ln."""
    return [item for item in screened if item.likelihood + pool.log_prior(item.cause) > least]
