# SPDX-License-Identifier: Apache-2.0
"""A set of causes, and how well the model with them explains the logs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.stacked_least_squares import by_channel
from waferbot_twin.noise_model.prediction_error import Fit, log_likelihoods_with
from waferbot_twin.residuals.problem import PLANT, Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

PROBE = 0.1
"""Share of an effect's typical value with which its signature is found, before a fit."""

NARROW = 0.002
"""Width of a narrow parameter, as a share of its value."""


@dataclass
class Hypothesis:
    """
    A set of causes: residuals and likelihood by block, covariance (k, k) of all their parameters.

    And the curvature (k, k) with which they were fitted, A' A of white signatures and the precision
    of their prior: the inverse of the covariance if all noise were as assumed. Both empty before a fit.
    `promised` is by how much more probable, in ln, other values may be by the linear problem.
    """

    causes: tuple[Cause, ...]
    residuals: dict[str, list[Array]]
    fits: dict[str, Fit]
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    curvature: Array = field(default_factory=lambda: np.zeros((0, 0)))
    promised: float = math.inf

    @property
    def log_likelihood(self) -> float:
        """The sum over all blocks."""
        return sum(item.log_likelihood for item in self.fits.values())

    @property
    def samples(self) -> int:
        """Samples of all channels."""
        return sum(item.samples for item in self.fits.values())


def log_likelihood_ratio(
    this: Hypothesis, other: Hypothesis, blocks: Iterable[str] | None = None
) -> float:
    """
    Return ln L of `this` less that of `other`, both of the same problem, in some blocks or in all,

        max over n of ln L(r_this; n) - max over n of ln L(r_other; n),  n in {n_this, n_other},   (1)

    n_this and n_other the noise models of their residuals. The spectrum of noise is that of what does
    not go with the motion (`noise_model.variance_components`), so it is not the one with which the
    residual is most likely. With each its own, a model would win by what it makes of the noise: where it
    leaves more at low frequencies, a larger slow noise is found, and that suits either residual better.
    Antisymmetric.
    """
    return sum(
        sum(log_likelihood_ratios(this, other, block))
        for block in (this.fits if blocks is None else blocks)
    )


def log_likelihood_ratios(this: Hypothesis, other: Hypothesis, block: str) -> list[float]:
    """
    Return equation (1) of a block channel by channel.

    Each channel has noise of its own, so each has its own choice; two that are one process (`Noise`)
    have one together.
    """
    both = this.fits[block], other.fits[block]
    if both[0] is both[1]:
        return [0.0] * len(both[0].colours)
    noises = both[0].noises
    firsts = np.array([min(place, place + one.beside) for place, one in enumerate(noises)])

    def most_likely(item: Hypothesis) -> Array:
        with_each = np.array(
            [log_likelihoods_with(fit.colours, item.residuals[block]) for fit in both]
        )
        together = np.array([np.bincount(firsts, own, len(firsts)) for own in with_each])
        return np.asarray(with_each[together.argmax(axis=0)[firsts], np.arange(len(firsts))])

    return [float(value) for value in most_likely(this) - most_likely(other)]


def evaluate(problem: Problem, causes: tuple[Cause, ...] = (), workers: int = 1) -> Hypothesis:
    """
    Return the model with these causes as they are, so many logs simulated at a time.

    Raises `UserError` if it blows up.
    """
    variant = apply_all(problem.nominal, causes)
    residuals = {
        block: problem.residuals(variant, block, workers)
        for block, parts in problem.blocks.items()
        if parts
    }
    return Hypothesis(causes, residuals, problem.judge(residuals))


def lets_go(problem: Problem, causes: tuple[Cause, ...], rival: Cause) -> bool:
    """
    Return whether with one more cause a connection gives that is rigid beside some causes.

    The machine is another one then, and an observer follows more of it.
    """
    before, after = (
        apply_all(problem.nominal, some).description.connections
        for some in (causes, (*causes, rival))
    )
    return any(item.flexible and not before[name].flexible for name, item in after.items())


NEXT_TO_NONE = 1e-6
"""Share of a typical size that does nothing by itself."""


def with_next_to_none(problem: Problem, hypothesis: Hypothesis) -> Hypothesis | None:
    """
    Return a hypothesis with next to none of its last cause, if a part lets go for that; else None.

    A gap, a slip or an error of teeth needs a spring that carries it, where the model is rigid. What
    that spring does alone is no work of the cause.
    """
    *others, last = hypothesis.causes
    if not lets_go(problem, tuple(others), last):
        return None
    sizes = {
        item.name: item.neutral + NEXT_TO_NONE * (item.typical - item.neutral)
        for item in parameters_of(problem, last)
        if not item.shape
    }
    try:
        return evaluate(problem, (*others, last.with_values(sizes)))
    except UserError:
        return None


def in_quick_steps(problem: Problem, base: Hypothesis) -> tuple[Problem, Hypothesis]:
    """
    Return a problem and a hypothesis in longer steps of the plant, to find what causes change.

    Only its residuals are those of the longer steps. Both are returned as they are if the plant blows up
    so.
    """
    quick = problem.quick()
    if PLANT not in base.residuals:
        return problem, base
    try:
        left = quick.residuals(apply_all(problem.nominal, base.causes), PLANT)
    except UserError:
        return problem, base
    return quick, replace(base, residuals={**base.residuals, PLANT: left})


