# SPDX-License-Identifier: Apache-2.0
"""
Rivals of a cause: what could stand in its place, and how well it would explain all logs.

Logs for finding may tell little of a parameter (the speed at which a friction falls, where an axis
hardly moves slowly); its value from there then suits the logs for judging badly, and the rival seems far
less likely than it is. So what does about as well in the logs for finding is fitted once more, to all
logs together, from every trial that does (a ripple of one order or another), and so is what was found.
That decides the name, by Schwarz' criterion and then by the evidence (`alike`), and what cannot be told
from it; values and gain stay those of the division into logs for finding and for judging.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.alike import weighed_by_evidence
from waferbot_twin.diagnosis.confirmation import Fitted, feigned
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.diagnosis.search_state import (
    STRONG,
    TELLS_APART,
    Rival,
    Score,
    Search,
    preferred,
)
from waferbot_twin.estimation.gauss_newton import fit_causes
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.problem import Cause, Problem

CLOSE = 2.0 * TELLS_APART
"""Difference in 2 ln L, in the logs for finding, up to which a rival is worth a fit to all logs."""

SINCE = 0.3
"""
Share of what a cause gained up to which a rival is worth that, too, if others were found since: what it
was behind may have been theirs.
"""

MOST_RIVALS = 4
"""How many rivals of a cause are fitted to all logs."""

LOST = 0.3
"""
Share of what a cause gains in the logs for judging that a rival in its place may lose there, with values
that the logs for finding tell badly.
"""


def weighed_in_all_logs(
    problem: Problem, judge: Problem, found: Search, progress: Progress, workers: int = 1
) -> Search:
    """
    Return a search whose rivals are weighed by fits to all logs together.

    A cause gives way to a rival that is better so, if with the values from the logs for finding that
    explains those for judging, too, not much worse at least (else it is `outdone`), and if it is not
    feigned by noise in the current loop (`confirmation`): that one is no rival.
    """
    every: Problem | None = None
    weighed: Hypothesis | None = None
    for place, cause in enumerate(found.found.causes):
        close = _close(found, place)
        if not close:
            continue
        every = every or Problem(problem.nominal, (*problem.records, *judge.records))
        progress(f'weighing rivals of {cause.name}', place, len(found.found.causes))
        try:
            if weighed is not found.found:
                weighed, present = found.found, fit_causes(every, found.found.causes)
        except UserError:
            return found
        found = _weighed(every, present, problem, judge, found, place, close, workers)
        found = _most_plausible(problem, judge, found, place)
    return found


def _close(found: Search, place: int) -> list[Rival]:
    """Return the rivals of a cause that may do as well in the logs for finding, the best first."""
    *_, last = found.found.causes
    cause = found.found.causes[place]
    behind = CLOSE if cause is last else max(CLOSE, SINCE * found.gains.get(cause.name, 0.0))
    rivals = [item for item in found.rivals.get(cause.name, []) if item.in_finding < behind]
    return sorted(rivals, key=lambda item: item.in_finding)[:MOST_RIVALS]


def _weighed(
    every: Problem,
    present: Hypothesis,
    problem: Problem,
    judge: Problem,
    found: Search,
    place: int,
    close: list[Rival],
    workers: int,
) -> Search:
    """
    Return the search with the close rivals of one cause weighed, and with the best in its place.

    `present` has the causes found, fitted to all logs.
    """
    causes = found.found.causes
    own = causes[place]
    others = [item for item in found.rivals[own.name] if item not in close]
    scores = [Score(present.information_criterion, present.log_likelihood, present.parameters)]
    rivals = []
    pool = Parallel(n_jobs=workers, batch_size=1)
    each = pool(
        delayed(_best_fitted)(every, causes, place, rival, found.trials.get(rival.cause.name, []))
        for rival in close
    )
    for rival, best_fitted in zip(close, each, strict=True):
        if best_fitted is None:
            others.append(rival)
            continue
        fitted, cause = best_fitted
        rivals.append(
            replace(
                rival,
                cause=cause,
                behind=fitted.information_criterion - present.information_criterion,
                less_likely=2.0 * (present.log_likelihood - fitted.log_likelihood),
            )
        )
        scores.append(
            Score(fitted.information_criterion, fitted.log_likelihood, fitted.parameters)
        )
    found = replace(found, rivals={**found.rivals, own.name: [*rivals, *others]})
    best = preferred(scores)
    return found if best == 0 else _given_way(problem, judge, found, place, rivals[best - 1])


def _most_plausible(problem: Problem, judge: Problem, found: Search, place: int) -> Search:
    """
    Return the search with a rival in place of a cause if the evidence for that is strong.

    Of a parameter that the logs tell in part Schwarz' criterion asks the whole price: Coulomb friction
    was named where Stribeck's was 15 in 2 ln L more likely and 12 by the evidence.
    """
    weighed = weighed_by_evidence(problem, judge, found, place)
    best = min(weighed, key=lambda item: item.by_evidence, default=None)
    if best is None or best.by_evidence > -STRONG:
        return found
    return _given_way(problem, judge, found, place, best.rival)


def _given_way(
    problem: Problem, judge: Problem, found: Search, place: int, rival: Rival
) -> Search:
    """
    Return the search with a better rival in place of a cause, if nothing speaks against that.

    One that noise in the current loop feigns is no rival; one that loses too much in the logs for
    judging has outdone the cause, but takes no place.
    """
    causes = found.found.causes
    own = causes[place]
    other_causes = (*causes[:place], *causes[place + 1 :])
    try:
        instead = exchanged(problem, judge, found, place, rival)
        without, with_it = (
            Fitted(evaluate(problem, some), evaluate(judge, some))
            for some in (other_causes, (*other_causes, instead.found.causes[place]))
        )
        is_feigned = feigned(problem, judge, without, with_it)
    except UserError:
        return found
    if is_feigned:
        real = [item for item in found.rivals[own.name] if item is not rival]
        return replace(found, rivals={**found.rivals, own.name: real})
    gained = 2.0 * (found.judged.log_likelihood - without.judged.log_likelihood)
    lost = 2.0 * (found.judged.log_likelihood - instead.judged.log_likelihood)
    if lost > max(TELLS_APART, LOST * gained):
        return replace(found, outdone=True)
    return instead


def _best_fitted(
    problem: Problem,
    causes: Sequence[Cause],
    place: int,
    rival: Rival,
    other_trials: Sequence[Cause],
) -> tuple[Hypothesis, Cause] | None:
    """
    Return the best fit to logs with a rival in the place of a cause, and the trial that it began at.

    Every trial in which it does as well in the logs for finding may decide. None if the machine blows
    up with each.
    """
    fits = []
    for trial in (rival.cause, *other_trials):
        with contextlib.suppress(UserError):
            fits.append((_fitted(problem, causes, place, replace(rival, cause=trial)), trial))
    return min(fits, key=lambda item: item[0].information_criterion, default=None)


def _fitted(problem: Problem, causes: Sequence[Cause], place: int, rival: Rival) -> Hypothesis:
    """
    Return a fit with a rival in the place of a cause.

    It begins with the others as they are or as they were beside the rival, whichever is more likely:
    beside a mass a friction and a cogging are an eighth larger than beside the force constant that the
    logs cannot tell from it, and a fit does not always find the way from the one to the other.

    Raises `UserError` if the machine blows up.
    """
    then = {cause.name: cause for cause in rival.beside}
    as_they_are, as_they_were = (
        (*others[:place], rival.cause, *others[place + 1 :])
        for others in (tuple(causes), tuple(then.get(cause.name, cause) for cause in causes))
    )
    if as_they_are == as_they_were:
        return fit_causes(problem, as_they_are)
    starts = []
    for start in (as_they_are, as_they_were):
        with contextlib.suppress(UserError):
            starts.append(evaluate(problem, start))
    likeliest = max(starts, key=lambda item: item.log_likelihood, default=None)
    return fit_causes(problem, likeliest.causes if likeliest else as_they_are)


def exchanged(problem: Problem, judge: Problem, found: Search, place: int, rival: Rival) -> Search:
    """
    Return the search with a rival in place of a cause, fitted to the logs for finding.

    Raises `UserError` if the machine blows up with it.
    """
    causes = found.found.causes
    cause = causes[place]
    fitted = _fitted(problem, causes, place, rival)
    judged = evaluate(judge, fitted.causes)
    others = [
        replace(
            item,
            behind=item.behind - rival.behind,
            less_likely=item.less_likely - rival.less_likely,
            in_finding=item.in_finding - rival.in_finding,
        )
        for item in found.rivals.get(cause.name, [])
        if item is not rival
    ]
    beside = (*causes[:place], *causes[place + 1 :])
    instead = [
        Rival(cause, -rival.behind, -rival.less_likely, -rival.in_finding, beside),
        *others,
    ]
    name = rival.cause.name
    return replace(
        found,
        found=fitted,
        judged=judged,
        gains={**found.gains, name: found.gains.get(cause.name, 0.0) - rival.behind},
        rivals={**found.rivals, name: instead},
    )
