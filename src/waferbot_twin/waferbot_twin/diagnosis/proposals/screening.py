# SPDX-License-Identifier: Apache-2.0
"""
Screening: every effect of the library on every axis, fitted linearly to what is left over.

The signature of an effect, what a little of it changes in the residuals, comes from the simulation
itself, so a new effect needs no formula of its own here. The plant takes steps of the encoders' cycle
for it (`Problem.quick`). Signatures are found once, with the causes that were known then; a later round
finds anew only those that look most likely.

An effect that changes the structure of a machine as soon as there is any of it, and only then grows in
proportion, begins where there is a little: what that little changes is taken from the residuals first.

An effect with a threshold changes nothing while there is little of it. It is tried on a
`threshold_grid`, and its signature is the whole of what it changes there, as it is or fitted with a
factor; so is that of an effect whose size the logs show themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.repetition import can_repeat
from waferbot_twin.diagnosis.proposals.threshold_grid import rungs
from waferbot_twin.effects.effect import Effect, Parameter
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    in_quick_steps,
    parameters_of,
    signature,
    whole_change,
)
from waferbot_twin.estimation.stacked_least_squares import (
    Residuals,
    Signature,
    by_channel,
    fit_jointly,
    side_by_side,
)
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much is done and how much there is."""

CHUNK = 8
"""Candidates that a worker takes at a time."""


@dataclass(frozen=True)
class Change:
    """
    What a candidate changes in the residuals: a `signature` by block, as in `stacked_least_squares`.

    `there` is what the little of it that there is changes already: arrays (samples of all channels,),
    by block; of most there is none.
    """

    signature: Signature
    there: Mapping[str, Array]


@dataclass(frozen=True)
class Screened:
    """
    A candidate with its linear fit.

    `score` is 2 (ln L_1 - ln L_0) - k ln N; `value` the change of its parameters from where they are.
    """

    cause: Cause
    score: float
    value: Array


def candidates(problem: Problem, effects: Iterable[Effect]) -> list[Cause]:
    """Return every effect on every axis where the logs could show it, with none of it yet."""
    found: list[Cause] = []
    for effect in effects:
        for axis in effect.distinct_axes(problem.nominal):
            if not problem.touched(effect, axis):
                continue
            parameters = effect.parameters(problem.nominal, axis)
            held = tuple(item.name for item in parameters if item.fixed)
            for trial in effect.trials(problem.nominal, axis):
                values = {
                    item.name: trial.get(
                        item.name,
                        item.typical
                        if item.shape
                        else item.neutral + effect.begins_at * (item.typical - item.neutral),
                    )
                    for item in parameters
                }
                cause = Cause(effect, axis, values, held)
                if not can_repeat(problem, cause):
                    continue
                sized = any(not item.shape and item.name in trial for item in parameters)
                found += rungs(problem, cause) if effect.threshold and not sized else [cause]
                found += _tried(parameters, cause)
    return found


def _tried(parameters: Sequence[Parameter], cause: Cause) -> Iterator[Cause]:
    """Give an effect that the model has none of in the sizes at which it is tried."""
    for times in cause.effect.tried_at:
        values = {
            item.name: min(item.typical * times, item.high)
            for item in parameters
            if item.neutral == 0.0 and not item.shape
        }
        if values:
            yield cause.with_values(values)


def signatures(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    workers: int,
    progress: Progress,
) -> list[Change | None]:
    """
    Return what every rival changes beside the causes of `base`.

    None for one with which the simulation blows up.
    """
    quick, begun = in_quick_steps(problem, base)
    chunks = [rivals[first : first + CHUNK] for first in range(0, len(rivals), CHUNK)]
    found: list[Change | None] = []
    pool = Parallel(n_jobs=workers, return_as='generator')
    for part in pool(delayed(_signatures)(quick, begun, chunk) for chunk in chunks):
        found += part
        progress('screening', len(found), len(rivals))
    return found


def _signatures(
    problem: Problem, base: Hypothesis, rivals: Sequence[Cause]
) -> list[Change | None]:
    found: list[Change | None] = []
    for rival in rivals:
        causes = (*base.causes, rival)
        try:
            change = _change(problem, base, causes)
        except UserError:
            found.append(None)
            continue
        sound = all(np.isfinite(matrix).all() for matrix in change.signature.values())
        found.append(change if sound else None)
    return found


