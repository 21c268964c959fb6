# SPDX-License-Identifier: Apache-2.0
"""
Backward elimination of what noise feigns: the causes that the command does not show.

What another cause leaves over goes with the command, too. So it is asked last, when no further cause is
found. The least odds of `instrument`, equation (2), go first, the others are fitted anew without that
cause and judged again, until none is less probable than not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, Judged
from waferbot_twin.diagnosis.inference.elimination import log_odds_at
from waferbot_twin.diagnosis.inference.instrument import (
    GivingWay,
    instrumented_gain,
    log_odds_beside_noise,
    noise_free_logs,
    signatures_in,
)
from waferbot_twin.diagnosis.inference.refit import with_last, without
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect, with_odds
from waferbot_twin.estimation.conditional import others_without
from waferbot_twin.estimation.evidence import log_evidence
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.stacked_least_squares import Signature
from waferbot_twin.residuals.problem import Cause, Problem


def without_feigned(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> tuple[Hypothesis, list[SingleEffect], list[str]]:
    """
    Return a hypothesis without what noise feigns, its effects, and the names of what went.

    Effects are as sure as noise leaves them where nothing went, else as before: more may be found then,
    and they are judged again.
    """
    limit = log_odds_at(pool.settings.included_from)
    left, gone = list(effects), list[str]()
    while True:
        judged = _judged(pool, found, left)
        least = min(judged, key=lambda effect: effect.log_odds, default=None)
        if least is None or least.log_odds >= limit:
            return found, left if gone else judged, gone
        name = least.best.cause.name
        gone.append(name)
        left = [effect for effect in left if effect.best.cause.name != name]
        names = [cause.name for cause in found.causes]
        known = dict(zip(names, pool.signatures_of(found), strict=True))
        found = without(pool.problem, found, [name], pool.workers, known)


def _judged(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> list[SingleEffect]:
    """Return effects with their odds beside what noise may feign; as they are where none is known."""
    noise_free: list[Problem] = []
    in_noise_free: list[Sequence[Signature]] = []
    for logs in noise_free_logs(pool.problem, found) if effects else ():
        try:
            in_noise_free.append(signatures_in(logs, found, pool.workers))
        except UserError:  # the model does not stand in these motions
            continue
        noise_free.append(logs)
    if not noise_free:
        return list(effects)
    known = pool.judged(found)
    # To send so many signatures to another process takes as long as to judge a cause: once to each.
    parts = [effects[first :: pool.workers] for first in range(min(pool.workers, len(effects)))]
    tasks = (
        delayed(_log_odds_of)(
            known,
            found,
            [(one.best.cause.name, one.log_odds) for one in part],
            noise_free,
            in_noise_free,
        )
        for part in parts
    )
    pool.progress('what noise feigns', 0, len(effects))
    odds = dict(item for part in Parallel(n_jobs=pool.workers)(tasks) for item in part)
    judged = [(effect, odds[effect.best.cause.name]) for effect in effects]
    return [one if value == one.log_odds else with_odds(one, value) for one, value in judged]


def _log_odds_of(
    known: Judged,
    found: Hypothesis,
    asked: Sequence[tuple[str, float]],
    noise_free: Sequence[Problem],
    in_noise_free: Sequence[Sequence[Signature]],
) -> list[tuple[str, float]]:
    """Return names of some causes with `_log_odds` of each, asked with those by the logs."""
    return [
        (name, _log_odds(known, found, name, by_logs, noise_free, in_noise_free))
        for name, by_logs in asked
    ]


def _log_odds(
    known: Judged,
    found: Hypothesis,
    name: str,
    by_logs: float,
    noise_free: Sequence[Problem],
    in_noise_free: Sequence[Sequence[Signature]],
) -> float:
    """
    Return ln of the odds of a cause beside what noise may feign, those by the logs if none are known.

    `in_noise_free` is what the causes of `found` change in the noise-free logs. Of the model without the
    cause as it comes where the linear problem says; where that would take the name away, as the linear
    problem has it: far away a machine does other things. Noise feigns what both say.
    """
    problem = known.problem
    more = with_last(problem, found, name)
    others = more.causes[:-1]
    prior = known.log_prior(more.causes[-1])

    def beside(there: tuple[Cause, ...], giving_way: GivingWay | None = None) -> float | None:
        gained = instrumented_gain(problem, more, there, noise_free, giving_way)
        if gained is None:
            return None
        base = replace(more, causes=there)
        evidence = log_evidence(problem, more, base, known.settings.prior_scales, gained)
        return log_odds_beside_noise(by_logs, evidence + prior, prior)

    odds = beside(others_without(problem, more, {name}))
    if odds is not None and odds > log_odds_at(known.settings.named_from):
        return odds
    of_others, *of_others_there = (
        [one for one, cause in zip(some, found.causes, strict=True) if cause.name != name]
        for some in (known.signatures_of(found), *in_noise_free)
    )
    again = beside(others, GivingWay.of(problem, others, of_others, of_others_there))
    told = [one for one in (odds, again) if one is not None]
    return max(told, default=by_logs)
