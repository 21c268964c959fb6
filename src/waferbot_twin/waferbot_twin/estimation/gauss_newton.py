# SPDX-License-Identifier: Apache-2.0
"""
Fit of all parameters of a set of causes, through the simulation.

Gauss-Newton in the whitened residuals, each step no longer than a reach that grows and shrinks with
success, and within the bounds of the parameters (a bounded linear least-squares problem): a
compliance that shrinks to nothing stops there while the others go on. Residuals are nearly linear in
sizes and bend along shapes (an order, a period, a frequency): sizes are fitted first. Then shapes have a
reach of their own, and a step that fails is tried without them before sizes have to follow. Where a
problem has a prior of sizes (`size_prior`), that is one row more for each of them.

Signatures J are corrected by what a step s has changed in the residuals r (C. G. Broyden, Mathematics of
Computation 19, 1965),

    J <- J + (r_after - r_before - J s) s' / (s' s),                                             (1)

which costs no simulation, and knows better than differences along single parameters what a
combination of them does: where an axis sticks and slips, each of them changes when it does, and much of
that cancels. Differences are over the way that a parameter must move for the logs to show it. Where
that is not known, the first ones are over usual ways, and after the first step these are found anew.
Each is a simulation. So a fit that does not go to the end begins with those that were found near it, or
in longer steps of the plant, and has its own where these lead no further.

With corrected signatures steps are often of the right direction and too short: many of them go down one
valley. A step along which ln L begins with the slope g has gained a. By the parabola of both, twice the
step gains more if

    a > 2/3 g,                                                                                   (2)

and is tried then, and twice that, as long as it does gain more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from waferbot_lockstep.errors import UserError
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    in_quick_steps,
    log_likelihood_ratio,
    parameters_of,
    signature,
    width_of,
)
from waferbot_twin.estimation.size_prior import (
    away_from_neutral,
    log_prior,
    posterior_covariance,
    precision,
)
from waferbot_twin.estimation.stacked_least_squares import (
    Signature,
    Stacked,
    fit_jointly,
    side_by_side,
)
from waferbot_twin.noise_model.leverage import Leverage
from waferbot_twin.noise_model.noise_beside_fit import leverages_of
from waferbot_twin.noise_model.prediction_error import (
    Fit,
    in_deviations,
    normal_equations,
    reduced,
)
from waferbot_twin.noise_model.residual_spectrum import information
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

ROUNDS = 24
ENOUGH = 0.02
"""Gain in ln L below which another round is not worth its time."""

REACH, SHORTEST = 100.0, 0.01
"""First and shortest reach of a step, in widths of each parameter."""

PROMISES = 10.0
"""Gain in 2 ln L that a step promises from which on ever smaller shares of it are tried."""

Names = Sequence[tuple[int, Parameter]]

Shown = Mapping[tuple[str, str], float]
"""Standard error of a parameter, all others known, by its cause's name and its own."""


@dataclass(frozen=True)
class Reach:
    """How far sizes and shapes may move in a step, in widths of each parameter."""

    sizes: float = REACH
    shapes: float = REACH

    def of(self, names: Names) -> Array:
        """Return the reach (k,) of every parameter, in its widths."""
        return np.array([self.shapes if item.shape else self.sizes for _, item in names])

    def times(self, sizes: float, shapes: float) -> Reach:
        """Return a longer or a shorter one."""
        return Reach(sizes * self.sizes, shapes * self.shapes)


@dataclass(frozen=True)
class Linear:
    """
    A problem about a hypothesis: change of residuals by the signatures of all its parameters.

    `value` (k,) the most probable change; `matrix` (m, k) and `right` (m,) the problem in few rows,
    those of the prior among them, |matrix x - right|^2 to be least.
    """

    value: Array
    matrix: Array
    right: Array


