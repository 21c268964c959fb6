# SPDX-License-Identifier: Apache-2.0
"""
Which logs find, and which judge.

What is not found in the logs for finding may show in the others: these change roles, with what is known
so far. If more is found so, or if values from there explain all logs plainly better, it is fitted to
them. So they do, from the beginning, where what was found does not win (a belt may slip only in the
faster motion), where the logs contradict it, or where a rival explains all logs better that loses in
those for judging; what explains all logs better stays. Either way nothing is fitted to the logs that
judge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.left_over import LeftOver, left_over
from waferbot_twin.diagnosis.proposals.screening import Progress
from waferbot_twin.diagnosis.rivalry import weighed_in_all_logs
from waferbot_twin.diagnosis.screening_rounds import Rounds
from waferbot_twin.diagnosis.search import search
from waferbot_twin.diagnosis.search_state import TELLS_APART, Search
from waferbot_twin.diagnosis.withdrawal import that_wins
from waferbot_twin.effects.effect import Effect
from waferbot_twin.residuals.problem import Cause, Problem


@dataclass(frozen=True)
class Shown:
    """
    What logs show: those of `problem` found it, and those of `judge` judged.

    Causes `withdrawn` did not win there; `rest` is what the others leave unexplained.
    """

    problem: Problem
    judge: Problem
    found: Search
    rest: LeftOver
    withdrawn: Sequence[Cause]
    notes: Sequence[str]


def shown(
    problem: Problem, judge: Problem, effects: Sequence[Effect], progress: Progress, workers: int
) -> Shown:
    """
    Return what logs show, those of `problem` asked first.

    Raises `UserError` if the nominal model does not run in their motions.
    """
    finding, judging = (Rounds(logs, effects, progress, workers) for logs in (problem, judge))
    untried = judging, finding
    notes: list[str] = []
    said: list[str] = []
    found = search(finding, judging.problem)
    if not found.far_off:
        other = _with_more(judging, finding.problem, found)
        if shows_more(other, found):
            found, finding, judging = other, judging, finding
            notes.append('the logs for judging showed more: they found, and the others judged')
    if not found.far_off:
        found = weighed_in_all_logs(finding.problem, judging.problem, found, progress, workers)
    winning = that_wins(finding.problem, judging.problem, found, said)
    if winning is None:
        other = search(judging, finding.problem)
        instead = that_wins(judging.problem, finding.problem, other, [])
        if instead is not None and instead.found.causes:
            found, winning = other, instead
            finding, judging = judging, finding
            said = ['what the logs for finding show does not win: the others found, these judged']
    if winning is None:
        withdrawn = list(found.found.causes)
        found.found, found.judged = found.nothing, found.judged_nothing
    else:
        withdrawn = taken_out(found, winning)
        found = winning
    rest = left_over(finding.problem, judging.problem, found, progress, workers)
    if (rest.contradicted or found.outdone) and not found.far_off:
        instead = _from_the_beginning(*untried)
        if instead and _explains_better(instead, found):
            found, (finding, judging), withdrawn = instead, untried, []
            rest = left_over(finding.problem, judging.problem, found, progress, workers)
            said = [
                'not all logs bear out what was found first: this was found anew in those that judged'
            ]
    notes += [*said, *rest.notes]
    return Shown(finding.problem, judging.problem, found, rest, withdrawn, notes)


def _with_more(finding: Rounds, judge: Problem, known: Search) -> Search:
    """Return what logs show beside the causes known, if these hold the machine there."""
    try:
        return search(finding, judge, known)
    except UserError:
        return known


def _from_the_beginning(finding: Rounds, judging: Rounds) -> Search | None:
    """Return what logs show with nothing known, if it wins in those that judge."""
    problem, judge = finding.problem, judging.problem
    found = search(finding, judge)
    if found.far_off:
        return None
    found = weighed_in_all_logs(problem, judge, found, finding.progress, finding.workers)
    return that_wins(problem, judge, found, [])


def taken_out(found: Search, winning: Search) -> list[Cause]:
    """Return the causes that were found, but do not win; one that a rival stands for now is none."""
    left = {cause.name for cause in winning.found.causes}
    fewer = len(left) < len(found.found.causes)
    return [cause for cause in found.found.causes if fewer and cause.name not in left]


def shows_more(other: Search, found: Search) -> bool:
    """Return whether a search in other roles found more, or values that explain all logs better."""
    return len(other.found.causes) > len(found.found.causes) or _explains_better(other, found)


def _explains_better(other: Search, found: Search) -> bool:
    """
    Return whether another search explains all logs plainly better, whatever their roles.

    By Schwarz' criterion with the samples of all logs: those for finding are not the same.
    """

    def unlikely(item: Search) -> float:
        price = item.found.parameters * math.log(item.found.samples + item.judged.samples)
        return price - 2.0 * (item.found.log_likelihood + item.judged.log_likelihood)

    return unlikely(found) - unlikely(other) > TELLS_APART
