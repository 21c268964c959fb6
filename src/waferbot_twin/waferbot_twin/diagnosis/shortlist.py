# SPDX-License-Identifier: Apache-2.0
"""
The best of what was screened, fitted through the simulation beside the causes found so far.

A few of each round, each from where it promises most; then whatever promised as much as the best of
these, for what is not fitted is no rival; in blocks that should leave nothing over, but do, whatever
acts on these alone, and pairs of that. They are fitted side by side on all cores; which are, and in what
order they come back, does not depend on how many cores there are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.confirmation import Fitted, weighed
from waferbot_twin.diagnosis.proposals.compliance_scan import may_ring, tuned
from waferbot_twin.diagnosis.proposals.screening import Progress, Screened
from waferbot_twin.diagnosis.proposals.threshold_grid import between_rungs
from waferbot_twin.diagnosis.search_state import TELLS_APART, Search
from waferbot_twin.diagnosis.together import far, price_of
from waferbot_twin.estimation.gauss_newton import fit_causes, moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.estimation.nelder_mead import downhill
from waferbot_twin.estimation.quantised_fit import acts_on_bits_alone, with_fewest_differences
from waferbot_twin.residuals.problem import Cause, Problem

FITTED = 5
"""How many of the best screened effects are fitted through the simulation in each round."""

PAIRED = 5
"""How many effects of an exact block are fitted in pairs."""

TRIALS = 3
"""How many trials of an effect that promise as much are fitted."""

HOPELESS = 0.3
"""Share of the best gain so far that screening must promise for a candidate to be fitted, too."""


def fit_best(
    finding: Problem,
    judging: Problem,
    state: Search,
    screened: Sequence[Screened],
    progress: Progress,
    workers: int = 1,
    gained: float = 0.0,
) -> list[Fitted]:
    """
    Fit the best screened effects beside the causes of `state`, then what promised as much as the best.

    Those that promise much less than another has already `gained` are not, if the other is confirmed.
    """
    screened = [item for item in screened if item.cause.name not in state.feigned]
    chosen = most_promising(finding, screened)
    fitted: list[Fitted] = []

    def worth_it() -> Iterator[Screened]:
        """Give what is worth a fit by what is known when a core is free."""
        for item in chosen:
            if item.score < HOPELESS * gained:
                return
            yield item

    results = _fit_each(finding, judging, state, worth_it(), chosen, progress, workers)
    for item, one in zip(chosen, results, strict=False):
        if one is None or item.score < HOPELESS * gained:  # known only after it had begun
            continue
        fitted.append(one)
        if one.confirmed:
            gained = max(gained, 2.0 * (one.found.log_likelihood - state.found.log_likelihood))
    more = _as_promising(finding, state, screened, fitted)
    fitted += filter(None, _fit_each(finding, judging, state, more, more, progress, workers))
    _note_feigned(state, fitted)
    return fitted


def _fit_each(
    finding: Problem,
    judging: Problem,
    state: Search,
    items: Iterable[Screened],
    chosen: Sequence[Screened],
    progress: Progress,
    workers: int,
) -> Iterator[Fitted | None]:
    """Give screened effects fitted beside the causes of `state`, in their order."""
    base = Fitted(state.found, state.judged)
    pool = Parallel(n_jobs=workers, return_as='generator', batch_size=1, pre_dispatch='n_jobs')
    jobs = (delayed(_fit_one)(finding, judging, base, state.tried, item) for item in items)
    for number, one in enumerate(pool(jobs), 1):
        progress('fitting', number, len(chosen))
        yield one


def _fit_one(
    finding: Problem, judging: Problem, base: Fitted, tried: int, item: Screened
) -> Fitted | None:
    """Return a screened effect fitted beside the causes of `base`; None if the machine blows up."""
    try:
        start = _start(finding, base.found, item)
        found = downhill(finding, start, fit_causes(finding, (*base.found.causes, start)))
        one = Fitted(found, evaluate(judging, found.causes))
    except UserError:
        return None
    return weighed(finding, judging, base, one, price(found, base.found, tried))


def _note_feigned(state: Search, fitted: Sequence[Fitted]) -> None:
    """Note what only noise in the current loop speaks for: it is not fitted again."""
    state.feigned.update(item.found.causes[-1].name for item in fitted if item.feigned)


def _as_promising(
    problem: Problem, state: Search, screened: Sequence[Screened], fitted: Sequence[Fitted]
) -> list[Screened]:
    """Return what is not fitted yet, but promised about as much as the best that is confirmed."""
    confirmed = [item for item in fitted if item.confirmed]
    if not confirmed:
        return []
    best = min(confirmed, key=lambda item: item.information_criterion).found.causes[-1]
    block = set(_touched(problem, best))
    promised = {
        item.cause.name: item.score + item.cause.free * math.log(state.found.samples)
        for item in reversed(screened)
    }
    done = {item.found.causes[-1].name for item in fitted}
    found: dict[str, Screened] = {}
    for item in screened:
        name = item.cause.name
        alike = promised[name] > promised.get(best.name, math.inf) - 2.0 * TELLS_APART
        shared = block.intersection(_touched(problem, item.cause))
        if alike and shared and name not in done:
            found.setdefault(name, item)
    return list(found.values())[:FITTED]


def fit_exact(
    finding: Problem,
    judging: Problem,
    state: Search,
    screened: Sequence[Screened],
    singles: Sequence[Fitted],
    progress: Progress,
    workers: int = 1,
) -> list[Fitted]:
    """
    Fit what changes nothing but an exact block that plainly does something else, whatever it promised.

    Of single bits, and of a limit between two rungs, what is screened says little. Only on axes where
    that is so with the best of `singles`, too; if this acts there, limits alone, from all their shapes:
    one that acts at once may stand in for one that acts after a time.
    """
    best = _best_confirmed(state, singles)
    new = best.causes[len(state.found.causes) :]
    done = {item.found.causes[-1].name for item in singles}
    chosen: dict[tuple[str, tuple[float, ...]], Screened] = {}
    for block in finding.exact_blocks:
        changed = {cause.axis for cause in new if block in _touched(finding, cause)}
        axes = finding.plain_axes(block, best.residuals[block])
        for item in screened:
            cause = item.cause
            if _touched(finding, cause) != (block,) or cause.axis not in axes:
                continue
            if cause.effect.threshold:
                shape = tuple(_shape(finding, cause).values())
                chosen.setdefault((cause.name, shape), item)
            elif cause.axis not in changed and cause.name not in done:
                chosen.setdefault((cause.name, ()), item)
    each = list(chosen.values())
    found = list(filter(None, _fit_each(finding, judging, state, each, each, progress, workers)))
    _note_feigned(state, found)
    return found


def _best_confirmed(state: Search, singles: Sequence[Fitted]) -> Hypothesis:
    """Return the best single cause beside those of `state` that is confirmed; without one, `state`."""
    confirmed = [item.found for item in singles if item.confirmed]
    return min(confirmed, key=lambda item: item.information_criterion, default=state.found)


def _touched(problem: Problem, cause: Cause) -> tuple[str, ...]:
    """Return the blocks that a cause can change."""
    return problem.touched(cause.effect, cause.axis)


def fit_pairs(
    finding: Problem,
    judging: Problem,
    state: Search,
    screened: Sequence[Screened],
    singles: Sequence[Fitted],
    progress: Progress,
    workers: int = 1,
) -> list[Fitted]:
    """
    Fit pairs of causes in blocks that leave nothing over if they are right, where singles leave some.

    Two wrong settings of a controller partly make up for each other, and a third one may stand in
    for both; with the right two the residual is zero.
    """
    best = _best_confirmed(state, singles)
    pool = Parallel(n_jobs=workers, batch_size=1)
    pairs: list[tuple[Cause, Cause]] = []
    for block in finding.exact_blocks:
        axes = finding.plain_axes(block, best.residuals[block])
        chosen: dict[str, Screened] = {}
        for item in screened:
            alone = _touched(finding, item.cause) == (block,)
            if alone and item.score > 0.0 and item.cause.axis in axes and len(chosen) < PAIRED:
                chosen.setdefault(item.cause.name, item)
        starts = filter(
            None, pool(delayed(_try_start)(finding, state.found, item) for item in chosen.values())
        )
        pairs += [
            (one, other)
            for one, other in itertools.combinations(starts, 2)
            if one.axis == other.axis
        ]
    base = Fitted(state.found, state.judged)
    pool = Parallel(n_jobs=workers, batch_size=1, return_as='generator')
    jobs = (delayed(_fit_pair)(finding, judging, base, best, state.tried, pair) for pair in pairs)
    found: list[Fitted] = []
    for number, one in enumerate(pool(jobs), 1):
        progress('fitting pairs', number, len(pairs))
        found += [one] if one else []
    return found


def _try_start(problem: Problem, base: Hypothesis, item: Screened) -> Cause | None:
    """Return a screened cause where its fit begins; None if the machine blows up."""
    try:
        return _start(problem, base, item)
    except UserError:
        return None


def _fit_pair(
    finding: Problem,
    judging: Problem,
    base: Fitted,
    best: Hypothesis,
    tried: int,
    pair: tuple[Cause, Cause],
) -> Fitted | None:
    """Return a pair fitted beside the causes of `base`; None if it gains little beside `best`."""
    try:
        both = fit_causes(finding, (*base.found.causes, *pair))
        one = Fitted(both, evaluate(judging, both.causes))
    except UserError:
        return None
    if 2.0 * (both.log_likelihood - best.log_likelihood) <= price(both, best, tried):
        return None
    return weighed(finding, judging, base, one, price(both, base.found, tried))


def most_promising(problem: Problem, screened: Sequence[Screened]) -> list[Screened]:
    """Return the best screened effects, each with those trials that promise as much as its best."""
    chosen: dict[str, list[Screened]] = {}
    for item in screened:
        name = item.cause.name
        if item.score <= 0.0 or (name not in chosen and len(chosen) == FITTED):
            continue
        trials = chosen.setdefault(name, [])
        if not trials or (len(trials) < TRIALS and _another_trial(problem, item, trials)):
            trials.append(item)
    return sorted(
        (item for trials in chosen.values() for item in trials), key=lambda item: -item.score
    )


def _another_trial(problem: Problem, item: Screened, trials: Sequence[Screened]) -> bool:
    """
    Return whether a trial of an effect is worth a fit beside better ones.

    It promises as much, or it is the best rung of another shape: what a limit promises on a rung says
    little about what it does between two.
    """
    if not item.cause.effect.threshold:
        return trials[0].score - item.score < TELLS_APART
    own = _shape(problem, item.cause)
    return all(own != _shape(problem, other.cause) for other in trials)


def _shape(problem: Problem, cause: Cause) -> dict[str, float]:
    """Return the trial that a rung belongs to."""
    return {
        item.name: cause.values[item.name] for item in parameters_of(problem, cause) if item.shape
    }


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
    if may_ring(problem, start) and not far(base):
        return tuned(problem, base, start)
    return start


def price(more: Hypothesis, fewer: Hypothesis, tried: int) -> float:
    """Return what `more` has to gain in 2 ln L over `fewer`."""
    return price_of(more.parameters - fewer.parameters, more.samples, tried)