def fit_causes(
    problem: Problem,
    causes: tuple[Cause, ...],
    rounds: int = ROUNDS,
    workers: int = 1,
    enough: float = ENOUGH,
    known: Sequence[Signature] = (),
    roughly: float = 0.0,
    shown: Shown | None = None,
    begun: Mapping[str, Signature] | None = None,
) -> Hypothesis:
    """
    Return the causes with their most probable values, the likeliest ones without a prior of sizes.

    `shown` says how far parameters must move for the logs to show it, where a fit near here has told,
    and `begun` are signatures from there by the cause's name, with which this one begins. `known` are
    signatures of the first causes that were found near here.

    The fit ends when a round gains less than `enough` in ln L, or than the share `roughly` of all that
    was gained. Signatures are found once, and then corrected by what each step has changed (equation
    (1)); where a step gains too little they are found anew, those that are `known` excepted, before the
    fit ends. Where `enough` is more than `ENOUGH`, those before are of longer steps of the plant.
    Raises `UserError` if the simulation blows up where the fit begins.
    """
    now, gained = evaluate(problem, causes, workers), 0.0
    names = names_of(problem, causes)
    bends = [item.shape for _, item in names]
    # Sizes first: a shape goes astray as long as they are wrong.
    first = Reach() if all(bends) else Reach(shapes=0.0)
    rest = range(len(known), len(causes))
    anew: Sequence[Signature | None] = [*known, *(None for _ in rest)]
    quick = enough > ENOUGH and bool(rest)
    near = [_near(problem, cause, begun) for cause in causes[len(known) :]]
    signatures: Sequence[Signature | None] = [*known, *near]
    reach, fresh = first, near.count(None) == len(near) and (not quick or bool(roughly))
    seen = list[Signature]()
    keys = [(causes[place].name, item.name) for place, item in names]
    errors = np.array([math.inf if shown is None else shown.get(key, math.inf) for key in keys])
    vague = {place for (place, _), error in zip(names, errors, strict=True) if error == math.inf}
    vague.intersection_update(place for place, one in enumerate(signatures) if one is None)
    for _ in range(rounds if names else 0):
        seen = _signatures(problem, now, workers, signatures, errors, quick)
        linear = linearise(problem, now, seen)
        errors = _conditional_errors(linear)
        better, reach = _step(problem, now, names, linear, reach, workers)
        if better is None and fresh and not roughly:
            whole = _bounded(now.causes, names, linear, Reach())
            if _promised(linear, whole) > PROMISES:
                sound = _sound(problem, now, names, linear, workers)
                better, reach = _step(problem, now, names, sound, first, workers)
        gain = 0.0 if better is None else log_posterior_ratio(problem, better, now)
        gained += gain
        little = gain < max(enough, roughly * gained)
        held = first != Reach() and any(bends)
        # Little may be that of corrected signatures alone, unless a rough fit is all that is wanted.
        again = little and not fresh and (better is None or not roughly) and not (quick and held)
        if again:
            signatures, fresh, quick = anew, True, False
            reach = first if better is None else reach
        elif better is None:
            signatures = seen
        else:
            corrected = _corrected(problem, seen, now, better)
            signatures = [None if n in vague else one for n, one in enumerate(corrected)]
            fresh = bool(vague) and vague.issuperset(rest) and (not quick or bool(roughly))
            vague.clear()
        now = better or now
        if little and not again:
            if not held:
                break
            first = reach = Reach()
    if not seen:
        return now
    if roughly:
        # Corrected signatures say where to go, not how well a value is known.
        seen = _signatures(problem, now, workers, anew, errors, quick)
    return _with_covariance(problem, now, seen)


def _near(
    problem: Problem, cause: Cause, begun: Mapping[str, Signature] | None
) -> Signature | None:
    """Return the signature of a cause that was found near here; None if none is of its parameters."""
    found = begun.get(cause.name) if begun else None
    count = len(parameters_of(problem, cause))
    if found is None or any(matrix.shape[1] != count for matrix in found.values()):
        return None
    return found


def _signatures(
    problem: Problem,
    now: Hypothesis,
    workers: int,
    known: Sequence[Signature | None],
    errors: Array,
    quick: bool,
) -> list[Signature]:
    """Return `all_signatures`, what is not known of them in longer steps of the plant if `quick`."""
    if quick and any(one is None for one in known):
        problem, now = in_quick_steps(problem, now)
    return all_signatures(problem, now, workers, known, errors)