def parameters_of(problem: Problem, cause: Cause) -> tuple[Parameter, ...]:
    """Return the parameters of a cause that are to be fitted."""
    return tuple(
        item
        for item in cause.effect.parameters(problem.nominal, cause.axis)
        if item.name not in cause.held
    )


def away_from_bounds(problem: Problem, causes: Iterable[Cause]) -> Array:
    """
    Return which way each parameter (k,) of fitted causes can move, in the order of the causes.

    1 from its lowest value upwards, -1 from its highest downwards, 0 either way.
    """
    return np.array(
        [
            float(cause.values[item.name] <= item.low)
            - float(cause.values[item.name] >= item.high)
            for cause in causes
            for item in parameters_of(problem, cause)
        ]
    )


def is_nothing(problem: Problem, cause: Cause) -> bool:
    """Return whether there is nothing of a cause: all its sizes are those of the model without it."""
    return all(
        item.shape or cause.values[item.name] == item.neutral
        for item in cause.effect.parameters(problem.nominal, cause.axis)
    )


def signature(
    problem: Problem,
    hypothesis: Hypothesis,
    causes: tuple[Cause, ...],
    place: int,
    errors: Array | None = None,
) -> dict[str, Array]:
    """
    Return what the parameters of `causes[place]` change in the residuals, block by block.

    Arrays have the shape (samples of all channels, parameters), per unit of the parameter. A shape
    parameter of an effect that is not there changes nothing, nor does one in a block that does not read
    where it stands: a column of zeros, without simulating.

    With `errors` (k,), how far each parameter must move, the others where they are, for the logs to show
    it (`estimation.conditional`), slopes are those over that way. Over a longer one a machine that
    sticks and slips does another thing: a fit with such slopes ends where the likelihood still rises.

    A fit may end where a part just carries what it has to, and the step then leads to no machine: the
    slope is that on the other side. Raises `UserError` if there is none, either.
    """
    cause, here = causes[place], apply_all(problem.nominal, causes)
    absent = is_nothing(problem, cause)

    def slopes(item: Parameter, step: float) -> dict[str, Array]:
        moved = cause.with_values({item.name: cause.values[item.name] + step})
        variant = apply_all(problem.nominal, (*causes[:place], moved, *causes[place + 1 :]))
        differing = () if absent and item.shape else problem.between(here, variant)
        columns = {}
        for block in problem.touched(cause.effect, cause.axis):
            before = np.concatenate(hypothesis.residuals[block])
            columns[block] = np.zeros_like(before)
            if block in differing:
                after = np.concatenate(problem.residuals(variant, block))
                columns[block] = (after - before) / step
        return columns

    found: dict[str, list[Array]] = {}
    for number, item in enumerate(parameters_of(problem, cause)):
        step = _probe(cause, item, math.inf if errors is None else float(errors[number]))
        try:
            own = slopes(item, step)
        except UserError:
            if not item.low <= cause.values[item.name] - step <= item.high:
                raise
            own = slopes(item, -step)
        for block, column in own.items():
            found.setdefault(block, []).append(column)
    return {block: np.column_stack(columns) for block, columns in found.items()}


def whole_change(
    problem: Problem, hypothesis: Hypothesis, causes: tuple[Cause, ...]
) -> dict[str, Array]:
    """
    Return what the last of `causes` changes in the residuals of a hypothesis without it, by block.

    As a whole, at its values: arrays have the shape (samples of all channels, 1).
    """
    cause, variant = causes[-1], apply_all(problem.nominal, causes)
    return {
        block: (
            np.concatenate(problem.residuals(variant, block))
            - np.concatenate(hypothesis.residuals[block])
        )[:, None]
        for block in problem.touched(cause.effect, cause.axis)
    }


def changed_by(
    problem: Problem, residuals: Mapping[str, list[Array]], change: Mapping[str, Array]
) -> Hypothesis:
    """
    Return what residuals by block are with a change (`whole_change`), in the noise that is left then.

    Blocks that do not change are left out, and so are causes: there are none to be fitted.
    """
    left = {
        block: [
            one + part[:, 0]
            for one, part in zip(
                residuals[block], by_channel(matrix, residuals[block]), strict=True
            )
        ]
        for block, matrix in change.items()
    }
    return Hypothesis((), left, problem.judge(left))


def width_of(cause: Cause, item: Parameter) -> float:
    """
    Return how far it is usual to move a parameter: from neutral to typical.

    Where these are the same (of most shapes), its typical value; where that is nothing, a tenth of what
    is possible. A narrow one moves by a share of its value,
    unless a fit has brought it to zero.
    """
    if item.name in cause.narrow and cause.values[item.name] != 0.0:
        return NARROW * abs(cause.values[item.name])
    return abs(item.typical - item.neutral or item.typical or 0.1 * (item.high - item.low))


def _probe(cause: Cause, item: Parameter, error: float) -> float:
    """Return the step of a finite difference, away from the nearer bound."""
    value = cause.values[item.name]
    step = max(min(PROBE * width_of(cause, item), error), item.resolution)
    return step if item.low <= value + step <= item.high else -step


def standard_errors(hypothesis: Hypothesis) -> Array:
    """Return the standard error of every parameter, in the order of the causes."""
    return np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
