# SPDX-License-Identifier: Apache-2.0
"""
Which effects a search is offered: the library's, with what the logs themselves show of their sizes.

A fit could not find these: the step of a coarse encoder, a limit that commands have reached, the orders
of a motor's cogging, play between two encoders explain nothing as soon as they are a little wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_twin.diagnosis.proposals.coarseness import coarser_steps
from waferbot_twin.diagnosis.proposals.cogging_orders import measured_by_others, orders_of
from waferbot_twin.diagnosis.proposals.folded_back import folded_back
from waferbot_twin.diagnosis.proposals.play import gaps_of
from waferbot_twin.effects import (
    backlash,
    coarse_quantisation,
    cogging,
    i2t_foldback,
    library,
    output_limit,
    places,
)
from waferbot_twin.effects.effect import Effect
from waferbot_twin.residuals.problem import Problem


def offered_effects(problem: Problem, without: Sequence[str]) -> list[Effect]:
    """Return the effects to look for: the library's, with the sizes that the logs show themselves."""
    effects = {name: [effect] for name, effect in library().items()}
    effects[cogging.NAME] += _cogging_of_imported_logs(problem)
    steps = coarser_steps(problem.nominal, problem.records)
    effects[coarse_quantisation.NAME] = [coarse_quantisation.with_steps(steps)] if steps else []
    gaps = gaps_of(problem.nominal, problem.records)
    effects[backlash.NAME] += [backlash.with_gaps(gaps)] if gaps else []
    effects[output_limit.NAME] += limited_commands(problem)
    effects[i2t_foldback.NAME] += folded_back(problem)
    return [item for name, found in effects.items() if name not in without for item in found]


def limited_commands(problem: Problem) -> list[Effect]:
    """Return the output limit, each axis tried with the largest command that was given there."""
    limits = {}
    for axis in output_limit.EFFECT.axes(problem.nominal):
        own = [
            record.command[:, record.layout.place(axis)]
            for record in problem.records
            if record.command is not None
        ]
        per_bit = places.current_per_bit(problem.nominal, axis)
        bits = np.round(np.abs(np.concatenate(own or [np.zeros(1)])) / per_bit)
        largest = float(np.max(bits, initial=0.0, where=np.isfinite(bits)))
        (limit,) = output_limit.EFFECT.parameters(problem.nominal, axis)
        if limit.low <= largest < limit.neutral:
            limits[axis] = largest
    return [output_limit.with_limits(limits)] if limits else []


def _cogging_of_imported_logs(problem: Problem) -> list[Effect]:
    """
    Return cogging with the orders that imported logs show; of a motor that nobody knows so far.

    The twin's own machine has the orders that the library tries.
    """
    imported = measured_by_others(problem)
    return [cogging.with_orders(orders_of(problem.nominal, imported))] if imported else []
