# SPDX-License-Identifier: Apache-2.0
"""
When a model is far from the machine: everything usual at once, then take out what is not needed.

One cause at a time is the way to a few causes. A rigid model of an elastic machine with unknown
friction lacks twenty, each explains little while the others are missing, and the first ones taken are
those that stand in for many. So all effects that every machine has some of (`Effect.usual`:
compliances, friction, masses, force constants, delays) are fitted together with the causes found so
far, on all axes: first to the residuals as they are, which shows the way from far off, then, if what
is left could be noise, whitened. What is one-sided in the plant begins at its typical value, because a
spring that does not give has no gradient to follow.

Then, again and again, each cause is taken out, the others moved to make up for it as the linear
problem says. Out stays what does not pay for itself (`price_of`), or what logs with another motion
speak against.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.estimation.gauss_newton import fit_causes, linearise, names_of, without
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.noise_model.prediction_error import unpredictable
from waferbot_twin.residuals.problem import PLANT, Cause, Problem

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much is done and how much there is."""

FAR = 10.0
"""RMS of a residual over that of its unpredictable part, from which on it is no noise."""

COARSE_ROUNDS, FINE_ROUNDS, AGAIN_ROUNDS = 12, 6, 2

SMOOTH = 14.0
"""
Samples for each independent one, where residuals are not whitened: the observer of the plant lets
through what is slower than 80 Hz, 160 independent samples a second of the servo's 2250.
"""

ROUGHLY = 2.0
"""Gain in ln L below which another round of a fit far off is not worth its time."""

NEARLY = 0.7
"""
Share of its price that a cause has to gain at least in the logs for finding.

That will do where logs in which nothing is fitted, so that nothing has to be paid for, gain all of it.
"""

AGAINST = 8.0
"""What logs kept for judging must gain in 2 ln L without a cause for it to be taken out."""


def far(hypothesis: Hypothesis) -> bool:
    """Return whether the plant moves in a way that cannot be noise, by any encoder of any log."""
    return any(far_channels(hypothesis))


def far_channels(hypothesis: Hypothesis) -> list[bool]:
    """
    Return for each channel of the plant whether what is left over cannot be noise.

    Noise on a position is as rough as its unpredictable part; what a wrong model leaves is smooth and
    large. Shaking forces lie between, at three to five times their unpredictable part.
    """
    if PLANT not in hypothesis.fits:
        return []
    return [
        float(np.sqrt(np.mean(residual**2))) > FAR * rough
        for residual, rough in zip(
            hypothesis.residuals[PLANT], unpredictable_parts(hypothesis), strict=True
        )
    ]


def unpredictable_parts(hypothesis: Hypothesis) -> list[float]:
    """Return for each channel of the plant what its own past does not tell: how rough it is, counts."""
    return [
        unpredictable(residual, noise)
        for residual, noise in zip(
            hypothesis.residuals[PLANT], hypothesis.fits[PLANT].noises, strict=True
        )
    ]


def usual_causes(
    problem: Problem, effects: Iterable[Effect], taken: Iterable[Cause]
) -> tuple[Cause, ...]:
    """Return every usual effect that is not yet taken, where a fit begins."""
    names = {cause.name for cause in taken}
    found = []
    for effect in effects:
        if not effect.usual:
            continue
        for axis in effect.axes(problem.nominal):
            values = {
                item.name: item.typical if item.shape or _one_sided(effect, item) else item.neutral
                for item in effect.parameters(problem.nominal, axis)
            }
            cause = Cause(effect, axis, values)
            if cause.name not in names and PLANT in problem.touched(effect, axis):
                found.append(cause)
    return tuple(found)


def _one_sided(effect: Effect, item: Parameter) -> bool:
    return effect.block is Block.PLANT and item.low == item.neutral


def price_of(parameters: int, samples: int, tried: int) -> float:
    """Return what causes with so many parameters have to gain in 2 ln L."""
    return parameters * math.log(max(samples, 2)) + 4.0 * math.log(max(tried, 1))


def pays(gained: float, confirmed: float, price: float) -> bool:
    """
    Return whether causes pay for themselves, all in 2 ln L.

    They have `gained` it in the logs for finding; or nearly, and have the price `confirmed` by those for
    judging, where nothing is fitted.
    """
    return gained >= price or (gained >= NEARLY * price and confirmed >= price)


def gain_from_afar(problem: Problem, base: Hypothesis, more: Hypothesis) -> float:
    """
    Return what some causes gain in 2 ln L over others where the model is far from the machine.

    Residuals are compared as they are: whitened ones of a model that moves wrongly say how rough its
    error is, not how large. Negative or zero if the gain is a loss.
    """
    coarse = problem.coarse()
    before, after = (evaluate(coarse, item.causes).log_likelihood for item in (base, more))
    return 2.0 * (after - before) / SMOOTH


