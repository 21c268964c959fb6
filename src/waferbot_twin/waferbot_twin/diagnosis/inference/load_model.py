# SPDX-License-Identifier: Apache-2.0
"""
The model with other loads beside the one that was found: mass, centre of gravity and inertia at once.

Of a load that is another one each axis feels a part: its weight is a constant force where it is lifted,
its imbalance one where it is turned, its inertia is felt about each axis and in each ring. Effects that
are added one after the other take each part by itself, a constant force here and an inertia there, and
none of them gives way alone. In the demonstration's logs they left 7300 in ln L to the true machine; the
loads in their place leave 3800.
"""

from __future__ import annotations

from collections.abc import Sequence

from waferbot_twin.diagnosis.inference.as_a_whole import or_instead
from waferbot_twin.diagnosis.inference.candidate_pool import CandidatePool
from waferbot_twin.diagnosis.inference.forward_selection import Found
from waferbot_twin.diagnosis.inference.single_effects import SingleEffect
from waferbot_twin.effects import load
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import apply_all

WEIGHT, BALANCE = 'constant_force', 'counterweight_mass'
"""Effects by which the weight of a load is felt on another axis, and by which it is balanced there."""


def or_other_loads(
    pool: CandidatePool,
    found: Hypothesis,
    effects: Sequence[SingleEffect],
    tentative: Sequence[SingleEffect],
) -> Found:
    """
    Return the model that was found, or the one with other loads in place of their parts.

    Fitted from where the parts have them (`effects.load.load_of`), with what balances their weight and
    without constant forces; whichever is more probable. What came so is tentative.
    """
    nominal, there = pool.problem.nominal, {cause.name for cause in found.causes}
    loads = [cause for cause in pool.of_effect(load.EFFECT.name) if cause.name not in there]
    parts = {f'{part}:{one.axis}' for one in loads for part in load.PARTS}
    weights = {cause.name for cause in found.causes if cause.effect.name == WEIGHT}
    kept = [cause for cause in found.causes if cause.name not in parts | weights]
    if not loads or len(kept) == len(found.causes):
        return found, list(effects), list(tentative)
    as_found = apply_all(nominal, [cause for cause in found.causes if cause.name in parts])
    loads = [one.with_values(load.load_of(nominal, as_found, one.axis)) for one in loads]
    balances = [cause for cause in pool.of_effect(BALANCE) if cause.name not in there]
    pool.progress('other loads', 0, 1)
    return or_instead(pool, found, effects, tentative, (*kept, *loads, *balances))
