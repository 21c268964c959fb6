# SPDX-License-Identifier: Apache-2.0
"""
Does an extension win on logs that were not used for the fit? If not, it is withdrawn.

First its rivals are asked: of causes that the logs cannot tell apart in their blocks, one may win in
closed loop where another does not. Then one cause alone is withdrawn: among many that each explain a
little there may be one that makes the loop swing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.rivalry import exchanged
from waferbot_twin.diagnosis.search_state import TELLS_APART, Search
from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate
from waferbot_twin.residuals.problem import Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array
from waferbot_twin.validation.gain import AxisGain, gains

LOSES = 0.02
"""Relative rise of the square error, summed over the axes, up to which nothing is lost: 1 % in RMS."""

MUCH = 0.5
"""The same rise from which on it does not matter in how few stretches: 22 % in RMS."""

STRETCHES, PLAINLY = 20, 3.0
"""Into how many stretches a log is divided, and how many standard errors are plain."""


def that_wins(problem: Problem, judge: Problem, found: Search, notes: list[str]) -> Search | None:
    """
    Return the search with causes that win on the logs for judging, or None if none do.

    Those found, or with a rival that the logs cannot tell in place of one of them, or without one. If
    none do, `notes` say what does not even run. Raises `UserError` if the nominal model does not run.
    """
    reasons = []
    # One after another: a rival costs a fit, and mostly what was found wins.
    candidates = itertools.chain(
        [found],
        _with_rivals(problem, judge, found),
        _without_the_worst(problem, judge, found),
    )
    for candidate in candidates:
        causes = candidate.found.causes
        try:
            extension = _gains(judge, causes)
        except UserError as error:
            if not causes:
                raise
            reasons.append(f'the extended model does not run in closed loop ({error})')
            continue
        if not loses(extension):
            return candidate
    notes += dict.fromkeys(reasons)
    return None


def _gains(judge: Problem, causes: Sequence[Cause]) -> list[AxisGain]:
    """
    Return what causes gain in the logs for judging, beside what is evident from the readings.

    That is not in question: on the steps of a coarse encoder the machine hunts and the true model does,
    but not in step, and an RMS error does not show it. Raises `UserError` if the machine is unstable.
    """
    evident = [cause for cause in causes if cause.effect.evident]
    return gains(
        apply_all(judge.nominal, evident), apply_all(judge.nominal, causes), judge.records
    )


def _with_rivals(problem: Problem, judge: Problem, found: Search) -> Iterator[Search]:
    """Give the search with each rival that the logs cannot tell in place of its cause."""
    for place, cause in enumerate(found.found.causes):
        rivals = found.rivals.get(cause.name, [])
        for rival in sorted(rivals, key=lambda item: item.less_likely):
            if rival.less_likely > TELLS_APART:
                continue
            try:
                yield exchanged(problem, judge, found, place, rival)
            except UserError:
                continue


def _without_the_worst(problem: Problem, judge: Problem, found: Search) -> Iterator[Search]:
    """Give the search without one cause on the axis that loses most: the one that does the harm."""
    causes = found.found.causes
    if len(causes) < 2:
        return
    try:
        extension = _gains(judge, causes)
    except UserError:
        extension = []
    most = max(extension, key=_ratio, default=None)
    best, least = causes, math.inf
    for place, cause in enumerate(causes):
        if most is not None and cause.axis != most.axis:
            continue
        fewer = (*causes[:place], *causes[place + 1 :])
        try:
            axis_gains = _gains(judge, fewer)
        except UserError:
            continue
        error = sum(_ratio(item) ** 2 for item in axis_gains)
        if error < least:
            best, least = fewer, error
    if best is not causes:
        left = replace(evaluate(problem, best), covariance=_covariance(problem, found.found, best))
        yield replace(found, found=left, judged=evaluate(judge, best))


def _covariance(problem: Problem, found: Hypothesis, left: Sequence[Cause]) -> Array:
    """Return the covariance of the parameters of the causes that are left, as if the others were not."""
    every = names_of(problem, found.causes)
    if len(every) != len(found.covariance):
        return np.zeros((0, 0))
    kept = np.array([found.causes[place] in left for place, _ in every], bool)
    scale = np.sqrt(np.maximum(np.diag(found.covariance), np.finfo(float).tiny))
    information = np.linalg.pinv(found.covariance / np.outer(scale, scale))[np.ix_(kept, kept)]
    return np.asarray(np.linalg.pinv(information) * np.outer(scale[kept], scale[kept]))


def _ratio(item: AxisGain) -> float:
    """Return the RMS error of the extended model over that of the nominal one."""
    return item.rms_after / item.rms_before if item.rms_before > 0.0 else 0.0


def loses(axis_gains: Sequence[AxisGain]) -> bool:
    """
    Return whether the extension plainly loses more on some axes than it wins on others.

    The change of the square error, relative to that before and summed over the axes, is taken for each
    of some stretches of a log. It loses if their mean is above `LOSES` and so many standard errors
    above zero, or if it is `MUCH`: the machine's noise in one run makes even the true model lose a
    little somewhere. A slow force in the noise moves an axis by a count for as long as a log is, and a
    wrong model may make up for that by chance: so it must lose without the means of the errors, too.

    Many causes in the drive hardly move a position: whether that wins or loses a millionth says nothing.
    """
    return _rises(axis_gains, centred=False) and _rises(axis_gains, centred=True)


def _rises(axis_gains: Sequence[AxisGain], centred: bool) -> bool:
    """Return whether square errors rise plainly, as they are or `centred`, without their means."""
    by_log: dict[str, list[Array]] = {}
    for item in axis_gains:
        if len(item.error_before) >= STRETCHES:
            change = _change_of_square_error(item, centred)
            by_log.setdefault(item.log, []).append(change)
    if not by_log:
        return False
    changes = np.concatenate([np.sum(of_axes, axis=0) for of_axes in by_log.values()])
    mean = float(np.mean(changes))
    standard_error = float(np.std(changes, ddof=1)) / math.sqrt(len(changes))
    return mean > min(max(LOSES, PLAINLY * standard_error), MUCH)


def _change_of_square_error(item: AxisGain, centred: bool) -> Array:
    """Return it for each stretch of a log, in mean square errors of the whole log before."""
    before, after = (
        error - np.mean(error) if centred else error
        for error in (item.error_before, item.error_after)
    )
    whole = float(np.mean(before**2))
    if whole == 0.0:
        return np.zeros(STRETCHES)
    parts = np.array_split(after**2 - before**2, STRETCHES)
    return np.array([float(np.mean(part)) for part in parts]) / whole
