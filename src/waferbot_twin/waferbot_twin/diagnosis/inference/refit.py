# SPDX-License-Identifier: Apache-2.0
"""Candidates that a linear problem puts within reach, fitted through the simulation."""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.nuisance import each_once
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.compliance_scan import may_ring, tuned
from waferbot_twin.diagnosis.proposals.repetition import repeats_in
from waferbot_twin.diagnosis.proposals.screening import Progress, Screened, stage
from waferbot_twin.diagnosis.proposals.threshold_grid import between_rungs
from waferbot_twin.estimation.conditional import others_without, shown_by
from waferbot_twin.estimation.gauss_newton import ENOUGH as TO_THE_END
from waferbot_twin.estimation.gauss_newton import ROUNDS as TO_CONVERGENCE
from waferbot_twin.estimation.gauss_newton import fit_causes, log_posterior_ratio, moved, names_of
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    log_likelihood_ratio,
    parameters_of,
)
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.estimation.quantised_fit import acts_on_bits_alone, with_fewest_differences
from waferbot_twin.estimation.separable import (
    Behind,
    fitted_apart,
    fitted_without,
    part_of,
    refined,
)
from waferbot_twin.estimation.size_prior import log_prior
from waferbot_twin.estimation.stacked_least_squares import Signature
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

ENOUGH, ROUGHLY, ROUNDS = 0.3, 1e-2, 6
"""
Gain in ln L, and share of what was gained, below which a fit in a search ends, and how many rounds that
of a candidate, or one with known signatures, has: what is taken is fitted on, and all in the end.
"""

SHARES = (1.0, 0.3, 0.1, 0.03)
"""
Shares of what the linear problem asks for; the first that makes the logs likelier is where a fit begins:
where many things lack it asks for far too much of what bends.
"""

MORE_TRIALS = 3
"""How many second trials (another order, frequency or rung) are refitted."""


