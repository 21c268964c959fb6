# SPDX-License-Identifier: Apache-2.0
"""
Causes that change single bits of the controller's output, which follows from its input to the last bit.

A filter of a third of a thousandth of a cycle in a controller changes its output by a bit in one cycle
of twenty, and a little less of it changes nothing: the likelihood has no slope there, and a linear
estimate is off by its own size. But the share of cycles whose output is another falls towards the right
value, and is zero there. So along the direction of the estimate the size with the fewest differing
cycles is taken, and there a fit begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of
from waferbot_twin.residuals.problem import CONTROLLER, Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

SIZES = tuple(np.geomspace(0.2, 4000.0, 996))
"""
Times the linear estimate at which a cause is tried, 1 % apart: a few bits fit only so much. Where few
cycles differ the estimate says little: with 43 of about 2250 it was 670 times too small.
"""

FEW = 0.5
"""Share of a controller's cycles that differ from which on a fit finds its way by itself."""

FINEST, COARSER = 0.001, 1.1
"""
First share of a parameter by which it is moved to see if another bit differs, and the ratio of the next.
"""


def acts_on_bits_alone(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause changes nothing but the controller, which calculates in whole numbers."""
    return problem.touched(cause.effect, cause.axis) == (CONTROLLER,)


def cycles_that_differ(problem: Problem, causes: Sequence[Cause], axis: str) -> int:
    """Return in how many cycles an axis' controller does something else than the model with causes."""
    left = problem.residuals(apply_all(problem.nominal, causes), CONTROLLER)
    return _differing(_of_axis(problem, left, axis))


def same_bits(problem: Problem, found: Hypothesis, place: int) -> Array:
    """
    Return how far each parameter of `causes[place]` can go, alone, before more cycles differ: (k,).

    The longer of both ways; a controller has coefficients of so many bits, and between two of them
    nothing can be told. Zero for a cause that does not act on these bits alone.
    """
    causes, cause = found.causes, found.causes[place]
    parameters = parameters_of(problem, cause)
    widths = np.zeros(len(parameters))
    if not acts_on_bits_alone(problem, cause):
        return widths
    least = _differing(_of_axis(problem, found.residuals[CONTROLLER], cause.axis))

    def same(item: Parameter, step: float) -> bool:
        value = cause.values[item.name] + step
        moved = cause.with_values({item.name: value})
        every = (*causes[:place], moved, *causes[place + 1 :])
        try:
            return (
                item.low <= value <= item.high
                and cycles_that_differ(problem, every, cause.axis) <= least
            )
        except UserError:
            return False

    for number, item in enumerate(parameters):
        size = abs(cause.values[item.name] - (0.0 if item.shape else item.neutral))
        for sign in (-1.0, 1.0):
            share = FINEST
            while share < 1.0 and same(item, sign * share * size):
                share *= COARSER
            if share > FINEST:
                widths[number] = max(widths[number], share * size)
    return widths


def left_of_bits(problem: Problem, causes: Sequence[Cause], axis: str) -> float:
    """Return what an axis' controller does otherwise than the model, in all, in noise floors."""
    left = problem.residuals(apply_all(problem.nominal, causes), CONTROLLER)
    channels = zip(problem.noises(CONTROLLER), left, problem.channels(CONTROLLER), strict=True)
    return sum(
        float(np.sum(np.abs(one))) / noise.floor
        for noise, one, channel in channels
        if channel.axis == axis
    )


def _of_axis(problem: Problem, residuals: Sequence[Array], axis: str) -> list[Array]:
    channels = problem.channels(CONTROLLER)
    return [one for channel, one in zip(channels, residuals, strict=True) if channel.axis == axis]


def _differing(channels: Sequence[Array]) -> int:
    return sum(int(np.count_nonzero(channel)) for channel in channels)


def with_fewest_differences(
    problem: Problem, base: Hypothesis, start: Cause, times: Callable[[float], Cause]
) -> Cause:
    """
    Return a cause in the size in which the fewest cycles differ beside the causes of `base`.

    `times` gives the cause in a size that is so many times the estimate. It is returned as it starts
    where none is better, or where more than `FEW` of the axis' cycles differ without it and with it.

    Raises `UserError` if the simulation blows up.
    """
    of_axis = _of_axis(problem, base.residuals[CONTROLLER], start.axis)
    fewest, best = cycles_that_differ(problem, (*base.causes, start), start.axis), start
    if min(_differing(of_axis), fewest) > FEW * sum(map(len, of_axis)):
        return start
    for size in SIZES:
        if not fewest:
            break
        tried = times(size)
        differing = cycles_that_differ(problem, (*base.causes, tried), start.axis)
        if differing < fewest:
            fewest, best = differing, tried
    return best
