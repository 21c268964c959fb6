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

from waferbot_twin.diagnosis.inference.as_a_whole import or_instead
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.forward_selection import Found
from waferbot_twin.diagnosis.inference.nuisance import is_damping
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect
from waferbot_twin.estimation.hypothesis import Hypothesis


def or_flexible(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> Found:
    """
    Return the model that was found, or with it all that it holds rigid, whichever is more probable.

    Fitted from where each connection is as its description has it (`CandidatePool.parts_that_may_give`),
    its damping too. What came so is tentative.
    """
    there = {cause.name for cause in found.causes}
    parts = [cause for cause in pool.parts_that_may_give() if cause.name not in there]
    if not parts:
        return found, list(effects), list(tentative)
    beside = pool.dense_beside((*found.causes, *parts))
    dampings = [cause for cause in beside if is_damping(cause)]
    pool.progress('flexible model', 0, 1)
    return or_instead(pool, found, effects, tentative, (*found.causes, *parts, *dampings))