def _with_covariance(
    problem: Problem, now: Hypothesis, signatures: Sequence[Signature]
) -> Hypothesis:
    """
    Return a hypothesis with covariance and curvature, with what the prior says of its values.

    And with the gain that the linear problem about it promises yet: of signatures that were found here
    it is how far the fit is from its end.
    """
    together = _together(problem, now, signatures)
    estimate = fit_jointly(problem, now.residuals, together, rounds=1, known=now.fits)
    rows = in_deviations(estimate.colours, Stacked.of(now.residuals, together).signatures)
    prior = _prior(problem, now)
    products = np.sum([part.T @ part for part in rows], axis=0)
    leverages = leverages_of(rows, estimate.whitened, estimate.noises, estimate.colours, prior)
    linear = linearise(problem, now, signatures)
    best = _bounded(now.causes, names_of(problem, now.causes), linear, Reach())
    return replace(
        now,
        fits=_with_leverages(now.fits, leverages, together),
        covariance=posterior_covariance(information(rows, estimate, leverages), prior),
        curvature=products + np.diag(prior),
        promised=0.5 * _promised(linear, best),
    )


def _with_leverages(
    fits: Mapping[str, Fit], leverages: Sequence[Leverage], blocks: Iterable[str]
) -> dict[str, Fit]:
    """Return what is left over by block, with the leverages in some `blocks` in their order."""
    each = iter(leverages)
    known = {block: tuple(islice(each, len(fits[block].noises))) for block in blocks}
    return {
        block: replace(one, leverages=known[block]) if block in known else one
        for block, one in fits.items()
    }


def _corrected(
    problem: Problem, signatures: Sequence[Signature], before: Hypothesis, after: Hypothesis
) -> list[Signature]:
    """
    Return equation (1): signatures that say of a step what it has changed.

    Parameters count in their widths.
    """
    names = names_of(problem, before.causes)
    scale = _widths(before.causes, names)
    step = np.array(
        [
            after.causes[place].values[item.name] - before.causes[place].values[item.name]
            for place, item in names
        ]
    )
    square = float(np.sum((step / scale) ** 2))
    if square == 0.0:
        return list(signatures)
    counts = [len(parameters_of(problem, cause)) for cause in before.causes]
    predicted = side_by_side(signatures, counts)
    missed = {
        block: np.concatenate(after.residuals[block])
        - np.concatenate(before.residuals[block])
        - matrix @ step
        for block, matrix in predicted.items()
    }
    corrected, first = [], 0
    for own, count in zip(signatures, counts, strict=True):
        weights = (step / scale**2)[first : first + count] / square
        first += count
        corrected.append(
            {block: matrix + np.outer(missed[block], weights) for block, matrix in own.items()}
        )
    return corrected


def names_of(problem: Problem, causes: Sequence[Cause]) -> Names:
    """Return every parameter of the causes, with the place of its cause."""
    return [
        (place, item)
        for place, cause in enumerate(causes)
        for item in parameters_of(problem, cause)
    ]


def _step(
    problem: Problem,
    now: Hypothesis,
    names: Names,
    linear: Linear,
    reach: Reach,
    workers: int = 1,
) -> tuple[Hypothesis | None, Reach]:
    """
    Return the first better hypothesis within ever shorter reaches, or None, and the next reach.

    Each is tried with shapes, then without. Where the whole step promises much, and is short itself,
    reaches are shorter still: what little there is of a cause may do much, and far from in proportion.
    """
    widths, shapes = _widths(now.causes, names), np.array([item.shape for _, item in names])
    of_sizes = _only(linear, ~shapes)
    if reach.shapes == 0.0:
        linear = of_sizes
    shortest = SHORTEST
    whole = _bounded(now.causes, names, linear, Reach())
    if _promised(linear, whole) > PROMISES:
        shortest *= min(1.0, float(np.max(np.abs(whole) / widths, initial=0.0)))
    while reach.sizes >= shortest:
        change = _bounded(now.causes, names, linear, reach)
        better = _if_better(problem, now, names, change, workers)
        if better is not None:
            better = _further(problem, now, names, linear, change, better, workers)
            return better, reach.times(2.0, 2.0)
        used = np.abs(change) / widths
        shorter = min(reach.shapes, float(np.max(used[shapes], initial=0.0)))
        if shorter > 0.0:
            change = _bounded(now.causes, names, of_sizes, reach)
            better = _if_better(problem, now, names, change, workers)
            if better is not None:
                better = _further(problem, now, names, of_sizes, change, better, workers)
                return better, Reach(2.0 * reach.sizes, 0.3 * shorter)
            used = np.abs(change) / widths
        reach = Reach(
            0.3 * min(reach.sizes, float(np.max(used[~shapes], initial=0.0))),
            0.3 * (shorter or reach.shapes),
        )
    return None, reach


