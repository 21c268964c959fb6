# SPDX-License-Identifier: Apache-2.0
"""
From residuals to causes: screen every effect, fit the likely ones, let another motion decide.

1. **Screen.** The signature of an effect is what it changes in the residuals, found by simulating the
   block with a little of it: S = (e(theta + d) - e(theta)) / d. All effects on all axes are fitted to
   the residuals one by one, linearly, with coloured noise (`whitening`), beside those found already.
2. **Fit.** The best few are fitted through the simulation itself, with all causes found so far, by
   Gauss-Newton.
3. **Decide.** The best one is taken if the logarithm of its likelihood pays for its parameters and for
   the number of effects that were tried,

       2 (ln L_1 - ln L_0) > k ln N + 2 ln M,

   and if it also predicts the logs kept for judging better than without.
4. Again from 1, until nothing is taken; then whatever has become dispensable is taken out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.problem import Cause, Problem, apply_all
from waferbot_twin.diagnosis.record import Array
from waferbot_twin.diagnosis.whitening import Fit, fit
from waferbot_twin.effects.effect import Effect, Parameter

FITTED = 4
"""How many of the best screened effects are fitted through the simulation."""

MOST_CAUSES = 6
GAUSS_NEWTON_ROUNDS = 6
PROBE = 0.1
"""Share of an effect's typical value with which its signature is found."""

TELLS_APART = 10.0
"""Difference of 2 ln L from which on one cause explains the logs better than another."""

Progress = Callable[[str, float], None]


@dataclass
class Hypothesis:
    """A set of causes, fitted: residuals, likelihood by block, covariance of all parameters."""

    causes: tuple[Cause, ...]
    residuals: dict[str, list[Array]]
    fits: dict[str, Fit]
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def log_likelihood(self) -> float:
        """The sum over all blocks."""
        return sum(item.log_likelihood for item in self.fits.values())

    @property
    def samples(self) -> int:
        """Samples of all channels."""
        return sum(item.samples for item in self.fits.values())

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return sum(len(cause.values) for cause in self.causes)


def bare(problem: Problem, causes: tuple[Cause, ...] = ()) -> Hypothesis:
    """Return the model with these causes as they are, without any fitting."""
    variant = apply_all(problem.nominal, causes)
    residuals = {
        block: problem.residuals(variant, block) for block, parts in problem.blocks.items() if parts
    }
    return Hypothesis(causes, residuals, problem.judge(residuals))


def parameters_of(problem: Problem, cause: Cause) -> tuple[Parameter, ...]:
    """Return the parameters of a cause."""
    return cause.effect.parameters(problem.nominal, cause.axis)


def signature(
    problem: Problem, hypothesis: Hypothesis, causes: tuple[Cause, ...], place: int
) -> dict[str, Array]:
    """
    Return what the parameters of `causes[place]` change in the residuals, block by block.

    Arrays have the shape (samples of all channels, parameters), per unit of the parameter.
    """
    cause = causes[place]
    found: dict[str, list[Array]] = {}
    for item in parameters_of(problem, cause):
        step = _probe(item, cause.values[item.name])
        moved = Cause(cause.effect, cause.axis, {**cause.values, item.name: cause.values[item.name] + step})
        variant = apply_all(
            problem.nominal, (*causes[:place], moved, *causes[place + 1 :])
        )
        for block in problem.touched(cause.effect, cause.axis):
            changed = np.concatenate(problem.residuals(variant, block))
            column = (changed - np.concatenate(hypothesis.residuals[block])) / step
            found.setdefault(block, []).append(column)
    return {block: np.column_stack(columns) for block, columns in found.items()}


def _probe(item: Parameter, value: float) -> float:
    """Return the step of a finite difference, away from the nearer bound."""
    step = PROBE * (item.typical - item.neutral if item.typical != item.neutral else item.typical)
    if not item.low <= value + step <= item.high:
        step = -step
    return step


def fit_causes(problem: Problem, causes: tuple[Cause, ...], rounds: int = GAUSS_NEWTON_ROUNDS) -> Hypothesis:
    """
    Fit all parameters of all causes through the simulation.

    Gauss-Newton in the whitened residuals with halved steps where the likelihood would fall.
    """
    now = bare(problem, causes)
    names = [
        (place, item) for place, cause in enumerate(causes) for item in parameters_of(problem, cause)
    ]
    if not names:
        return now
    for _ in range(rounds):
        change, covariance = _newton_step(problem, now, names)
        now.covariance = covariance
        better = None
        for share in (1.0, 0.5, 0.2, 0.05):
            tried = bare(problem, _moved(now.causes, names, share * change))
            if tried.log_likelihood > now.log_likelihood:
                better = tried
                break
        if better is None:
            break
        gain = better.log_likelihood - now.log_likelihood
        better.covariance = covariance
        now = better
        if gain < 0.05:
            break
    return now


def _newton_step(
    problem: Problem, now: Hypothesis, names: Sequence[tuple[int, Parameter]]
) -> tuple[Array, Array]:
    """Return the linear estimate of the change of all parameters, and its covariance."""
    columns = [
        signature(problem, now, now.causes, place) for place in range(len(now.causes))
    ]
    blocks = sorted({block for item in columns for block in item})
    residuals, signatures, floors = [], [], []
    for block in blocks:
        channels = now.residuals[block]
        ends = np.cumsum([len(channel) for channel in channels])[:-1]
        total = sum(len(channel) for channel in channels)
        matrix = np.zeros((total, len(names)))
        place_in_names = 0
        for place, item in enumerate(columns):
            count = len(parameters_of(problem, now.causes[place]))
            if block in item:
                matrix[:, place_in_names : place_in_names + count] = item[block]
            place_in_names += count
        residuals += channels
        signatures += np.split(matrix, ends)
        floors += problem.floors(block)[: len(channels)]
    estimate = fit(residuals, signatures, floors)
    return estimate.value, estimate.covariance