@dataclass
class Together:
    """Causes fitted together, in both sets of logs; `losses` is what each is missed by, 2 ln L."""

    found: Hypothesis
    judged: Hypothesis
    losses: dict[str, float]


def fit_together(
    finding: Problem,
    judging: Problem,
    causes: tuple[Cause, ...],
    tried: int,
    progress: Progress,
    workers: int = 1,
) -> Together:
    """Fit causes together from far off, then take out what is not needed."""
    progress('fitting together', 0, 2)
    rough = fit_causes(finding.coarse(), causes, COARSE_ROUNDS, workers, ROUGHLY, SMOOTH)
    progress('fitting together', 1, 2)
    found = evaluate(finding, rough.causes)
    still_far = far(found) or far(evaluate(judging, rough.causes))
    if not still_far:
        found = fit_causes(finding, found.causes, FINE_ROUNDS, workers)
    return take_out(finding, judging, found, still_far, tried, progress, workers)


def take_out(
    finding: Problem,
    judging: Problem,
    found: Hypothesis,
    rough: bool,
    tried: int,
    progress: Progress,
    workers: int = 1,
) -> Together:
    """
    Take out causes that the others can do without, the least needed first.

    As long as what is left is far too large for noise (`rough`), residuals are compared as they are.
    """
    smooth = SMOOTH if rough else 1.0
    usual = SMOOTH if rough else 0.0
    problem, judge = (finding.coarse(), judging.coarse()) if rough else (finding, judging)
    found = evaluate(problem, found.causes)
    kept: set[str] = set()
    several = True
    losses: dict[str, float] = {}
    while found.causes:
        names = names_of(problem, found.causes)
        linear = linearise(problem, found, names, workers, usual)
        without_it: dict[str, Hypothesis] = {}
        for place, cause in enumerate(found.causes):
            progress(f'is {cause.name} needed', place, len(found.causes))
            try:
                without_it[cause.name] = evaluate(
                    problem, without(found.causes, names, linear, place)
                )
            except UserError:  # the machine does not stand without it
                continue
        losses = {
            name: 2.0 * (found.log_likelihood - other.log_likelihood) / smooth
            for name, other in without_it.items()
        }
        prices = {cause.name: price_of(cause.free, found.samples, tried) for cause in found.causes}
        spare = [
            name
            for name, loss in losses.items()
            if loss < prices[name]
            and name not in kept
            and (rough or not _nearly_paid(judge, found, without_it[name], loss, prices[name]))
        ]
        needless = bool(spare)
        if not spare:
            judged = evaluate(judge, found.causes).log_likelihood
            spare = [
                name
                for name, other in without_it.items()
                if name not in kept
                and 2.0 * (_log_likelihood(judge, other.causes) - judged) > AGAINST * smooth
            ]
        if not spare:
            break
        least = sorted(spare, key=lambda name: (losses[name], name))
        least = least[: max(1, len(least) // 2)] if several and needless else least[:1]
        left = tuple(cause for cause in found.causes if cause.name not in least)
        fewer = fit_causes(problem, left, AGAIN_ROUNDS, workers, usual=usual)
        lost = 2.0 * (found.log_likelihood - fewer.log_likelihood) / smooth
        if needless:
            can_do = lost < sum(prices[name] for name in least)
        else:
            can_do = _log_likelihood(judge, fewer.causes) > judged
        if can_do:
            found, several = fewer, True
        elif len(least) == 1:  # what the linear problem promised does not come true
            kept.add(least[0])
        else:
            several = False
    whole = evaluate(finding, found.causes)
    if whole.causes:
        whole.covariance = smooth * linear.covariance
    return Together(whole, evaluate(judging, found.causes), losses)


def _nearly_paid(
    judge: Problem, found: Hypothesis, without_it: Hypothesis, loss: float, price: float
) -> bool:
    """Return whether a cause pays with what the logs for judging lose without it."""
    if loss < NEARLY * price:  # whatever they lose
        return False
    with_it, less = (_log_likelihood(judge, item.causes) for item in (found, without_it))
    return pays(loss, 2.0 * (with_it - less), price)


def _log_likelihood(problem: Problem, causes: tuple[Cause, ...]) -> float:
    """Return how likely a model with these causes is; not at all if it blows up."""
    try:
        return evaluate(problem, causes).log_likelihood
    except UserError:
        return -math.inf