def _further(
    problem: Problem,
    now: Hypothesis,
    names: Names,
    linear: Linear,
    change: Array,
    better: Hypothesis,
    workers: int,
) -> Hypothesis:
    """Return where a step leads, doubled as long as that gains more; by equation (2)."""
    slope = float(linear.right @ (linear.matrix @ change))
    while log_posterior_ratio(problem, better, now) > 2.0 / 3.0 * slope:
        change, slope = 2.0 * change, 2.0 * slope
        try:
            tried = evaluate(problem, moved(now.causes, names, change), workers)
        except UserError:
            return better
        if log_posterior_ratio(problem, tried, better) <= 0.0:
            return better
        better = tried
    return better


def _if_better(
    problem: Problem, now: Hypothesis, names: Names, change: Array, workers: int
) -> Hypothesis | None:
    """Return a hypothesis with its parameters changed if that is more probable; else None."""
    try:
        tried = evaluate(problem, moved(now.causes, names, change), workers)
    except UserError:
        return None
    return tried if log_posterior_ratio(problem, tried, now) > 0.0 else None


def log_posterior_ratio(problem: Problem, this: Hypothesis, other: Hypothesis) -> float:
    """Return ln of the ratio of likelihood times prior of two hypotheses with the same causes."""
    prior = log_prior(problem, this.causes) - log_prior(problem, other.causes)
    return log_likelihood_ratio(this, other) + prior


def _promised(linear: Linear, change: Array) -> float:
    """Return the gain in 2 ln of likelihood times prior that the linear problem promises of a change."""
    left = linear.right - linear.matrix @ change
    return float(linear.right @ linear.right - left @ left)


def _sound(
    problem: Problem, now: Hypothesis, names: Names, linear: Linear, workers: int
) -> Linear:
    """
    Return the linear problem with only those causes whose own steps, each alone, do no harm.

    As soon as there is any of some, the machine is another one: a jump, which a difference shows as a
    slope. One such cause makes every step of all others fail.
    """
    owners = np.array([place for place, _ in names])
    steps = [
        _bounded(now.causes, names, _only(linear, owners == number), Reach())
        for number in range(len(now.causes))
    ]
    pool = Parallel(n_jobs=workers if len(steps) > 1 else 1)
    harmless = pool(delayed(_is_harmless)(problem, now, names, step) for step in steps)
    return _only(linear, np.array(harmless)[owners])


def _is_harmless(problem: Problem, now: Hypothesis, names: Names, change: Array) -> bool:
    """Return whether with a change a hypothesis is no less probable."""
    try:
        tried = evaluate(problem, moved(now.causes, names, change))
    except UserError:
        return False
    return log_posterior_ratio(problem, tried, now) >= 0.0


def _only(linear: Linear, free: NDArray[np.bool_]) -> Linear:
    """Return the linear problem with only some of the parameters free."""
    matrix = np.where(free, linear.matrix, 0.0)
    value = np.zeros(len(free))
    value[free] = np.linalg.lstsq(linear.matrix[:, free], linear.right, rcond=None)[0]
    return replace(linear, matrix=matrix, value=value)


def _bounded(causes: Sequence[Cause], names: Names, linear: Linear, reach: Reach) -> Array:
    """Return the best change of all parameters within their bounds and within reach."""
    reaches = reach.of(names) * _widths(causes, names)
    low, high = room(causes, names)
    low, high = np.maximum(low, -reaches), np.minimum(high, reaches)
    if np.all((linear.value >= low) & (linear.value <= high)):
        return linear.value
    return least_squares_within(linear.matrix, linear.right, low, high)


def room(causes: Sequence[Cause], names: Names) -> tuple[Array, Array]:
    """Return how far every parameter can go down and up."""
    values = np.array([causes[place].values[item.name] for place, item in names])
    return (
        np.array([item.low for _, item in names]) - values,
        np.array([item.high for _, item in names]) - values,
    )


def least_squares_within(matrix: Array, right: Array, low: Array, high: Array) -> Array:
    """
    Return where |matrix x - right|^2 is least between bounds (which may coincide).

    What changes nothing, a column of zeros, stays where it is.
    """
    norms = np.linalg.norm(matrix, axis=0)
    free = norms > 0.0
    least = np.zeros(len(norms))
    if not free.any():
        return least
    scale, low, high = norms[free], low[free], high[free]
    margin = 1e-9 * (1.0 + np.abs(low * scale))
    found = lsq_linear(
        matrix[:, free] / scale,
        right,
        (low * scale - margin, high * scale + margin),
        method='bvls',
    )
    least[free] = np.clip(found.x / scale, low, high)
    return least