def within_reach(
    problem: Problem, screened: Sequence[Screened], settings: Settings
) -> list[Screened]:
    """
    Return what may be the best: by the linear problem, and by what that says in noise of known power.

    The best of each axis, and half of the names that the settings allow by each; then, as long as there
    is room, other trials of these that promise much and have another shape.
    """
    first: dict[str, Screened] = {}
    by_likelihood = sorted(screened, key=lambda item: -item.likelihood)
    by_score = sorted(screened, key=lambda item: -item.score)
    of_axes = {item.cause.axis: item for item in reversed(by_likelihood)}
    for ranked, most in (
        (list(of_axes.values()), settings.most_refits),
        (by_likelihood, settings.most_refits // 2),
        (by_score, settings.most_refits),
    ):
        for item in ranked:
            if len(first) < most:
                first.setdefault(item.cause.name, item)
    chosen = list(first.values())
    for item in by_likelihood:
        of_its_name = [one for one in chosen if one.cause.name == item.cause.name]
        room = len(chosen) < settings.most_refits + MORE_TRIALS
        if room and len(of_its_name) == 1 and _differs(problem, item, of_its_name):
            chosen.append(item)
    return chosen


def _differs(problem: Problem, item: Screened, trials: Sequence[Screened]) -> bool:
    """Return whether a trial has other shape parameters than those that promised more."""
    own = _shape(problem, item.cause)
    return all(own != _shape(problem, other.cause) for other in trials)


def _shape(problem: Problem, cause: Cause) -> dict[str, float]:
    return {
        item.name: cause.values[item.name]
        for item in cause.effect.parameters(problem.nominal, cause.axis)
        if item.shape or item.fixed or item.name in cause.narrow
    }


def fitted(
    problem: Problem,
    causes: tuple[Cause, ...],
    workers: int = 1,
    enough: float = ENOUGH,
    near: Hypothesis | None = None,
    begun: Mapping[str, Signature] | None = None,
    roughly: float = 0.0,
) -> Hypothesis | None:
    """
    Return causes fitted; None if the machine does not stand with them alone.

    `near` is a fit with some or all of them, if there was one, and `begun` are signatures from near
    here. `roughly` as in `gauss_newton.fit_causes`.
    """
    shown = None if near is None else shown_by(problem, near)
    try:
        return fitted_apart(
            problem, causes, workers, enough, None, TO_CONVERGENCE, roughly, shown, begun
        )
    except UserError:
        return None


def fitted_on(
    problem: Problem,
    found: Hypothesis,
    workers: int = 1,
    begun: Mapping[str, Signature] | None = None,
) -> Hypothesis:
    """Return a hypothesis with its last cause roughly fitted on; as it is if that blows up."""
    try:
        return refined(problem, found, workers, ENOUGH, ROUGHLY, begun)
    except UserError:
        return found


def to_the_end(problem: Problem, found: Hypothesis, workers: int = 1) -> Hypothesis:
    """Return a hypothesis fitted to the end; as it is if that blows up."""
    return fitted(problem, found.causes, workers, TO_THE_END, found) or found


def begun_elsewhere(
    problem: Problem,
    found: Hypothesis,
    trials: Sequence[Cause],
    known: Mapping[str, Signature],
    workers: int = 1,
) -> Hypothesis:
    """
    Return a hypothesis with one of its causes begun at one of some `trials`, if that is more probable.

    What a cause changes in a ring is its phase, so the likelihood over its size has many maxima; which
    of them is the highest depends on what else is known by then. The likeliest of the trials is fitted,
    first with the signatures of `found` by name (`known`), which costs few simulations, and roughly.
    """
    pool = Parallel(n_jobs=workers if len(trials) > 1 else 1)
    ratios = pool(delayed(_tried)(problem, found, trial) for trial in trials)
    if max(ratios, default=-math.inf) == -math.inf:
        return found
    likeliest = trials[int(np.argmax(ratios))]
    begun = _begun_at(problem, found.causes, likeliest, known, workers)
    if begun is None or log_posterior_ratio(problem, begun, found) <= ENOUGH:
        return found
    return fitted(problem, begun.causes, workers, ENOUGH, begun, known, ROUGHLY) or begun


def _tried(problem: Problem, found: Hypothesis, trial: Cause) -> float:
    """Return how much more probable a hypothesis is with one of its causes as in a trial, in ln."""
    try:
        return log_posterior_ratio(problem, evaluate(problem, _with(found.causes, trial)), found)
    except UserError:
        return -math.inf


def _with(causes: Sequence[Cause], trial: Cause) -> tuple[Cause, ...]:
    return tuple(trial if cause.name == trial.name else cause for cause in causes)


def _begun_at(
    problem: Problem,
    causes: Sequence[Cause],
    trial: Cause,
    known: Mapping[str, Signature],
    workers: int,
) -> Hypothesis | None:
    """Return causes fitted from where one is as in a trial; None if the machine does not stand there."""
    try:
        return fitted_apart(problem, _with(causes, trial), workers, ENOUGH, known, ROUNDS, ROUGHLY)
    except UserError:
        return None


def without(
    problem: Problem,
    found: Hypothesis,
    names: Collection[str],
    workers: int = 1,
    known: Mapping[str, Signature] | None = None,
    start: Sequence[Cause] = (),
    begun: Mapping[str, Signature] | None = None,
    roughly: float = 0.0,
) -> Hypothesis:
    """
    Return a hypothesis without some causes, the others fitted anew.

    From where they `start`, if anywhere, else from where the linear problem has them
    (`estimation.conditional`), or from where they are if that is more probable. Not fitted where the
    machine stands with neither. With the signatures of `found` by name alone (`known`) that costs few
    simulations; those it has `begun` with are found anew in the end. `roughly` as in
    `gauss_newton.fit_causes`.
    """
    places = [place for place, cause in enumerate(found.causes) if cause.name in names]
    kept = [place for place in range(len(found.causes)) if place not in places]
    as_they_are = tuple(found.causes[place] for place in kept)
    start = tuple(start) or _more_probable(
        problem, others_without(problem, found, names), as_they_are
    )
    once = each_once(problem, start)
    known = _of_free(problem, found.causes, once, known)
    if known and len(known) < len(once):  # what is free now has no column in a signature
        known = None
    begun = _of_free(problem, found.causes, once, begun)
    rounds = ROUNDS if known else TO_CONVERGENCE
    try:
        if once != start or len(places) > 1:
            shown = shown_by(problem, found)
            return fitted_apart(
                problem, once, workers, ENOUGH, known, rounds, roughly, shown, begun
            )
        causes = list(found.causes)
        for place, cause in zip(kept, start, strict=True):
            causes[place] = cause
        moved_on = replace(found, causes=tuple(causes))
        return fitted_without(
            problem, moved_on, places[0], workers, ENOUGH, known, rounds, roughly, begun
        )
    except UserError:
        return evaluate(problem, as_they_are)


def with_in_its_place(
    problem: Problem, found: Hypothesis, instead: Cause, begun: Mapping[str, Signature]
) -> Hypothesis | None:
    """
    Return a hypothesis with one of fewer parameters in the place of a cause of its name, fitted anew.

    `begun` are signatures of `found` by name. None if the machine does not stand so.
    """
    causes = tuple(instead if cause.name == instead.name else cause for cause in found.causes)
    known = _of_free(problem, found.causes, causes, begun)
    return fitted(problem, causes, 1, ENOUGH, found, known)


def _of_free(
    problem: Problem,
    before: Sequence[Cause],
    now: Sequence[Cause],
    known: Mapping[str, Signature] | None,
) -> dict[str, Signature] | None:
    """
    Return the signatures of causes, by name, of which parameters may be held now that were free before.

    Without those of which one is free now that was held: nobody knows what it changes.
    """
    if not known:
        return None
    free = {cause.name: [item.name for item in parameters_of(problem, cause)] for cause in before}
    found = {}
    for cause in now:
        names = [item.name for item in parameters_of(problem, cause)]
        if set(names) <= set(free[cause.name]):
            columns = [free[cause.name].index(name) for name in names]
            own = known[cause.name]
            found[cause.name] = {block: matrix[:, columns] for block, matrix in own.items()}
    return found


def _more_probable(
    problem: Problem, one: tuple[Cause, ...], other: tuple[Cause, ...]
) -> tuple[Cause, ...]:
    """Return the more probable of two sets of values; the second if the machine stands with neither."""
    try:
        there = evaluate(problem, one)
    except UserError:
        return other
    try:
        here = evaluate(problem, other)
    except UserError:
        return one
    ratio = log_likelihood_ratio(there, here)
    return one if ratio + log_prior(problem, one) > log_prior(problem, other) else other


def with_last(problem: Problem, found: Hypothesis, name: str) -> Hypothesis:
    """Return the same hypothesis with one of its causes behind the others."""
    places = sorted(range(len(found.causes)), key=lambda place: found.causes[place].name == name)
    counts = [len(parameters_of(problem, cause)) for cause in found.causes]
    firsts = np.cumsum([0, *counts])
    order = [n for place in places for n in range(firsts[place], firsts[place + 1])]

    def in_order(matrix: Array) -> Array:
        return matrix[np.ix_(order, order)] if len(matrix) == len(order) else matrix

    return replace(
        found,
        causes=tuple(found.causes[place] for place in places),
        covariance=in_order(found.covariance),
        curvature=in_order(found.curvature),
    )


class Refits:
    """
    Candidates fitted behind the causes that are known.

    What was fitted the last time is kept: where what is known has not changed in any block that goes
    with a candidate's, it need not be fitted again.
    """

    def __init__(self, problem: Problem, progress: Progress, workers: int = 1) -> None:
        """Take the logs, and how many are fitted at a time."""
        self.problem, self.progress, self.workers = problem, progress, workers
        self._last: dict[Hashable, list[Hypothesis]] = {}

    def __call__(
        self, base: Hypothesis, items: Sequence[Screened], known: Sequence[Signature]
    ) -> list[Hypothesis]:
        """
        Return the causes of `base` with each of the candidates behind them, all fitted together.

        In the order of the candidates, one that holds something (teeth, poles, a turn) once more with
        that free; those with which the simulation blows up are left out. `known` are the signatures of
        the causes of `base`.
        """
        separated = [Behind.of(self.problem, base, item.cause) for item in items]
        keys = [_asked(one, item) for one, item in zip(separated, items, strict=True)]
        new = [number for number, key in enumerate(keys) if key not in self._last]
        pool = Parallel(n_jobs=self.workers, return_as='generator', batch_size=1)
        tasks = (
            delayed(_refit)(one.problem, one.beside, items[n], [known[p] for p in one.places])
            for n in new
            for one in (separated[n],)
        )
        found = {key: self._last[key] for key in keys if key in self._last}
        for done, (number, parts) in enumerate(zip(new, pool(tasks), strict=True), 1):
            self.progress(stage('fitting', base.causes), done, len(new))
            found[keys[number]] = parts
        self._last = found
        return [
            one.whole(part)
            for one, key in zip(separated, keys, strict=True)
            for part in found[key]
        ]


def _asked(one: Behind, item: Screened) -> Hashable:
    """Return what a fit depends on: causes with their values, and where it begins."""
    causes = [(cause.name, tuple(cause.values.items())) for cause in one.beside.causes]
    own = item.cause
    return (
        tuple(causes), own.name, tuple(own.values.items()), own.held, own.narrow,
        tuple(item.value.tolist()),
    )  # fmt: skip


def _refit(
    problem: Problem, base: Hypothesis, item: Screened, known: Sequence[Signature]
) -> list[Hypothesis]:
    """Return a candidate fitted behind `base`, and once more with what it holds; none if it blows up."""
    try:
        blocks = frozenset(problem.touched(item.cause.effect, item.cause.axis))
        there = part_of(problem, base, range(len(base.causes)), blocks)
        start = _start(problem.only(blocks), there, item)
        found = downhill(problem, start, _roughly(problem, (*base.causes, start), known))
    except UserError:
        return []
    free = _released(problem, found, known)
    return [found] if free is None else [found, free]


def _roughly(
    problem: Problem, causes: tuple[Cause, ...], known: Sequence[Signature]
) -> Hypothesis:
    """Return causes fitted, those before the last with signatures that are known."""
    return fit_causes(problem, causes, ROUNDS, enough=ENOUGH, known=known, roughly=ROUGHLY)


def _start(problem: Problem, base: Hypothesis, item: Screened) -> Cause:
    """Return a screened cause where its fit begins."""
    if item.cause.effect.threshold:
        # One that rings as well may be right on its rung, and halving would lead away from there.
        tried = (between_rungs(problem, base, item.cause), item.cause)
        return max(tried, key=lambda c: evaluate(problem, (*base.causes, c)).log_likelihood)
    names = names_of(problem, (item.cause,))

    def times(size: float) -> Cause:
        (cause,) = moved((item.cause,), names, size * item.value)
        return cause

    start = times(1.0)
    if item.value.any() and acts_on_bits_alone(problem, start):
        return with_fewest_differences(problem, base, start, times)
    if may_ring(problem, start):
        return tuned(problem, base, start)
    for share in SHARES if item.value.any() else ():
        less = times(share)
        if log_likelihood_ratio(evaluate(problem, (*base.causes, less)), base) > 0.0:
            return less
    return start


def _released(
    problem: Problem, found: Hypothesis, known: Sequence[Signature]
) -> Hypothesis | None:
    """
    Return a fitted hypothesis with what its last cause holds (teeth, poles, a turn) free as well.

    None if nothing is held, if the simulation blows up so, or if no log goes as far as it then repeats.
    """
    last = _free(found.causes[-1])
    held = found.causes[-1].held
    if not any(item.fixed and item.name in held for item in parameters_of(problem, last)):
        return None

    try:
        free = _roughly(problem, (*found.causes[:-1], last), known)
    except UserError:
        return None
    return free if repeats_in(problem, free.causes[-1]) else None


def _free(cause: Cause) -> Cause:
    return Cause(cause.effect, cause.axis, cause.values, (), cause.narrow)
