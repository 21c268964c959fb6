# SPDX-License-Identifier: Apache-2.0
"""
How large an effect is, and how much of it has a given size.

Size is the RMS change of the measured signals over the smallest that any test could detect at that
noise, s sqrt(ln N / N), with N samples of standard deviation s. Coloured noise is whitened first:
the change d that the effect makes in the residual of each block and channel goes through the
prediction-error filter A of what the *true* model leaves there, whose white noise has the deviation s,

    size^2 = sum over blocks and channels of sum ((A d) / s)^2 / ln N .

That is 2 ln L of the true model over the nominal one, at the noise of the true one and in the mean, over
ln N: what one more parameter has to pay. Two encoders of one axis are whitened as a pair, so that what
both of them see counts once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.noise_model.prediction_error import prediction_errors
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

CLOSE = 1.15
"""A size within this ratio of the one wanted will do."""

EVALUATIONS = 18

VANISHING, LEFT = 0.1, 0.5
"""At this share of its scale an effect must be left with less than this share of its size."""

NOTHING = 1e-9
"""Scale below which there is nothing of an effect but what makes room for it in the machine."""


class OutOfReach(UserError):
    """No magnitude within the bounds of the effect has the size wanted on this motion."""


class NeverNeutral(OutOfReach):
    """The size does not go to zero with the effect, so that it says nothing about the effect."""


def size_of_change(changes: Iterable[Array], samples: int) -> float:
    """Return the size of changes (N,) of all channels: filtered, in deviations of their white noise."""
    energy = sum(float(change @ change) for change in changes)
    return math.sqrt(energy / math.log(samples))


def size(problem: Problem, causes: Sequence[Cause]) -> float:
    """Return the size of causes that are in the logs of `problem`; raises `UserError`."""
    return _size_without(problem, evaluate(problem, tuple(causes)), problem.nominal)


def sizes_of_each(problem: Problem, causes: Sequence[Cause]) -> list[float]:
    """
    Return the size of each of several causes that are in the logs of `problem` at once.

    That of the change which taking out this one alone makes, the others in place: an effect that
    another one hides is as small as it looks. Raises `UserError`.
    """
    true = evaluate(problem, tuple(causes))
    return [
        _size_without(
            problem, true, apply_all(problem.nominal, [*causes[:own], *causes[own + 1 :]])
        )
        for own in range(len(causes))
    ]


def _size_without(problem: Problem, true: Hypothesis, less: Variant) -> float:
    """Return the size of what a model lacks of the true one; raises `UserError`."""
    changes: list[Array] = []
    for block, after in true.residuals.items():
        before = problem.residuals(less, block)
        changes += prediction_errors(
            true.fits[block], [one - other for one, other in zip(before, after, strict=True)]
        )
    return size_of_change(changes, true.samples)


def scale_of_size(
    size_at: Callable[[float], float], wanted: float, largest: float
) -> tuple[float, float]:
    """
    Return the scale at which an effect has the size wanted, and the size that it has there.

    `size_at(scale)` grows with the scale, from zero; it raises `UserError` where the machine is
    unstable. Where it grows in steps the result is the smallest scale found whose size is at least
    the one wanted. Raises `OutOfReach`.
    """
    scale, found = _search(size_at, wanted, largest)
    if scale < NOTHING or size_at(VANISHING * scale) > LEFT * found:
        raise NeverNeutral(f'its size is {found:.3g} however little there is of it')
    return scale, found


def _search(
    size_at: Callable[[float], float], wanted: float, largest: float
) -> tuple[float, float]:
    """Return the scale of the size wanted and that size: a bracket that closes in on it."""
    low, high = (0.0, 0.0), (math.inf, math.inf)
    scale = min(1.0, largest)
    for _ in range(EVALUATIONS):
        try:
            found = size_at(scale)
        except UserError:
            found = math.inf
        if wanted / CLOSE <= found <= wanted * CLOSE:
            return scale, found
        if found > wanted:
            high = (scale, found)
        else:
            low = (scale, found)
        if low[0] >= largest or high[0] < 1.02 * low[0]:
            break
        scale = min(_between(low, high, wanted), largest)
    if not math.isfinite(high[1]):
        raise OutOfReach(f'size {wanted:g} is out of reach')
    return high


def _between(low: tuple[float, float], high: tuple[float, float], wanted: float) -> float:
    """
    Return the next scale between two points (scale, size).

    A power law through both if both show the effect, proportional to the one that does, else the
    geometric mean; never so close to an end that little would be learnt.
    """
    if high[0] == math.inf:
        return low[0] * (min(1.2 * wanted / low[1], 30.0) if low[1] > 0.0 else 30.0)
    if low[0] == 0.0:
        return high[0] * (max(wanted / high[1], 1.0 / 30.0) / 1.2 if high[1] < math.inf else 0.1)
    width = math.log(high[0] / low[0])
    share = 0.5
    if low[1] > 0.0 and high[1] < math.inf:
        share = math.log(wanted / low[1]) / math.log(high[1] / low[1])
    return low[0] * math.exp(min(max(share, 0.15), 0.85) * width)
