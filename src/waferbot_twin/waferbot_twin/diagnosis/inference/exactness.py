# SPDX-License-Identifier: Apache-2.0
"""
Blocks that follow from their inputs to the last bit: what is left over there refutes what was found.

A controller or an amplifier has no noise. With all that is wrong in it corrected, nothing is left over
but rounding. So where something plainly is left over on an axis (`Problem.plain_axes`), the model with
the causes found there is not true, however much they explain: something is not in the library, and one
that stands in for a part of it cannot be told from a true one beside it. Causes that show in such blocks
alone are then as likely as not.
"""

from __future__ import annotations

from dataclasses import replace

from waferbot_twin.diagnosis.inference.posterior_odds import log_odds_at
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Posterior, with_odds
from waferbot_twin.residuals.problem import PRIOR, Problem


def inexact(problem: Problem, posterior: Posterior) -> list[tuple[str, str]]:
    """Return block and axis where something is left over that no noise can be."""
    return [
        (block, axis)
        for block in problem.exact_blocks
        for axis in sorted(problem.plain_axes(block, posterior.found.residuals[block]))
    ]


def as_likely_as_not_where_inexact(
    problem: Problem, posterior: Posterior, settings: Settings
) -> Posterior:
    """Return a posterior without names for causes of blocks that are not explained to the last bit."""
    left = set(inexact(problem, posterior))
    even = log_odds_at(settings.included_from)
    effects = []
    for cause, effect in zip(posterior.found.causes, posterior.effects, strict=True):
        blocks = [name for name in problem.touched(cause.effect, cause.axis) if name != PRIOR]
        stands_in = bool(blocks) and all((name, cause.axis) in left for name in blocks)
        effects.append(with_odds(effect, even) if stands_in else effect)
    return replace(posterior, effects=tuple(effects))