def _widths(causes: Sequence[Cause], names: Names) -> Array:
    """Return how far it is usual to move each parameter."""
    return np.array([_width(causes[place], item) for place, item in names])


def _width(cause: Cause, item: Parameter) -> float:
    width = width_of(cause, item)
    if item.name in cause.narrow:
        return width
    return max(width, abs(cause.values[item.name] - item.neutral))


def linearise(problem: Problem, now: Hypothesis, signatures: Sequence[Signature]) -> Linear:
    """
    Return the linear problem about a hypothesis with the signatures of its causes.

    In the colours of its residuals; those of what a step leaves over are found after the step.
    """
    together = _together(problem, now, signatures)
    stacked = Stacked.of(now.residuals, together)
    colours = [colour for block in together for colour in now.fits[block].colours]
    matrix, right = reduced(normal_equations(stacked.residuals, stacked.signatures, colours))
    prior = _prior(problem, now)
    away = np.concatenate(
        [away_from_neutral(cause, parameters_of(problem, cause)) for cause in now.causes]
    )
    root, sized = np.sqrt(prior), prior > 0.0
    matrix = np.vstack([matrix, np.diag(root)[sized]])
    right = np.concatenate([right, -(root * away)[sized]])
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0.0] = 1.0
    value = np.linalg.lstsq(matrix / norms, right, rcond=None)[0] / norms
    return Linear(value, matrix, right)


def _together(problem: Problem, now: Hypothesis, signatures: Sequence[Signature]) -> Signature:
    """Return the signature of all parameters of a hypothesis."""
    counts = [len(parameters_of(problem, cause)) for cause in now.causes]
    return side_by_side(signatures, counts)


def _prior(problem: Problem, now: Hypothesis) -> Array:
    """Return the precision (k,) that the prior gives each parameter of a hypothesis."""
    return np.concatenate([precision(problem, cause) for cause in now.causes])


def all_signatures(
    problem: Problem,
    now: Hypothesis,
    workers: int = 1,
    known: Sequence[Signature | None] = (),
    errors: Array | None = None,
) -> list[Signature]:
    """
    Return the signatures of all causes, with as many workers as there are.

    Those `known` by their places, which are not None, are kept. `errors` (k,) as in
    `hypothesis.signature`; None where nothing is known of them.
    """
    by_place = {place: one for place, one in enumerate(known) if one is not None}
    every = [place for place in range(len(now.causes)) if place not in by_place]
    # To send the logs to another process takes as long as to simulate some signatures: once to each.
    parts = [every[first::workers] for first in range(min(workers, len(every)))]
    found = Parallel(n_jobs=workers)(
        delayed(_signatures_at)(problem, now, places, errors) for places in parts
    )
    for places, own in zip(parts, found, strict=True):
        by_place.update(zip(places, own, strict=True))
    return [by_place[place] for place in range(len(now.causes))]


def _signatures_at(
    problem: Problem, now: Hypothesis, places: Sequence[int], errors: Array | None
) -> list[Signature]:
    counts = np.cumsum([0, *(len(parameters_of(problem, cause)) for cause in now.causes)])
    return [
        signature(
            problem, now, now.causes, place,
            None if errors is None else errors[counts[place] : counts[place + 1]],
        )
        for place in places
    ]  # fmt: skip


def _conditional_errors(linear: Linear) -> Array:
    """Return the standard error (k,) of every parameter, all others known."""
    norms = np.linalg.norm(linear.matrix, axis=0)
    return np.divide(1.0, norms, out=np.full(len(norms), np.inf), where=norms > 0.0)


def moved(causes: tuple[Cause, ...], names: Names, change: Array) -> tuple[Cause, ...]:
    """Return the causes with their parameters changed, within their bounds and in whole steps."""
    values = [dict(cause.values) for cause in causes]
    for (place, item), amount in zip(names, change, strict=True):
        wanted = values[place][item.name] + float(amount)
        if item.resolution > 0.0:
            steps = round((wanted - item.neutral) / item.resolution)
            wanted = item.neutral + steps * item.resolution
        values[place][item.name] = float(np.clip(wanted, item.low, item.high))
    return tuple(cause.with_values(new) for cause, new in zip(causes, values, strict=True))
