# SPDX-License-Identifier: Apache-2.0
"""
Causes that have no block in common are fitted apart.

Two causes belong together where a block depends on both, or through others that do: the connected
components of the graph of causes and blocks. Between components the information matrix is zero, so
estimates, covariances and likelihoods are those of a joint fit, and only the blocks of one component
are simulated for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_twin.estimation.conditional import shown_by
from waferbot_twin.estimation.gauss_newton import ENOUGH, ROUNDS, Shown, fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.estimation.stacked_least_squares import Signature
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array


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


def fitted_apart(
    problem: Problem,
    causes: tuple[Cause, ...],
    workers: int = 1,
    enough: float = ENOUGH,
    known: Mapping[str, Signature] | None = None,
    rounds: int = ROUNDS,
    roughly: float = 0.0,
    shown: Shown | None = None,
    begun: Mapping[str, Signature] | None = None,
) -> Hypothesis:
    """
    Return causes with the values that make the logs most likely, component by component.

    A fit ends where a round gains less than `enough` in ln L, or the share `roughly` of all that was
    gained, or after so many `rounds`. `known` are signatures of all causes by name that were found near
    here, `shown` and `begun` as in `gauss_newton.fit_causes`. Raises `UserError` if the simulation blows
    up where a fit begins.
    """
    parts: list[tuple[Sequence[int], Hypothesis]] = []
    untouched = frozenset(problem.blocks)
    for one in components(problem, causes):
        own = tuple(causes[place] for place in one.places)
        signatures = [known[cause.name] for cause in own] if known else []
        fit = fit_causes(
            problem.only(one.blocks),
            own,
            rounds,
            workers,
            enough,
            signatures,
            roughly,
            shown,
            begun,
        )
        parts.append((one.places, fit))
        untouched -= one.blocks
    return joined(problem, [*parts, ((), evaluate(problem.only(untouched)))])


@dataclass(frozen=True)
class Behind:
    """
    What a cause behind those of a fitted hypothesis belongs together with, and what stays as it is.

    `problem` has the blocks of its component alone, `beside` says what is known of them without it, at
    `places` in the hypothesis.
    """

    problem: Problem
    beside: Hypothesis
    places: tuple[int, ...]
    _whole: Problem
    _others: tuple[int, ...]
    _rest: Hypothesis

    @classmethod
    def of(cls, problem: Problem, base: Hypothesis, last: Cause) -> Behind:
        """Separate a cause that comes behind those of `base`."""
        count = len(base.causes)
        one = next(c for c in components(problem, (*base.causes, last)) if count in c.places)
        beside = one.places[:-1]
        others = tuple(place for place in range(count) if place not in beside)
        return cls(
            problem.only(one.blocks),
            part_of(problem, base, beside, one.blocks),
            beside,
            problem,
            others,
            part_of(problem, base, others, frozenset(problem.blocks) - one.blocks),
        )

    def whole(self, found: Hypothesis) -> Hypothesis:
        """Return the whole hypothesis with what was found of `problem`, the cause behind `beside`."""
        count = len(self.places) + len(self._others)
        return joined(self._whole, [((*self.places, count), found), (self._others, self._rest)])


def refined(
    problem: Problem,
    found: Hypothesis,
    workers: int = 1,
    enough: float = ENOUGH,
    roughly: float = 0.0,
    begun: Mapping[str, Signature] | None = None,
) -> Hypothesis:
    """
    Return a hypothesis with what belongs together with its last cause fitted on.

    `roughly` and `begun` as in `fitted_apart`. Raises `UserError` if the simulation blows up where the
    fit begins.
    """
    last = found.causes[-1]
    others = part_of(problem, found, range(len(found.causes) - 1), frozenset(problem.blocks))
    one = Behind.of(problem, others, last)
    causes = (*one.beside.causes, last)
    shown = shown_by(problem, found)
    again = fit_causes(one.problem, causes, ROUNDS, workers, enough, (), roughly, shown, begun)
    return one.whole(again)


def fitted_without(
    problem: Problem,
    found: Hypothesis,
    place: int,
    workers: int = 1,
    enough: float = ENOUGH,
    known: Mapping[str, Signature] | None = None,
    rounds: int = ROUNDS,
    roughly: float = 0.0,
    begun: Mapping[str, Signature] | None = None,
) -> Hypothesis:
    """
    Return a hypothesis without one of its causes, what belonged together with that fitted anew.

    `known`, `rounds`, `roughly` and `begun` as in `fitted_apart`.
    Raises `UserError` if the machine does not stand without it.
    """
    one = next(c for c in components(problem, found.causes) if place in c.places)
    beside = [other for other in one.places if other != place]
    others = [other for other in range(len(found.causes)) if other not in one.places]
    own = problem.only(one.blocks)
    kept = tuple(found.causes[other] for other in beside)
    shown = shown_by(problem, found)
    again = fitted_apart(own, kept, workers, enough, known, rounds, roughly, shown, begun)
    rest = part_of(problem, found, others, frozenset(problem.blocks) - one.blocks)

    def moved_up(places: Sequence[int]) -> list[int]:
        return [other - (other > place) for other in places]

    return joined(problem, [(moved_up(beside), again), (moved_up(others), rest)])


def part_of(
    problem: Problem, hypothesis: Hypothesis, places: Sequence[int], blocks: frozenset[str]
) -> Hypothesis:
    """
    Return what a hypothesis says of some of its causes and of some blocks.

    It promises no more than the whole does.
    """
    own = _parameters_at(problem, hypothesis.causes, places)
    count = _count(problem, hypothesis.causes)

    def of_own(matrix: Array) -> Array:
        return matrix[np.ix_(own, own)] if len(matrix) == count else np.zeros((0, 0))

    return Hypothesis(
        tuple(hypothesis.causes[place] for place in places),
        {block: one for block, one in hypothesis.residuals.items() if block in blocks},
        {block: one for block, one in hypothesis.fits.items() if block in blocks},
        of_own(hypothesis.covariance),
        of_own(hypothesis.curvature),
        hypothesis.promised,
    )


def joined(problem: Problem, parts: Sequence[tuple[Sequence[int], Hypothesis]]) -> Hypothesis:
    """
    Return one hypothesis made of parts, each with the places that its causes have in the whole.

    Covariances and curvatures between parts are zero. Blocks are in the order of the problem.
    """
    count = sum(len(places) for places, _ in parts)
    causes: list[Cause] = [None] * count  # type: ignore[list-item]
    for places, part in parts:
        for place, cause in zip(places, part.causes, strict=True):
            causes[place] = cause
    total = _count(problem, causes)
    covariance, curvature = np.zeros((2, total, total))
    for places, part in parts:
        own = _parameters_at(problem, causes, places)
        if len(part.covariance) == len(own):
            covariance[np.ix_(own, own)] = part.covariance
            curvature[np.ix_(own, own)] = part.curvature
    return Hypothesis(
        tuple(causes),
        {b: part.residuals[b] for b in problem.blocks for _, part in parts if b in part.residuals},
        {b: part.fits[b] for b in problem.blocks for _, part in parts if b in part.fits},
        covariance,
        curvature,
        sum(part.promised for places, part in parts if places),
    )


def _count(problem: Problem, causes: Sequence[Cause]) -> int:
    return sum(len(parameters_of(problem, cause)) for cause in causes)


def _parameters_at(problem: Problem, causes: Sequence[Cause], places: Sequence[int]) -> list[int]:
    """Return where the parameters of causes at some places stand among those of all."""
    firsts = np.cumsum([0, *(len(parameters_of(problem, cause)) for cause in causes)])
    return [n for place in places for n in range(firsts[place], firsts[place + 1])]
