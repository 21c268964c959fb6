# SPDX-License-Identifier: Apache-2.0
"""
Causes that have no block in common are fitted apart.

Two causes belong together where a block depends on both, or through others that do: the connected
components of the graph of causes and blocks. Between components the information matrix is zero, so
estimates, covariances and likelihoods are those of a joint fit, and only the blocks of one component
are simulated for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.residuals.problem import Cause, Problem


@dataclass(frozen=True)
class Component:
    """Places of causes that belong together, in their order, and the blocks that they change."""

    places: tuple[int, ...]
    blocks: frozenset[str]


def components(problem: Problem, causes: Sequence[Cause]) -> list[Component]:
    """Return the components of some causes, in the order of their first cause."""
    found: list[Component] = []
    for place, cause in enumerate(causes):
        places, blocks = {place}, set(problem.touched(cause.effect, cause.axis))
        apart = []
        for one in found:
            if one.blocks & blocks:
                places.update(one.places)
                blocks |= one.blocks
            else:
                apart.append(one)
        found = [*apart, Component(tuple(sorted(places)), frozenset(blocks))]
    return sorted(found, key=lambda one: one.places)


def fitted_apart(problem: Problem, causes: tuple[Cause, ...]) -> Hypothesis:
    """
    Return causes with the values that make the logs most likely, component by component.

    Raises `UserError` if the simulation blows up where a fit begins.
    """
    parts: list[tuple[Sequence[int], Hypothesis]] = []
    untouched = frozenset(problem.blocks)
    for one in components(problem, causes):
        own = tuple(causes[place] for place in one.places)
        parts.append((one.places, fit_causes(problem.only(one.blocks), own)))
        untouched -= one.blocks
    return joined(problem, [*parts, ((), evaluate(problem.only(untouched)))])


FitOfPart = Callable[[Problem, Hypothesis, Sequence[int]], Hypothesis]
"""From some blocks, what is known of them beside one more cause, and its places: fitted with that."""


def fitted_behind(problem: Problem, base: Hypothesis, last: Cause, fit: FitOfPart) -> Hypothesis:
    """
    Return the causes of a fitted hypothesis with one more behind them.

    Only what belongs together with that one is fitted, by `fit`; everything else stays as it is.
    """
    count = len(base.causes)
    one = next(c for c in components(problem, (*base.causes, last)) if count in c.places)
    beside = one.places[:-1]
    others = [place for place in range(count) if place not in beside]
    found = fit(problem.only(one.blocks), part_of(problem, base, beside, one.blocks), beside)
    rest = part_of(problem, base, others, frozenset(problem.blocks) - one.blocks)
    return joined(problem, [(one.places, found), (others, rest)])


def part_of(
    problem: Problem, hypothesis: Hypothesis, places: Sequence[int], blocks: frozenset[str]
) -> Hypothesis:
    """Return what a hypothesis says of some of its causes and of some blocks."""
    own = _parameters_at(problem, hypothesis.causes, places)
    whole = len(hypothesis.covariance) == _count(problem, hypothesis.causes)
    return Hypothesis(
        tuple(hypothesis.causes[place] for place in places),
        {block: one for block, one in hypothesis.residuals.items() if block in blocks},
        {block: one for block, one in hypothesis.fits.items() if block in blocks},
        hypothesis.covariance[np.ix_(own, own)] if whole else np.zeros((0, 0)),
    )


def joined(problem: Problem, parts: Sequence[tuple[Sequence[int], Hypothesis]]) -> Hypothesis:
    """
    Return one hypothesis made of parts, each with the places that its causes have in the whole.

    Covariances between parts are zero. Blocks are in the order of the problem.
    """
    count = sum(len(places) for places, _ in parts)
    causes: list[Cause] = [None] * count  # type: ignore[list-item]
    for places, part in parts:
        for place, cause in zip(places, part.causes, strict=True):
            causes[place] = cause
    total = _count(problem, causes)
    covariance = np.zeros((total, total))
    for places, part in parts:
        own = _parameters_at(problem, causes, places)
        if len(part.covariance) == len(own):
            covariance[np.ix_(own, own)] = part.covariance
    return Hypothesis(
        tuple(causes),
        {b: part.residuals[b] for b in problem.blocks for _, part in parts if b in part.residuals},
        {b: part.fits[b] for b in problem.blocks for _, part in parts if b in part.fits},
        covariance,
    )


def _count(problem: Problem, causes: Sequence[Cause]) -> int:
    return sum(len(parameters_of(problem, cause)) for cause in causes)


def _parameters_at(problem: Problem, causes: Sequence[Cause], places: Sequence[int]) -> list[int]:
    """Return where the parameters of causes at some places stand among those of all."""
    firsts = np.cumsum([0, *(len(parameters_of(problem, cause)) for cause in causes)])
    return [n for place in places for n in range(firsts[place], firsts[place + 1])]
