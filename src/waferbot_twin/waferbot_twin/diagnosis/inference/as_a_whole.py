# SPDX-License-Identifier: Apache-2.0
"""
Another model as a whole beside the one that was found: many causes at once, which alone are not seen.

Where much lacks, what is left over along any direction is far more than noise, and nothing is evident
beside it. So models are weighed as if the power of the noise were known, as a single cause is that comes
for the time being (`forward_selection`); what came has to be evident in the end (`elimination`).
"""

from __future__ import annotations

from collections.abc import Sequence

from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool, signatures_by_name
from waferbot_twin.diagnosis.inference.forward_selection import (
    Found,
    as_fitted,
    some_of_each,
)
from waferbot_twin.diagnosis.inference.nuisance import each_once
from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_between
from waferbot_twin.diagnosis.inference.refit import ROUGHLY, fitted
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect
from waferbot_twin.estimation.hypothesis import Hypothesis, log_likelihood_ratio
from waferbot_twin.residuals.problem import Cause


def or_instead(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
    causes: Sequence[Cause],
) -> Found:
    """
    Return the model that was found, or one with other `causes` that is likelier and more probable.

    Fitted roughly from where these are; what `found` does not have is tentative. One that has only fewer
    causes is left to elimination.
    """
    other = fitted(
        pool.problem,
        each_once(pool.problem, causes),
        pool.workers,
        near=found,
        begun=signatures_by_name(pool, found),
        roughly=ROUGHLY,
    )
    if other is None:
        return found, list(effects), list(tentative)
    other, own, along = some_of_each(pool.problem, other, effects, tentative)
    likelier = log_likelihood_ratio(other, found) > 0.0
    if not likelier or log_odds_between(pool, other, found, power_known=True) <= 0.0:
        return found, list(effects), list(tentative)
    there = {cause.name for cause in found.causes}
    new = [as_fitted(pool, other, cause) for cause in other.causes if cause.name not in there]
    return other, own, [*along, *new]
