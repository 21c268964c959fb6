# SPDX-License-Identifier: Apache-2.0
"""
From residuals to causes.

1. **Screen** (`screening`): every effect on every axis, linearly.
2. **Fit** (`fitting`): the best few through the simulation, with all causes found so far; in pairs,
   too, where a block that should leave nothing over still does.
3. **Decide.** The best one is taken if the logarithm of its likelihood pays for its parameters and for
   the number M of effects that were tried,

       2 (ln L_1 - ln L_0) > k ln N + 4 ln M,

   and if the logs kept for judging, with another motion, become more likely too.
4. Again from 1 until nothing is taken. If what is left of the plant is far too large for noise,
   everything usual is fitted together once (`together`), and the search goes on from there. Then each
   cause is taken out in turn, to see whether the others can do without it.

Of everything that was fitted in place of a cause, what explains the logs as well is kept: these cannot
be told apart from it with this data.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.confirmation import Fitted, weighed
from waferbot_twin.diagnosis.fitting import fit_causes, moved, names_of
from waferbot_twin.diagnosis.hypothesis import Hypothesis, evaluate, parameters_of, signature
from waferbot_twin.diagnosis.jointly import Signature
from waferbot_twin.diagnosis.problem import Cause, Problem
from waferbot_twin.diagnosis.resonances import may_ring, screen_lines, tuned
from waferbot_twin.diagnosis.rungs import between_rungs
from waferbot_twin.diagnosis.screening import (
    Progress,
    Screened,
    candidates,
    screen,
    signatures,
)
from waferbot_twin.diagnosis.together import (
    Together,
    far,
    fit_together,
    gain_from_afar,
    price_of,
    take_out,
    usual_causes,
)
from waferbot_twin.diagnosis.tones import at_tones
from waferbot_twin.effects.effect import Block, Effect

FITTED = 5
"""How many of the best screened effects are fitted through the simulation in each round."""

PLAIN = 30.0
"""Difference in 2 ln L from which on an exact block plainly does something else than its model."""

PAIRED = 5
"""How many effects of an exact block are fitted in pairs."""

TRIALS = 3
"""How many trials of an effect that promise as much are fitted."""

ANEW = 30
"""How many signatures are found anew once a cause is known."""

HOPELESS = 0.3
"""Share of the best gain so far that screening must promise for a candidate to be fitted, too."""

STRONG = 6.0
"""
Difference in Schwarz' criterion from which on evidence is strong: R. E. Kass, A. E. Raftery, Bayes
factors, Journal of the American Statistical Association 90 (1995).
"""

MOST_ROUNDS = 8
"""How many causes are looked for one at a time."""

REVISIONS, MOST_REVISED = 8, 4
"""How many causes are chosen again beside the others, and of how many."""

BENT = 0.1
"""Correlation of estimates from which on one cause may have bent another."""

TELLS_APART = 10.0
"""Difference in 2 ln L from which on one cause explains the logs better than another."""


@dataclass
class Rival:
    """
    What else was fitted in place of a cause.

    By how much it is `behind` in Schwarz' criterion, and by how much `less_likely`, 2 ln L, all logs
    together. One with more parameters may be far behind, and the logs cannot tell it all the same.
    """

    cause: Cause
    behind: float
    less_likely: float


@dataclass
class Search:
    """
    What a search found.

    `found` and `judged` are the causes in the logs for finding and for judging; `nothing` and
    `judged_nothing` the nominal model there; `gains` what each cause gained in Schwarz' criterion,
    `rivals` what was fitted in its place; `feigned` names what noise made: it is not fitted again.
    """

    found: Hypothesis
    judged: Hypothesis
    nothing: Hypothesis
    judged_nothing: Hypothesis
    gains: dict[str, float] = field(default_factory=dict)
    rivals: dict[str, list[Rival]] = field(default_factory=dict)
    feigned: set[str] = field(default_factory=set)
    tried: int = 0


def search(
    finding: Problem,
    judging: Problem,
    effects: Iterable[Effect],
    progress: Progress,
    workers: int = 1,
    known_causes: Search | None = None,
) -> Search:
    """
    Find the causes in the logs of `finding` that also explain those of `judging`.

    Beside those that another search has found, if there is one: they are fitted anew to these logs.
    """
    effects = list(effects)
    every = candidates(finding, effects)
    nothing, judged_nothing = evaluate(finding), evaluate(judging)
    state = Search(nothing, judged_nothing, nothing, judged_nothing)
    if known_causes:
        state.found = fit_causes(finding, known_causes.found.causes, workers=workers)
        state.judged = evaluate(judging, state.found.causes)
        state.gains, state.rivals = dict(known_causes.gains), dict(known_causes.rivals)
        state.feigned = set(known_causes.feigned)
    at_first = len(state.found.causes)
    known = signatures(finding, nothing, every, workers, progress)
    together = False
    for _ in range(MOST_ROUNDS):
        screened = _screen_round(finding, state.found, every, known, workers, progress)
        state.tried += len(screened)
        fitted = _fit_best(finding, judging, state, screened, progress)
        fitted += _fit_pairs(finding, judging, state, screened, fitted, progress)
        taken = _take_best(finding, judging, state, fitted)
        fresh = not together and far(state.found) and not (taken and _in_controller(state.found))
        if fresh:
            together = True
            _take_together(finding, judging, state, effects, progress, workers)
            if far(state.found):  # what is left is no noise: nothing more can be told from it
                return state
        if not (taken or fresh):
            break
    if known_causes and len(state.found.causes) == at_first:
        return state
    _confirm(finding, judging, state, progress, workers)
    _revise(finding, judging, state, every, known, workers, progress)
    return state


def _in_controller(found: Hypothesis) -> bool:
    """Return whether the last cause is one in the controller."""
    return bool(found.causes) and found.causes[-1].effect.block is Block.CONTROLLER


def _take_together(
    finding: Problem,
    judging: Problem,
    state: Search,
    effects: Sequence[Effect],
    progress: Progress,
    workers: int,
) -> None:
    """Fit all usual effects beside what was found; keep what is needed if the logs agree."""
    causes = (*state.found.causes, *usual_causes(finding, effects, state.found.causes))
    try:
        result = fit_together(finding, judging, causes, state.tried, progress, workers)
        gained = gain_from_afar(finding, state.found, result.found)
        confirmed = gain_from_afar(judging, state.judged, result.judged)
    except UserError:
        return
    more = result.found.parameters - state.found.parameters
    if gained > price_of(more, state.found.samples, state.tried) and confirmed > 0.0:
        _take(state, result)


def _take(state: Search, result: Together) -> None:
    """Make causes that were fitted together those of the search."""
    state.found, state.judged = result.found, result.judged
    state.gains = {
        cause.name: result.losses.get(cause.name, math.inf)
        - cause.free * math.log(state.found.samples)
        for cause in state.found.causes
    }
    names = set(state.gains)
    state.rivals = {name: state.rivals.get(name, []) for name in sorted(names)}


def _confirm(
    finding: Problem, judging: Problem, state: Search, progress: Progress, workers: int
) -> None:
    """Take out causes that the others can do without."""
    if len(state.found.causes) < 2:
        return
    _take(state, take_out(finding, judging, state.found, state.tried, progress, workers))


def _revise(
    finding: Problem,
    judging: Problem,
    state: Search,
    every: Sequence[Cause],
    known: Sequence[Signature | None],
    workers: int,
    progress: Progress,
) -> None:
    """
    Ask again of each cause whether another explains the logs better, now that the others are known.

    The first cause was chosen while it had to stand in for all that lacked.
    """
    settled: set[tuple[str, frozenset[str]]] = set()
    for _ in range(REVISIONS):
        causes = state.found.causes
        if not 2 <= len(causes) <= MOST_REVISED:
            return
        open_ones = [
            cause
            for cause in causes
            if (cause.name, _names_beside(causes, cause)) not in settled
            and _bent(finding, state.found, cause)
        ]
        if not open_ones:
            return
        beside = _names_beside(causes, open_ones[0])
        _choose_again(finding, judging, state, open_ones[0], every, known, workers, progress)
        settled |= {
            (cause.name, beside) for cause in state.found.causes if cause.name not in beside
        }


def _names_beside(causes: Sequence[Cause], cause: Cause) -> frozenset[str]:
    return frozenset(other.name for other in causes) - {cause.name}


def _bent(problem: Problem, found: Hypothesis, cause: Cause) -> bool:
    """Return whether the values of a cause depend on those of the others: so may its name."""
    own = np.array(
        [found.causes[place].name == cause.name for place, _ in names_of(problem, found.causes)]
    )
    deviations = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    correlation = found.covariance / np.outer(deviations, deviations)
    return bool(np.max(np.abs(correlation[np.ix_(own, ~own)]), initial=0.0) > BENT)


def _choose_again(
    finding: Problem,
    judging: Problem,
    state: Search,
    cause: Cause,
    every: Sequence[Cause],
    known: Sequence[Signature | None],
    workers: int,
    progress: Progress,
) -> None:
    """Put the best of what else could stand there in the place of a cause, if it is better."""
    others = tuple(other for other in state.found.causes if other.name != cause.name)
    try:
        found = fit_causes(finding, others)
        fewer = replace(state, found=found, judged=evaluate(judging, found.causes))
        present = fit_causes(finding, (*found.causes, cause))
        as_it_is = Fitted(present, evaluate(judging, present.causes), confirmed=True)
    except UserError:  # the machine does not stand without it
        return
    screened = [
        item
        for item in _screen_round(finding, found, every, known, workers, progress)
        if item.cause.name != cause.name
    ]
    gained = 2.0 * (present.log_likelihood - found.log_likelihood)
    fitted = [as_it_is, *_fit_best(finding, judging, fewer, screened, progress, gained)]
    _take_best(finding, judging, fewer, fitted)
    state.found, state.judged = fewer.found, fewer.judged
    names = {item.name for item in state.found.causes}
    state.gains = {name: gain for name, gain in fewer.gains.items() if name in names}
    state.rivals = {name: rivals for name, rivals in fewer.rivals.items() if name in names}


def _screen_round(
    problem: Problem,
    base: Hypothesis,
    every: Sequence[Cause],
    known: Sequence[Signature | None],
    workers: int,
    progress: Progress,
) -> list[Screened]:
    """Screen what is not yet among the causes; signatures that these change are found anew."""
    taken = {cause.name for cause in base.causes}
    places = [place for place, cause in enumerate(every) if cause.name not in taken]
    of_base = [signature(problem, base, base.causes, place) for place in range(len(base.causes))]
    rivals = [every[place] for place in places]
    screened = screen(problem, base, rivals, [known[place] for place in places], of_base)
    changed = {
        block for cause in base.causes for block in problem.touched(cause.effect, cause.axis)
    }
    stale = [
        item.cause
        for item in screened
        if changed.intersection(problem.touched(item.cause.effect, item.cause.axis))
    ][:ANEW]
    fresh = signatures(problem, base, stale, workers, progress)
    anew = screen(problem, base, stale, fresh, of_base)
    kept = [
        item
        for item in screened
        if not changed.intersection(problem.touched(item.cause.effect, item.cause.axis))
    ]
    toned = at_tones(problem, base, rivals)
    at_lines = [
        *screen_lines(problem, base, rivals),
        *screen(
            problem, base, toned, signatures(problem, base, toned, workers, progress), of_base
        ),
    ]
    return sorted([*anew, *kept, *at_lines], key=lambda item: (-item.score, item.cause.name))


def _fit_best(
    finding: Problem,
    judging: Problem,
    state: Search,
    screened: Sequence[Screened],
    progress: Progress,
    gained: float = 0.0,
) -> list[Fitted]:
    """
    Fit the best screened effects beside the causes of `state`, then what promised as much as the best.

    Those that promise much less than another has already `gained` are not, if the other is confirmed.
    """
    screened = [item for item in screened if item.cause.name not in state.feigned]
    chosen = _most_promising(finding, screened)
    fitted: list[Fitted] = []
    for number, item in enumerate(chosen):
        progress(f'fitting {item.cause.name}', number, len(chosen))
        if item.score < HOPELESS * gained:
            break
        one = _fit_one(finding, judging, state, item)
        if one is None:
            continue
        fitted.append(one)
        if one.confirmed:
            gained = max(gained, 2.0 * (one.found.log_likelihood - state.found.log_likelihood))
    for item in _as_promising(finding, state, screened, fitted):
        progress(f'fitting {item.cause.name}', len(chosen), len(chosen))
        one = _fit_one(finding, judging, state, item)
        fitted += [one] if one else []
    return fitted


def _fit_one(finding: Problem, judging: Problem, state: Search, item: Screened) -> Fitted | None:
    """Return a screened effect fitted beside the causes of `state`; None if the machine blows up."""
    try:
        start = _start(finding, state.found, item)
        found = fit_causes(finding, (*state.found.causes, start))
        one = Fitted(found, evaluate(judging, found.causes))
    except UserError:
        return None
    one = _weighed(finding, judging, state, one)
    if one.feigned:
        state.feigned.add(item.cause.name)
    return one


def _as_promising(
    problem: Problem, state: Search, screened: Sequence[Screened], fitted: Sequence[Fitted]
) -> list[Screened]:
    """Return what is not fitted yet, but promised about as much as the best that is confirmed."""
    confirmed = [item for item in fitted if item.confirmed]
    if not confirmed:
        return []
    best = min(confirmed, key=lambda item: item.information_criterion).found.causes[-1]
    block = set(problem.touched(best.effect, best.axis))
    promised = {
        item.cause.name: item.score + item.cause.free * math.log(state.found.samples)
        for item in reversed(screened)
    }
    done = {item.found.causes[-1].name for item in fitted}
    found: dict[str, Screened] = {}
    for item in screened:
        name = item.cause.name
        alike = promised[name] > promised.get(best.name, math.inf) - 2.0 * TELLS_APART
        shared = block.intersection(problem.touched(item.cause.effect, item.cause.axis))
        if alike and shared and name not in done:
            found.setdefault(name, item)
    return list(found.values())[:FITTED]


def _fit_pairs(
    finding: Problem,
    judging: Problem,
    state: Search,
    screened: Sequence[Screened],
    singles: Sequence[Fitted],
    progress: Progress,
) -> list[Fitted]:
    """
    Fit pairs of causes in blocks that leave nothing over if they are right, where singles leave some.

    Two wrong settings of a controller partly make up for each other, and a third one may stand in
    for both; with the right two the residual is zero.
    """
    confirmed = [item.found for item in singles if item.confirmed]
    best = min(confirmed, key=lambda item: item.information_criterion, default=state.found)
    found: list[Fitted] = []
    for block in finding.exact_blocks:
        left = finding.less_likely_than_nothing(block, best.residuals[block])
        if max(left, default=0.0) < PLAIN:
            continue
        chosen: dict[str, Screened] = {}
        for item in screened:
            touched = finding.touched(item.cause.effect, item.cause.axis)
            if item.score > 0.0 and touched == (block,) and len(chosen) < PAIRED:
                chosen.setdefault(item.cause.name, item)
        pairs = [
            pair
            for pair in itertools.combinations(chosen.values(), 2)
            if pair[0].cause.axis == pair[1].cause.axis
        ]
        for number, pair in enumerate(pairs):
            progress('fitting pairs', number, len(pairs))
            try:
                starts = [_start(finding, state.found, item) for item in pair]
                both = fit_causes(finding, (*state.found.causes, *starts))
                one = Fitted(both, evaluate(judging, both.causes))
            except UserError:
                continue
            gained = 2.0 * (both.log_likelihood - best.log_likelihood)
            if gained > price(both, best, state.tried):
                found.append(_weighed(finding, judging, state, one))
    return found


def _most_promising(problem: Problem, screened: Sequence[Screened]) -> list[Screened]:
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
        return between_rungs(problem, base, item.cause)
    (start,) = moved((item.cause,), names_of(problem, (item.cause,)), item.value)
    if may_ring(problem, start) and not far(base):
        return tuned(problem, base, start)
    return start


def _weighed(finding: Problem, judging: Problem, state: Search, item: Fitted) -> Fitted:
    """Return a hypothesis with whether it is to be believed beside what was found so far."""
    base = Fitted(state.found, state.judged)
    return weighed(finding, judging, base, item, price(item.found, state.found, state.tried))


def price(more: Hypothesis, fewer: Hypothesis, tried: int) -> float:
    """Return what `more` has to gain in 2 ln L over `fewer`."""
    return price_of(more.parameters - fewer.parameters, more.samples, tried)


def _take_best(
    finding: Problem, judging: Problem, state: Search, fitted: Sequence[Fitted]
) -> bool:
    """
    Take the best fitted hypothesis that pays for itself and is confirmed, if there is one.

    The best is the one that explains all logs best. One that is not the simplest of those that do about
    as well needs strong evidence.
    """
    confirmed = [item for item in fitted if item.confirmed]
    if not confirmed:
        return False
    best = min(confirmed, key=lambda item: item.information_criterion)
    least = best.log_likelihood - 0.5 * TELLS_APART
    alike = [
        item
        for item in confirmed
        if item.information_criterion - best.information_criterion <= TELLS_APART
        or item.log_likelihood > least
    ]
    fewest = min(item.found.parameters for item in alike)

    def cost(item: Fitted) -> float:
        more = item.found.parameters > fewest
        return item.information_criterion + (STRONG if more else 0.0)

    taken = min(alike, key=cost)
    taken = _released(finding, judging, taken)
    new = [cause.name for cause in taken.found.causes[len(state.found.causes) :]]
    state.gains |= dict.fromkeys(new, -_behind(taken.found, state.found))
    state.rivals |= {name: _rivals(taken, fitted) if len(new) == 1 else [] for name in new}
    state.found, state.judged = taken.found, taken.judged
    return True


def _rivals(taken: Fitted, fitted: Sequence[Fitted]) -> list[Rival]:
    """Return what else was fitted in place of the cause that was taken, the best trial of each."""
    rivals: dict[str, Rival] = {}
    for item in sorted(fitted, key=lambda item: item.information_criterion):
        rival = Rival(
            item.found.causes[-1],
            item.information_criterion - taken.information_criterion,
            2.0 * (taken.log_likelihood - item.log_likelihood),
        )
        if item.confirmed or rival.behind >= 0.0:  # else it was refuted, however likely it is
            rivals.setdefault(rival.cause.name, rival)
    rivals.pop(taken.found.causes[-1].name, None)
    return list(rivals.values())


def _released(finding: Problem, judging: Problem, taken: Fitted) -> Fitted:
    """Return a hypothesis with what the trial held free, if the logs say plainly that it is else."""
    *others, last = taken.found.causes
    if not last.held:
        return taken
    try:
        found = fit_causes(finding, (*others, replace(last, held=())))
        free = Fitted(found, evaluate(judging, found.causes))
    except UserError:
        return taken
    better = taken.information_criterion - free.information_criterion
    return free if better > TELLS_APART else taken


def _behind(item: Hypothesis, best: Hypothesis) -> float:
    return item.information_criterion - best.information_criterion


def standard_errors(hypothesis: Hypothesis) -> np.ndarray:
    """Return the standard error of every parameter, in the order of the causes."""
    return np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
