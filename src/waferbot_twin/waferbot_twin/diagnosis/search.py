# SPDX-License-Identifier: Apache-2.0
"""
From residuals to causes.

1. **Screen** (`screening_rounds`): every effect on every axis, linearly.
2. **Fit** (`shortlist`, `gauss_newton`): the best few through the simulation, with all causes found so
   far; in pairs, too, where a block that should leave nothing over still does.
3. **Decide.** The best one is taken if the logarithm of its likelihood pays for its parameters and for
   the number M of effects that were tried,

       2 (ln L_1 - ln L_0) > k ln N + 4 ln M,

   and if the logs kept for judging, with another motion, become more likely too.
4. Again from 1 until nothing is taken, then also of compliances that ring too briefly for a line
   (`compliance_scan`). If what is left of the plant is far too large for noise, and the cause taken
   does not change that where it changes most, everything usual is fitted together once
   (`together`), and the search goes on from there. Then each cause is taken out in turn, to see
   whether the others can do without it, and chosen again beside those that may have bent it.

Of everything that was fitted in place of a cause, what explains the logs as well is kept: these cannot
be told apart from it with this data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.confirmation import Fitted
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.diagnosis.screening_rounds import Rounds
from waferbot_twin.diagnosis.search_state import (
    TELLS_APART,
    Rival,
    Score,
    Search,
    preferred,
)
from waferbot_twin.diagnosis.shortlist import fit_best, fit_exact, fit_pairs
from waferbot_twin.diagnosis.together import (
    Together,
    far,
    far_channels,
    fit_together,
    gain_from_afar,
    price_of,
    take_out,
    unpredictable_parts,
    usual_causes,
)
from waferbot_twin.estimation.gauss_newton import fit_causes, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.estimation.intervals import AS_LIKELY
from waferbot_twin.residuals.problem import PLANT, Cause, Problem

MOST_ROUNDS = 8
"""How many causes are looked for one at a time."""

REVISIONS, MOST_REVISED = 8, 4
"""How many causes are chosen again beside the others, and of how many."""

BENT = 0.1
"""Correlation of estimates from which on one cause may have bent another."""


def search(rounds: Rounds, judging: Problem, known_causes: Search | None = None) -> Search:
    """
    Find the causes in the logs of `rounds` that also explain those of `judging`.

    Beside those that another search has found, if there is one: they are fitted anew to these logs. Of
    those in an exact block that still leave some over, the others showed too little: they are looked for
    anew, too.
    """
    finding, progress, workers = rounds.problem, rounds.progress, rounds.workers
    nothing, judged_nothing = evaluate(finding), evaluate(judging)
    state = Search(nothing, judged_nothing, nothing, judged_nothing)
    if known_causes:
        state.found = fit_causes(finding, known_causes.found.causes, workers=workers)
        causes = _that_suit(finding, state.found)
        if causes != state.found.causes:
            state.found = fit_causes(finding, causes, workers=workers)
        state.judged = evaluate(judging, state.found.causes)
        state.gains, state.rivals = dict(known_causes.gains), dict(known_causes.rivals)
        state.trials = dict(known_causes.trials)
        state.feigned = set(known_causes.feigned)
    at_first = len(state.found.causes)
    rounds.begin(state.found)
    together = False
    for _ in range(MOST_ROUNDS):
        before = state.found
        screened = rounds.screen(state.found)
        state.tried += len(screened)
        fitted = fit_best(finding, judging, state, screened, progress, workers)
        _note_trials(state, fitted)
        fitted += fit_exact(finding, judging, state, screened, fitted, progress, workers)
        fitted += fit_pairs(finding, judging, state, screened, fitted, progress, workers)
        taken = _take_best(finding, judging, state, fitted)
        stands_in = not taken or _leaves_far(before, state.found)
        fresh = not together and far(state.found) and stands_in
        if fresh:
            together = True
            _take_together(judging, state, rounds)
            # Fitted to these logs the model may seem near, and be as far off as before in others.
            state.far_off = far(state.found) or far(state.judged)
            if state.far_off:
                return state
        if not (taken or fresh or _take_damped_ring(judging, state, rounds)):
            break
    if known_causes and len(state.found.causes) == at_first:
        return state
    _confirm(finding, judging, state, progress, workers)
    _revise(judging, state, rounds)
    state.far_off = far(state.found)
    return state


def _that_suit(problem: Problem, found: Hypothesis) -> tuple[Cause, ...]:
    """Return the causes without those that act on an exact block alone and leave some over there."""
    plain = {
        block: problem.plain_axes(block, found.residuals[block]) for block in problem.exact_blocks
    }
    return tuple(
        cause
        for cause in found.causes
        if not any(
            problem.touched(cause.effect, cause.axis) == (block,) and cause.axis in axes
            for block, axes in plain.items()
        )
    )


def _leaves_far(before: Hypothesis, found: Hypothesis) -> bool:
    """
    Return whether what was taken last leaves the channel far from the machine that it changes most.

    Then it stands in for others there. A cause in the drive or the controller changes none.
    """
    if PLANT not in found.fits:
        return False
    changes = np.log(np.divide(unpredictable_parts(before), unpredictable_parts(found)))
    most = int(np.argmax(changes))
    return changes[most] > 0.0 and far_channels(before)[most] and far_channels(found)[most]


def _take_together(judging: Problem, state: Search, rounds: Rounds) -> None:
    """
    Fit all usual effects beside what was found; keep what is needed if the logs agree.

    An unusual cause of the plant's motion that was found while all these lacked stood in for them.
    """
    finding = rounds.problem
    kept = tuple(
        cause
        for cause in state.found.causes
        if cause.effect.usual or PLANT not in finding.touched(cause.effect, cause.axis)
    )
    causes = (*kept, *usual_causes(finding, rounds.effects, kept))
    try:
        result = fit_together(
            finding, judging, causes, state.tried, rounds.progress, rounds.workers
        )
        gained = gain_from_afar(finding, state.found, result.found)
        confirmed = gain_from_afar(judging, state.judged, result.judged)
    except UserError:
        return
    more = result.found.parameters - state.found.parameters
    if gained > price_of(more, state.found.samples, state.tried) and confirmed > 0.0:
        _take(state, result)


def _take_damped_ring(judging: Problem, state: Search, rounds: Rounds) -> bool:
    """
    Take the best of the compliances that ring too briefly for a line, if there is one.

    They are tried one value after another, so only where nothing else is found and the model is near.
    """
    if far(state.found) or far(state.judged):
        return False
    screened = rounds.damped_rings(state.found)
    state.tried += len(screened)
    fitted = fit_best(rounds.problem, judging, state, screened, rounds.progress, rounds.workers)
    _note_trials(state, fitted)
    return _take_best(rounds.problem, judging, state, fitted)


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
    _take(
        state,
        take_out(finding, judging, state.found, far(state.found), state.tried, progress, workers),
    )


def _revise(judging: Problem, state: Search, rounds: Rounds) -> None:
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
            and _bent(rounds.problem, state.found, cause)
        ]
        if not open_ones:
            return
        beside = _names_beside(causes, open_ones[0])
        _choose_again(judging, state, open_ones[0], rounds)
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


def _choose_again(judging: Problem, state: Search, cause: Cause, rounds: Rounds) -> None:
    """Put the best of what else could stand there in the place of a cause, if it is better."""
    finding, progress, workers = rounds.problem, rounds.progress, rounds.workers
    others = tuple(other for other in state.found.causes if other.name != cause.name)
    try:
        found = fit_causes(finding, others)
        fewer = replace(state, found=found, judged=evaluate(judging, found.causes))
        present = fit_causes(finding, (*found.causes, cause))
        as_it_is = Fitted(present, evaluate(judging, present.causes), confirmed=True)
    except UserError:  # the machine does not stand without it
        return
    screened = rounds.screen(found)
    gained = 2.0 * (present.log_likelihood - found.log_likelihood)
    # Far from zero it may gain many times what it promises, and so may a rival.
    promised = max(
        (item.score for item in screened if item.cause.name == cause.name), default=gained
    )
    rivals = [item for item in screened if item.cause.name != cause.name]
    fitted = fit_best(finding, judging, fewer, rivals, progress, workers, min(gained, promised))
    _note_trials(fewer, fitted)
    _take_best(finding, judging, fewer, [as_it_is, *fitted])
    state.found, state.judged = fewer.found, fewer.judged
    names = {item.name for item in state.found.causes}
    state.gains = {name: gain for name, gain in fewer.gains.items() if name in names}
    state.rivals = {name: rivals for name, rivals in fewer.rivals.items() if name in names}


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
    scores = [
        Score(item.information_criterion, item.log_likelihood, item.found.parameters)
        for item in confirmed
    ]
    taken = confirmed[preferred(scores)]
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
        *others, last = item.found.causes
        rival = Rival(
            last,
            item.information_criterion - taken.information_criterion,
            2.0 * (taken.log_likelihood - item.log_likelihood),
            2.0 * (taken.found.log_likelihood - item.found.log_likelihood),
            tuple(others),
        )
        # Else it was refuted, however likely it is.
        if item.confirmed or item.possible or rival.behind >= 0.0:
            rivals.setdefault(rival.cause.name, rival)
    rivals.pop(taken.found.causes[-1].name, None)
    return list(rivals.values())


def _note_trials(state: Search, fitted: Sequence[Fitted]) -> None:
    """Note for every cause which of the trials that it was fitted from do as well as the best."""
    by_name: dict[str, list[Hypothesis]] = {}
    for item in fitted:
        if item.confirmed and len(item.found.causes) == len(state.found.causes) + 1:
            by_name.setdefault(item.found.causes[-1].name, []).append(item.found)
    for name, trials in by_name.items():
        best = max(trials, key=lambda found: found.log_likelihood)
        state.trials[name] = [
            found.causes[-1]
            for found in trials
            if found is not best and 2.0 * (best.log_likelihood - found.log_likelihood) < AS_LIKELY
        ]


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
