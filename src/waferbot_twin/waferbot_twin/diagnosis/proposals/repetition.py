# SPDX-License-Identifier: Apache-2.0
"""
Causes that are said to repeat along the way, where no log goes any way.

Where an axis stands, or hunts on the steps of its encoders, no cause that repeats can be told at all,
and none is tried: a shift by a part of a count, whatever makes it, changes when the readings step. And
a period that is none of those that a machine is known to have (teeth, poles, a turn), because it is
fitted or because the description has none, must be covered once by a log: a longer one is no period but
a bend, which anything that bends makes.
"""

from __future__ import annotations

import math

import numpy as np

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.residuals.problem import Cause, Problem

STANDS = 8.0
"""Counts that an axis which stands goes at most; on the steps of an encoder it hunts over two."""


def can_repeat(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause does not repeat along the way, or its axis goes any way at all."""
    if not cause.effect.repeats_after(problem.nominal, cause.axis, cause.values):
        return True
    encoders = set(problem.nominal.layout.encoders_of(cause.axis))
    return any(
        float(np.ptp(plant.measured(name))) > STANDS
        for plant in problem.plants
        for name in encoders.intersection(plant.channels)
    )


def repeats_in(problem: Problem, cause: Cause) -> bool:
    """Return whether a log goes as far as a cause repeats after, if no description has its period."""
    way = cause.effect.repeats_after(problem.nominal, cause.axis, cause.values)
    if not way or all(_known(item, cause) for item in _made(problem, cause)):
        return True
    name = places.position_encoder(problem.nominal, cause.axis)
    per_way = abs(places.axis_counts(problem.nominal, cause.axis))
    travels = [
        float(np.ptp(plant.measured(name))) / per_way
        for plant in problem.plants
        if name in plant.channels
    ]
    return way <= max(travels, default=math.inf)


def _made(problem: Problem, cause: Cause) -> list[Parameter]:
    """Return the parameters of a cause that are given by how the machine was made."""
    every = cause.effect.parameters(problem.nominal, cause.axis)
    return [item for item in every if item.fixed]


def _known(item: Parameter, cause: Cause) -> bool:
    """Return whether the description has a parameter of a cause, and the cause has it from there."""
    return item.name in cause.held and not item.guessed
