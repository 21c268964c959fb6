# SPDX-License-Identifier: Apache-2.0
"""
Screening: every effect of the library on every axis, fitted linearly to what is left over.

The signature of an effect, what a little of it changes in the residuals, comes from the simulation
itself, so a new effect needs no formula of its own here. The plant takes steps of the encoders'
cycle for it (`Problem.quick`). Signatures are found once, with the causes that were known then; a
later round finds anew only those that look most likely.

An effect that changes the structure of a machine as soon as there is any of it, and only then
grows in proportion, begins where there is a little: the linear problem is about the model with that
little, with its own noise.

An effect with a threshold changes nothing while there is little of it. It is tried on a
`threshold_grid`, and its signature is the whole of what it changes there, as it is or fitted with a
factor; so is that of an effect whose size the logs show themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.repetition import can_repeat
from waferbot_twin.diagnosis.proposals.threshold_grid import rungs
from waferbot_twin.effects.effect import Effect, Parameter
from waferbot_twin.estimation.evidence import log_occam
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    evaluate,
    in_quick_steps,
    log_likelihood_ratio,
    parameters_of,
    signature,
    whole_change,
)
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel, side_by_side
from waferbot_twin.noise_model.prediction_error import Colour, in_deviations
from waferbot_twin.noise_model.residual_spectrum import Power, power_along
from waferbot_twin.residuals.problem import PRIOR, Cause, Problem
from waferbot_twin.residuals.record import Array

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much is done and how much there is."""

CHUNK = 8
"""Candidates that a worker takes at a time."""


@dataclass(frozen=True)
class Change:
    """
    What a candidate changes in the residuals: a `signature` by block, as in `stacked_least_squares`.

    Of one that begins where there is a little, `begun` is the model with that, about which the
    signature is, with its own noise: a part that lets go changes what an observer follows. `gained`
    is by how much, in 2 ln L, it is likelier than the model without. Of most there is none.
    """

    signature: Signature
    begun: Hypothesis | None = None
    gained: float = 0.0


@dataclass(frozen=True)
class Screened:
    """
    A candidate with its linear fit.

    `score` is ln BF against none of it; `value` the change of its parameters from where they are.
    `likelihood` is ln BF in noise whose power is known: it ranks candidates of which all are
    beyond doubt.
    """

    cause: Cause
    score: float
    value: Array
    likelihood: float


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
        return Change(whole_change(problem, base, causes))
    if rival.effect.begins_at == 0.0:
        return Change(signature(problem, base, causes, len(causes) - 1))
    begun = evaluate(problem, causes)
    blocks = problem.touched(rival.effect, rival.axis)
    # The residuals of `base` are those of longer steps, its noise is not.
    judged = problem.judge({block: base.residuals[block] for block in blocks})
    without = replace(base, fits={**base.fits, **judged})
    return Change(
        signature(problem, begun, causes, len(causes) - 1),
        begun,
        2.0 * log_likelihood_ratio(begun, without, blocks),
    )


def screen(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    of_rivals: Sequence[Change | None],
    of_base: Sequence[Signature],
    scales: Sequence[float],
    workers: int = 1,
) -> list[Screened]:
    """
    Return the evidence for every rival beside the causes of `base`, in a linear problem; best
    first.

    `scales` are those of the prior of sizes (`estimation.evidence`).
    """
    asked = [pair for pair in zip(rivals, of_rivals, strict=True) if pair[1] is not None]
    chunks = [asked[first : first + CHUNK] for first in range(0, len(asked), CHUNK)]
    pool = Parallel(n_jobs=workers if len(chunks) > 1 else 1)
    parts = pool(delayed(_screen)(problem, base, chunk, of_base, scales) for chunk in chunks)
    found = [item for part in parts for item in part]
    return sorted(found, key=lambda item: (-item.likelihood, item.cause.name))


def _screen(
    problem: Problem,
    base: Hypothesis,
    asked: Sequence[tuple[Cause, Change]],
    of_base: Sequence[Signature],
    scales: Sequence[float],
) -> list[Screened]:
    together = side_by_side(of_base, [_columns(item) for item in of_base])
    every = _white(base, together)
    found = []
    for rival, change in asked:
        shown = {block: matrix for block, matrix in change.signature.items() if matrix.any()}
        if not shown:
            continue
        about = change.begun or base
        beside = every
        if change.begun is not None:
            beside = _white(about, {b: together[b] for b in (*shown, PRIOR) if b in together})
        linear = _Linear.of(about, _white(about, shown), beside, change.gained)
        if _tried_as_a_whole(problem, rival):
            item = linear.as_a_whole(rival)
        else:
            item = linear.with_values(problem, rival, scales)
        if item is not None:
            found.append(item)
    return found


