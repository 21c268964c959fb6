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

from collections.abc import Callable

import numpy as np

from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.problem import CONTROLLER, Cause, Problem, apply_all

SIZES = tuple(np.geomspace(0.2, 4000.0, 996))
"""
Times the linear estimate at which a cause is tried, 1 % apart: a few bits fit only so much. Where few
cycles differ the estimate says little: with 43 of about 2250 it was 670 times too small.
"""

FEW = 0.5
"""Share of a controller's cycles that differ from which on a fit finds its way by itself."""


def acts_on_bits_alone(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause changes nothing but the controller, which calculates in whole numbers."""
    return problem.touched(cause.effect, cause.axis) == (CONTROLLER,)


def with_fewest_differences(
    problem: Problem, base: Hypothesis, start: Cause, times: Callable[[float], Cause]
) -> Cause:
    """
    Return a cause in the size in which the fewest cycles differ beside the causes of `base`.

    `times` gives the cause in a size that is so many times the estimate. It is returned as it starts
    where none is better, or where more than `FEW` of the axis' cycles differ without it and with it.

    Raises `UserError` if the simulation blows up.
    """
    every = zip(problem.channels(CONTROLLER), base.residuals[CONTROLLER], strict=True)
    of_axis = [residual for channel, residual in every if channel.axis == start.axis]
    without = sum(int(np.count_nonzero(residual)) for residual in of_axis)
    fewest, best = _differing(problem, base, start), start
    if min(without, fewest) > FEW * sum(map(len, of_axis)):
        return start
    for size in SIZES:
        if not fewest:
            break
        tried = times(size)
        differing = _differing(problem, base, tried)
        if differing < fewest:
            fewest, best = differing, tried
    return best


def _differing(problem: Problem, base: Hypothesis, cause: Cause) -> int:
    """Return in how many samples of its blocks a model with a cause differs from the logs."""
    variant = apply_all(problem.nominal, (*base.causes, cause))
    return sum(
        int(np.count_nonzero(channel))
        for block in problem.touched(cause.effect, cause.axis)
        for channel in problem.residuals(variant, block)
    )
