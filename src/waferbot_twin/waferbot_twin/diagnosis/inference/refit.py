# SPDX-License-Identifier: Apache-2.0
"""Candidates that a linear problem puts within reach, fitted through the simulation."""

from __future__ import annotations

from collections.abc import Sequence

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.proposals.compliance_scan import may_ring, tuned
from waferbot_twin.diagnosis.proposals.screening import Progress, Screened
from waferbot_twin.diagnosis.proposals.threshold_grid import between_rungs
from waferbot_twin.estimation.gauss_newton import fit_causes, moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.estimation.quantised_fit import acts_on_bits_alone, with_fewest_differences
from waferbot_twin.estimation.separable import fitted_apart, fitted_behind, part_of
from waferbot_twin.estimation.stacked_least_squares import Signature
from waferbot_twin.residuals.problem import Cause, Problem

ENOUGH, ROUGHLY = 0.3, 1e-3
"""Gain in ln L, and share of what was gained, below which a refit ends: what is taken is fitted on."""

MORE_TRIALS = 3
"""How many second trials (another order, frequency or rung) are refitted."""


def within_reach(
    problem: Problem, screened: Sequence[Screened], settings: Settings
) -> list[Screened]:
    """
    Return what may be the best: by the linear problem, and by what that says in noise of known power.

    Half of the names that the settings allow by each; then, as long as there is room, other trials of
    these that promise much and have another shape.
    """
    first: dict[str, Screened] = {}
    by_likelihood = sorted(screened, key=lambda item: -item.likelihood)
    by_score = sorted(screened, key=lambda item: -item.score)
    for ranked, most in (
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


def fitted(problem: Problem, causes: tuple[Cause, ...]) -> Hypothesis | None:
    """Return causes fitted; None if the machine does not stand with them alone."""
    try:
        return fitted_apart(problem, causes)
    except UserError:
        return None


def refit(
    problem: Problem,
    base: Hypothesis,
    items: Sequence[Screened],
    known: Sequence[Signature],
    progress: Progress,
    workers: int = 1,
) -> list[Hypothesis]:
    """
    Return the causes of `base` with each of the candidates behind them, all fitted together.

    In the order of the candidates; those with which the simulation blows up are left out. `known` are
    the signatures of the causes of `base`.
    """
    pool = Parallel(n_jobs=workers, return_as='generator', batch_size=1)
    found = []
    for number, one in enumerate(
        pool(delayed(_refit)(problem, base, item, known) for item in items), 1
    ):
        progress('fitting', number, len(items))
        if one is not None:
            found.append(one)
    return found


def _refit(
    problem: Problem, base: Hypothesis, item: Screened, known: Sequence[Signature]
) -> Hypothesis | None:
    def with_it(own: Problem, beside: Hypothesis, places: Sequence[int]) -> Hypothesis:
        start = _start(own, beside, item)
        causes, signatures = (*beside.causes, start), [known[place] for place in places]
        found = fit_causes(own, causes, enough=ENOUGH, known=signatures, roughly=ROUGHLY)
        return downhill(own, start, found)

    try:
        return fitted_behind(problem, base, item.cause, with_it)
    except UserError:
        return None


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
    return start


def released(problem: Problem, found: Hypothesis) -> Hypothesis | None:
    """
    Return a fitted hypothesis with what its last cause holds (teeth, poles, a turn) free as well.

    None if nothing is held, or if the simulation blows up so.
    """
    last = _free(found.causes[-1])
    held = found.causes[-1].held
    if not any(item.name in held for item in parameters_of(problem, last)):
        return None

    def free(own: Problem, beside: Hypothesis, places: Sequence[int]) -> Hypothesis:
        return fit_causes(own, (*beside.causes, last))

    others = part_of(problem, found, range(len(found.causes) - 1), frozenset(problem.blocks))
    try:
        return fitted_behind(problem, others, last, free)
    except UserError:
        return None


def _free(cause: Cause) -> Cause:
    return Cause(cause.effect, cause.axis, cause.values, (), cause.narrow)