def _change(problem: Problem, base: Hypothesis, causes: tuple[Cause, ...]) -> Change:
    """Return what the last of `causes` changes; raises `UserError` if the simulation blows up."""
    rival = causes[-1]
    if _tried_as_a_whole(problem, rival):
        return Change(whole_change(problem, base, causes), {})
    if rival.effect.begins_at == 0.0:
        return Change(signature(problem, base, causes, len(causes) - 1), {})
    begun = evaluate(problem, causes)
    return Change(
        signature(problem, begun, causes, len(causes) - 1),
        {block: column[:, 0] for block, column in whole_change(problem, base, causes).items()},
    )


def screen(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    of_rivals: Sequence[Change | None],
    of_base: Sequence[Signature],
    workers: int = 1,
) -> list[Screened]:
    """Fit every rival linearly, each beside the causes of `base`; best first."""
    asked = [pair for pair in zip(rivals, of_rivals, strict=True) if pair[1] is not None]
    chunks = [asked[first : first + CHUNK] for first in range(0, len(asked), CHUNK)]
    pool = Parallel(n_jobs=workers if len(chunks) > 1 else 1)
    parts = pool(delayed(_screen)(problem, base, chunk, of_base) for chunk in chunks)
    found = [item for part in parts for item in part]
    return sorted(found, key=lambda item: (-item.score, item.cause.name))


def _screen(
    problem: Problem,
    base: Hypothesis,
    asked: Sequence[tuple[Cause, Change]],
    of_base: Sequence[Signature],
) -> list[Screened]:
    found = []
    for rival, change in asked:
        shown = {block: matrix for block, matrix in change.signature.items() if matrix.any()}
        if not shown:
            continue
        parameters = rival.free
        whole = _tried_as_a_whole(problem, rival)
        count = 1 if whole else parameters
        beside = [item for item in of_base if shown.keys() & item.keys()]
        everything = side_by_side(
            [
                shown,
                *({block: item[block] for block in shown if block in item} for item in beside),
            ],
            [count, *(next(iter(item.values())).shape[1] for item in beside)],
        )
        residuals = _with_change(base.residuals, change.there)
        known = {} if change.there else base.fits
        estimate = fit_jointly(problem, residuals, everything, rounds=2, known=known)
        if rival.effect.tone in rival.narrow:  # a strong tone may pass for the colour of the noise
            other = fit_jointly(
                problem, residuals, everything, rounds=2, from_white=True, known=known
            )
            estimate = max(estimate, other, key=lambda item: item.log_likelihood)
        before = sum(base.fits[block].log_likelihood for block in shown)
        gain = 2.0 * (estimate.log_likelihood - before)
        value = estimate.value[:count]
        if whole:
            as_tried = _gain_as_tried(problem, base, shown)
            possible = value[0] > 0.0 or as_tried > gain
            # Half of the steps that readings show themselves is not to be had.
            gain = as_tried if rival.effect.evident else max(gain, as_tried)
            value = np.zeros(parameters)
        else:
            possible = _possible(problem, rival, value)
        if possible:
            found.append(Screened(rival, gain - parameters * math.log(base.samples), value))
    return found


def _gain_as_tried(problem: Problem, base: Hypothesis, shown: Signature) -> float:
    """
    Return what a candidate gains in 2 ln L in the size in which it is tried.

    Where the model is far from the machine a linear fit does not find that: its noise is as smooth as
    the change, and whitening takes out both.
    """
    changed = {block: matrix[:, 0] for block, matrix in shown.items()}
    residuals = _with_change({block: base.residuals[block] for block in shown}, changed)
    return sum(
        2.0 * (fit.log_likelihood - base.fits[block].log_likelihood)
        for block, fit in problem.judge(residuals).items()
    )


def _with_change(residuals: Residuals, there: Mapping[str, Array]) -> Residuals:
    """Return residuals with what a little of a candidate changes."""
    return {
        block: [
            one + more
            for one, more in zip(channels, by_channel(there[block], channels), strict=True)
        ]
        if block in there
        else channels
        for block, channels in residuals.items()
    }


def _tried_as_a_whole(problem: Problem, rival: Cause) -> bool:
    """Return whether there is something of a candidate already, as a trial or on a rung."""
    return rival.effect.begins_at == 0.0 and any(
        not item.shape and rival.values[item.name] != item.neutral
        for item in rival.effect.parameters(problem.nominal, rival.axis)
    )


def _possible(problem: Problem, rival: Cause, value: Array) -> bool:
    """Return whether a linear estimate asks for anything that the bounds of the effect allow."""
    parameters = parameters_of(problem, rival)
    return any(
        not item.shape
        and np.clip(rival.values[item.name] + change, item.low, item.high) != item.neutral
        for item, change in zip(parameters, value, strict=True)
    )
