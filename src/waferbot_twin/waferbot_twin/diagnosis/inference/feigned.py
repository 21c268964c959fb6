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
from waferbot_twin.diagnosis.inference.candidate_pool import (
    CandidatePool,
    Judged,
    signatures_by_name,
)
from waferbot_twin.diagnosis.inference.instrument import (
    GivingWay,
    NoiseFree,
    instrumented_gain,
    log_odds_beside_noise,
    noise_free_logs,
)
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at
from waferbot_twin.diagnosis.inference.refit import with_last, without
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect, with_odds
from waferbot_twin.estimation.conditional import others_without
from waferbot_twin.estimation.evidence import log_evidence
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Cause


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
        judged = beside_noise(pool, found, left)
        least = min(judged, key=lambda effect: effect.log_odds, default=None)
        if least is None or least.log_odds >= limit:
            return found, left if gone else judged, gone
        name = least.best.cause.name
        gone.append(name)
        left = [effect for effect in left if effect.best.cause.name != name]
        known = signatures_by_name(pool, found)
        found = without(pool.problem, found, [name], pool.workers, known)


def beside_noise(
    pool: CandidatePool, found: Hypothesis, effects: Sequence[SingleEffect]
) -> list[SingleEffect]:
    """Return effects with their odds beside what noise may feign; as they are where none is known."""
    noise_free: list[NoiseFree] = []
    for logs in noise_free_logs(pool.problem, found) if effects else ():
        try:
            noise_free.append(NoiseFree.of(logs, found, pool.workers))
        except UserError:  # the model does not stand in these motions
            continue
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
    noise_free: Sequence[NoiseFree],
) -> list[tuple[str, float]]:
    """Return names of some causes with `_log_odds` of each, asked with those by the logs."""
    return [(name, _log_odds(known, found, name, by_logs, noise_free)) for name, by_logs in asked]


def _log_odds(
    known: Judged,
    found: Hypothesis,
    name: str,
    by_logs: float,
    noise_free: Sequence[NoiseFree],
) -> float:
    """
    Return ln of the odds of a cause beside what noise may feign, those by the logs if none are known.

    Of the model without the
    cause as it comes where the linear problem says; where that would take the name away, as the linear
    problem has it: far away a machine does other things. Noise feigns what both say.
    """
    problem = known.problem
    more = with_last(problem, found, name)
    others = more.causes[:-1]
    prior = known.log_prior(more.causes[-1])

    def beside(there: tuple[Cause, ...], giving_way: GivingWay | None = None) -> float | None:
        problems = [logs.problem for logs in noise_free]
        gained = instrumented_gain(problem, more, there, problems, giving_way)
        if gained is None:
            return None
        base = replace(more, causes=there)
        evidence = log_evidence(problem, more, base, known.settings.prior_scales, gained)
        return log_odds_beside_noise(by_logs, evidence + prior, prior)

    odds = beside(others_without(problem, more, {name}))
    if odds is not None and odds > log_odds_at(known.settings.named_from):
        return odds
    of_all = signatures_by_name(known, found)
    of_others = [of_all[cause.name] for cause in others]
    there = [[logs.signatures[cause.name] for cause in others] for logs in noise_free]
    again = beside(others, GivingWay.of(problem, others, of_others, there))
    told = [one for one in (odds, again) if one is not None]
    return max(told, default=by_logs)