def _columns(signature: Signature) -> int:
    return next(iter(signature.values())).shape[1]


_White = dict[str, list[Array]]
"""By block, the white signature of every channel: (N, k)."""


def _white(base: Hypothesis, signature: Signature) -> _White:
    """Return a signature filtered by the noise model of `base`."""
    return {
        block: in_deviations(base.fits[block].colours, by_channel(matrix, base.residuals[block]))
        for block, matrix in signature.items()
    }


@dataclass(frozen=True)
class _Linear:
    """
    Least squares of white residuals on a candidate's signature beside that of the known causes.

    `value` (k,) of the candidate's parameters, their `spread` (k, k) in noise of the power along
    what the fit changes, known to be `power`; by how much the sum of squares falls, and by how
    much with the candidate's signature as large as it is, in noise of the power `as_it_is`;
    `square` that of the whole signature over its power.
    """

    value: Array
    spread: Array
    power: Power
    squares: float
    square: float
    as_it_is: Power
    squares_as_it_is: float

    @classmethod
    def of(cls, about: Hypothesis, own: _White, beside: _White, gained: float) -> _Linear:
        """Fit `own` about a hypothesis, which has `gained` so much already, beside others."""
        before: list[Array] = []
        rows: list[Array] = []
        colours: list[Colour] = []
        count = next(iter(own.values()))[0].shape[1]
        for block in dict.fromkeys([*own, *(name for name in (PRIOR,) if name in beside)]):
            fit = about.fits[block]
            others = beside.get(block)
            for place, left in enumerate(fit.whitened):
                part = own[block][place] if block in own else np.zeros((len(left), count))
                before.append(left)
                rows.append(np.hstack([part, others[place]]) if others else part)
            colours += fit.colours
        width = max(part.shape[1] for part in rows)
        rows = [np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in rows]
        system, right = np.vstack(rows), -np.concatenate(before)
        scale = np.linalg.norm(system, axis=0)
        scale[scale == 0.0] = 1.0
        inverse = np.linalg.pinv(
            (system / scale).T @ (system / scale), rcond=1e-10, hermitian=True
        )
        solution = inverse @ ((system / scale).T @ right) / scale
        after = [one + part @ solution for one, part in zip(before, rows, strict=True)]
        change = [one - two for one, two in zip(before, after, strict=True)]
        power = power_along(after, change, colours)
        began = sum(float(one @ one) for one in before)
        squares = gained + began - sum(float(one @ one) for one in after)
        first = [part[:, 0] for part in rows]
        moved = [one + part for one, part in zip(before, first, strict=True)]
        as_it_is = began - sum(float(one @ one) for one in moved)
        return cls(
            solution[:count],
            power.value * (inverse / np.outer(scale, scale))[:count, :count],
            power,
            squares,
            sum(float(part @ part) for part in first) / power.value,
            power_along(moved, first, colours),
            as_it_is,
        )

    def as_a_whole(self, rival: Cause) -> Screened | None:
        """Return the evidence for a candidate whose signature is all that it changes at its values."""
        fitted = self.power, self.squares
        as_it_is = self.as_it_is, self.squares_as_it_is
        better = as_it_is[1] / as_it_is[0].value > fitted[1] / fitted[0].value
        if self.value[0] <= 0.0 and not better:
            return None
        # Half of the steps that readings show themselves is not to be had.
        power, squares = as_it_is if better or rival.effect.evident else fitted
        return _screened(
            rival, np.zeros(rival.free), power, squares, -0.5 * math.log1p(self.square)
        )

    def with_values(
        self, problem: Problem, rival: Cause, scales: Sequence[float]
    ) -> Screened | None:
        """Return the evidence for a candidate whose signature are slopes over its parameters."""
        if not _possible(problem, rival, self.value):
            return None
        parameters = parameters_of(problem, rival)
        shown = [place for place in range(len(parameters)) if self.spread[place, place] > 0.0]
        values = {
            item.name: float(np.clip(rival.values[item.name] + change, item.low, item.high))
            for item, change in zip(parameters, self.value, strict=True)
        }
        occam = log_occam(
            rival.with_values(values),
            [parameters[place] for place in shown],
            self.spread[np.ix_(shown, shown)],
            scales,
        )
        return _screened(rival, self.value, self.power, self.squares, occam)


def untempered(rival: Cause, evidence: float) -> Screened:
    """Return a candidate at its values with ln BF in noise as the noise model has it."""
    return Screened(rival, evidence, np.zeros(rival.free), evidence)


def _screened(rival: Cause, value: Array, power: Power, squares: float, occam: float) -> Screened:
    return Screened(
        rival,
        power.log_likelihood_ratio(squares) + occam,
        value,
        0.5 * squares / power.value + occam,
    )


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
