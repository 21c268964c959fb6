# SPDX-License-Identifier: Apache-2.0
"""
Causes that are said to repeat along the way, where no log goes far enough to show it.

Over a small part of its period a cosine is a constant and a sine a straight line: an eccentricity of an
encoder is then what an offset between two encoders is, or an error of scale, whose name may be the right
one. That a cause repeats, which is what its name says, is seen only where an axis goes by half a period
P at least,

    max x(t) - min x(t) >= P / 2    in one log.

Where an axis stands, or hunts on the steps of its encoders, no cause that repeats can be told at all,
and none is tried: a shift by a part of a count, whatever makes it, changes when the readings step.

Limits: half a period is where a cosine comes from its top to its bottom, chosen, not derived; of a cause
with harmonics the fundamental is asked. Logs are not joined: an incremental encoder may count from
elsewhere in each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_twin.effects.places import length_unit, motor_ratio
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.machine import MOTOR_ENCODER, POSITION_ENCODER
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import Cause, Problem

LEAST_SHARE = 0.5
"""Share of its period that an axis has to go."""

STANDS = 8.0
"""Counts that an axis which stands goes at most; on the steps of an encoder it hunts over two."""


@dataclass(frozen=True)
class Unrepeated:
    """A cause that repeats `after` a length, of which no log has more than `seen`, m or rad."""

    cause: Cause
    after: float
    seen: float
    unit: str

    def __str__(self) -> str:
        """Return what that means."""
        return (
            f'{self.cause.name}: it would repeat every {self.after:.3g} {self.unit}, but no log goes '
            f'further than {self.seen:.2g} {self.unit}: another cause may look the same there'
        )


def unrepeated(causes: Sequence[Cause], *logs: Problem) -> list[Unrepeated]:
    """Return the causes that repeat after a length of which no log has enough to show it."""
    result = []
    for cause in causes:
        variant = logs[0].nominal
        after = cause.effect.repeats_after(variant, cause.axis, cause.values)
        travels = [travel(variant, cause.axis, plant) for part in logs for plant in part.plants]
        seen = max(travels, default=0.0)
        if seen < LEAST_SHARE * after:
            result.append(Unrepeated(cause, after, seen, length_unit(variant, cause.axis)))
    return result


def can_repeat(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause does not repeat along the way, or its axis goes any way at all."""
    if not cause.effect.repeats_after(problem.nominal, cause.axis, cause.values):
        return True
    encoders = {MOTOR_ENCODER[cause.axis], POSITION_ENCODER[cause.axis]}
    return any(
        float(np.ptp(plant.measured(name))) > STANDS
        for plant in problem.plants
        for name in encoders.intersection(plant.channels)
    )


def travel(variant: Variant, axis: str, plant: PlantBlock) -> float:
    """Return how far an axis goes in a log, m or rad, by its encoder or by that of its motor."""
    ratios = {MOTOR_ENCODER[axis]: motor_ratio(variant, axis), POSITION_ENCODER[axis]: 1.0}
    encoders = variant.description.encoders
    found = [
        float(np.ptp(plant.measured(name))) / abs(encoders[name].counts_per_unit) / ratio
        for name, ratio in ratios.items()
        if name in plant.channels
    ]
    return max(found, default=0.0)