def _moved(
    causes: tuple[Cause, ...], names: Sequence[tuple[int, Parameter]], change: Array
) -> tuple[Cause, ...]:
    values = [dict(cause.values) for cause in causes]
    for (place, item), amount in zip(names, change, strict=True):
        values[place][item.name] = float(
            np.clip(values[place][item.name] + amount, item.low, item.high)
        )
    return tuple(
        Cause(cause.effect, cause.axis, new) for cause, new in zip(causes, values, strict=True)
    )


def candidates(problem: Problem, effects: Iterable[Effect]) -> list[Cause]:
    """Return every effect on every axis where it can be seen, with none of it yet."""
    found = []
    for effect in effects:
        for axis in effect.axes(problem.nominal):
            if not problem.touched(effect, axis):
                continue
            parameters = effect.parameters(problem.nominal, axis)
            for shape in effect.trials(problem.nominal, axis):
                values = {
                    item.name: shape.get(item.name, item.typical if item.shape else item.neutral)
                    for item in parameters
                }
                found.append(Cause(effect, axis, values))
    return found


@dataclass(frozen=True)
class Screened:
    """A candidate with its linear fit: 2 (ln L_1 - ln L_0) less k ln N."""

    cause: Cause
    score: float
    value: Array


def screen(
    problem: Problem, base: Hypothesis, rivals: Sequence[Cause], progress: Progress
) -> list[Screened]:
    """Fit every rival linearly beside the causes of `base`; best first."""
    known: list[dict[str, Array]] = [
        signature(problem, base, base.causes, place) for place in range(len(base.causes))
    ]
    found = []
    for number, rival in enumerate(rivals):
        progress('screening', number / len(rivals))
        causes = (*base.causes, rival)
        try:
            own = signature(problem, base, causes, len(causes) - 1)
        except UserError:
            continue
        gain, value = 0.0, np.zeros(0)
        for block, matrix in own.items():
            channels = base.residuals[block]
            ends = np.cumsum([len(channel) for channel in channels])[:-1]
            everything = np.hstack([matrix, *(item[block] for item in known if block in item)])
            if not np.isfinite(everything).all():
                continue
            estimate = fit(
                channels, np.split(everything, ends), problem.floors(block)[: len(channels)]
            )
            gain += 2.0 * (estimate.log_likelihood - base.fits[block].log_likelihood)
            value = estimate.value[: matrix.shape[1]]
        count = len(value)
        found.append(Screened(rival, gain - count * math.log(base.samples), value))
    return sorted(found, key=lambda item: (-item.score, item.cause.name))


def price(problem: Problem, more: Hypothesis, fewer: Hypothesis, tried: int) -> float:
    """Return what `more` has to gain in 2 ln L over `fewer`."""
    extra = more.parameters - fewer.parameters
    return extra * math.log(max(more.samples, 2)) + 2.0 * math.log(max(tried, 1))


@dataclass
class Search:
    """The course of a search: causes found, rivals of each, and what was tried last."""

    found: Hypothesis
    judged: Hypothesis
    nothing: Hypothesis
    judged_nothing: Hypothesis
    rivals: dict[str, list[tuple[Cause, float]]]
    tried: int


def search(
    finding: Problem, judging: Problem, effects: Iterable[Effect], progress: Progress
) -> Search:
    """Find the causes in the logs of `finding` that also explain those of `judging`."""
    every = candidates(finding, effects)
    nothing = bare(finding)
    judged_nothing = bare(judging)
    best, judged = nothing, judged_nothing
    rivals: dict[str, list[tuple[Cause, float]]] = {}
    tried = 0
    while len(best.causes) < MOST_CAUSES:
        taken = {cause.name for cause in best.causes}
        open_ones = [cause for cause in every if cause.name not in taken]
        screened = screen(finding, best, open_ones, progress)
        tried += len(open_ones)
        fitted = []
        for item in [item for item in screened if item.score > 0.0][:FITTED]:
            progress(f'fitting {item.cause.name}', 0.0)
            start = _moved(
                (item.cause,),
                [(0, parameter) for parameter in parameters_of(finding, item.cause)],
                item.value,
            )[0]
            try:
                fitted.append(fit_causes(finding, (*best.causes, start)))
            except UserError:
                continue
        fitted.sort(key=lambda item: item.parameters * math.log(item.samples) - 2.0 * item.log_likelihood)
        taken_now = None
        for item in fitted:
            gain = 2.0 * (item.log_likelihood - best.log_likelihood)
            if gain < price(finding, item, best, tried):
                continue
            try:
                confirmed = bare(judging, item.causes)
            except UserError:
                continue
            if 2.0 * (confirmed.log_likelihood - judged.log_likelihood) > TELLS_APART / 2.0:
                taken_now = item
                break
        if taken_now is None:
            break
        name = taken_now.causes[-1].name
        rivals[name] = [
            (other.causes[-1], 2.0 * (taken_now.log_likelihood - other.log_likelihood))
            for other in fitted
            if other is not taken_now
        ]
        best, judged = taken_now, confirmed
    return Search(best, judged, nothing, judged_nothing, rivals, tried)
