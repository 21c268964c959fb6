# SPDX-License-Identifier: Apache-2.0
"""
The flexible model beside the one that was found: all that is held rigid gives as described.

A machine is flexible in many places in series, and its resonances are those of all of them together:
with any one missing the others ring wrongly and explain little. So forward selection, which adds one
cause after the other, may never come there, and what rings goes into frictions and inertias. In the
demonstration's logs it ended with 21 causes, 77 % of Y-Linear's closed-loop error left and seven
compliances of the machine unasked for; as described these gained 1660 in ln L at once, and fitted 7200.
"""

from __future__ import annotations

from collections.abc import Sequence

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, signatures_by_name
from waferbot_twin.diagnosis.inference.forward_selection import (
    as_fitted,
    log_odds_between,
    some_of_each,
)
from waferbot_twin.diagnosis.inference.nuisance import each_once
from waferbot_twin.diagnosis.inference.refit import ROUGHLY, fitted
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect
from waferbot_twin.estimation.hypothesis import Hypothesis


def or_flexible(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> tuple[Hypothesis, list[SingleEffect], list[SingleEffect]]:
    """
    Return the model that was found, or with it all that it holds rigid, whichever is more probable.

    Fitted from where each connection is as its description has it (`CandidatePool.parts_that_may_give`).
    What came so is `tentative`: it stays if it is evident beside all others.
    """
    problem = pool.problem
    there = {cause.name for cause in found.causes}
    parts = [cause for cause in pool.parts_that_may_give() if cause.name not in there]
    same = found, list(effects), list(tentative)
    if not parts:
        return same
    pool.progress('flexible model', 0, 1)
    flexible = fitted(
        problem,
        each_once(problem, (*found.causes, *parts)),
        pool.workers,
        near=found,
        begun=signatures_by_name(pool, found),
        roughly=ROUGHLY,
    )
    if flexible is None:
        return same
    flexible, own, along = some_of_each(problem, flexible, effects, tentative)
    if log_odds_between(pool, flexible, found) <= 0.0:
        return same
    new = [as_fitted(pool, flexible, one) for one in flexible.causes if one.name not in there]
    return flexible, own, [*along, *new]
