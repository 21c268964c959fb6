# SPDX-License-Identifier: Apache-2.0
"""
Do the logs agree on the values of a cause? If not, it stands in for something else.

A true cause has the same values in every log, whatever the motion. A false one that explains most of
the logs (a centre of gravity off its axis, where in truth a constant force pulls) needs another value
wherever the motion is another. So all parameters of the causes are fitted once more to each log by
itself, linearly about the values found, with what they change in the noise-free log
(`closed_loop_record`). With the change d_l and the covariance C_l of a cause's parameters in log l,

    Q = sum over l of (d_l - m)' C_l^-1 (d_l - m),        m = (sum C_l^-1)^-1 sum C_l^-1 d_l,

has for a true cause a chi-squared distribution, with k (L - 1) degrees of freedom for k parameters and
L logs (fewer where a log says nothing of some of them).

Limits: one log that is divided in two, or logs of motions alike, agree on false values, too. Where dry
friction sticks, noise decides when it lets go, and what a parameter changes there is not quite what it
changes in the noise-free log: of a true cause that is very large, a little of its own form is left over.
So what is `NEGLIGIBLE` beside what the cause gains is no disagreement.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, signature
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel, side_by_side
from waferbot_twin.noise_model.prediction_error import fit, prediction_errors
from waferbot_twin.residuals.problem import Cause, Channel, Problem
from waferbot_twin.residuals.record import Array, Record

CHANCE = 1e-3
"""Probability that the logs disagree as much on a true cause."""

NEGLIGIBLE = 0.01
"""
Share of what a cause gains in 2 ln L by which logs may disagree on it.

Of 54 true frictions (Coulomb, Stribeck, load-dependent; 0.3 to 3 times their typical size; judged in
another motion) 8 had logs that disagreed as much as by chance one in 1000 do, by 0.2 to 0.5 % of what
they gained, one by 1.5 %.
"""


@dataclass(frozen=True)
class Wanted:
    """
    What a log wants of the parameters of a cause.

    Their `change` (k,), the inverse of its covariance, `information` (k, k), and by axis what the log
    would gain by it, in 2 ln L.
    """

    log: str
    change: Array
    information: Array
    gained: dict[str, float]


@dataclass(frozen=True)
class Disagreement:
    """A cause on whose values the logs disagree: on which `axes` that shows, and what each wants."""

    cause: Cause
    axes: tuple[str, ...]
    chance: float
    wanted: tuple[Wanted, ...]

    def __str__(self) -> str:
        """Say what each log wants, with standard errors."""
        names = [name for name in self.cause.values if name not in self.cause.held]
        each = []
        for item in self.wanted:
            errors = np.sqrt(np.diag(np.linalg.pinv(item.information)))
            values = [
                f'{name} {self.cause.values[name] + change:.4g} +- {error:.2g}'
                for name, change, error in zip(names, item.change, errors, strict=True)
                if error > 0.0
            ]
            each.append(f'{item.log} wants {", ".join(values)}')
        return (
            f'the logs disagree on {self.cause.name} (by chance {self.chance:.1g}), which may stand in '
            f'for something else: {"; ".join(each)}'
        )


def disagreements(problem: Problem, judge: Problem, found: Search) -> list[Disagreement]:
    """
    Return the causes on whose values the logs disagree more than noise would let them.

    None where a log does not have what was commanded, or the model's loop is unstable: then there
    is no noise-free log to ask.
    """
    causes = found.found.causes
    try:
        in_finding, in_judging = by_log(problem, found.found), by_log(judge, found.judged)
    except UserError:
        return []
    result = []
    for cause, *wanted in zip(causes, in_finding, in_judging, strict=True):
        every = [*wanted[0], *wanted[1]]
        square, degrees = disagreement(every)
        chance = float(chi2.sf(square, degrees)) if degrees else 1.0
        if chance * len(causes) < CHANCE and counts(
            square, NEGLIGIBLE, cause, problem, judge, found
        ):
            result.append(Disagreement(cause, _axes(cause, every), chance, tuple(every)))
    return result


def counts(
    left: float, share: float, cause: Cause, problem: Problem, judge: Problem, found: Search
) -> bool:
    """Return whether what is left over of a cause's form is more than a share of its gain, in 2 ln L."""
    gained = 0.0
    for logs, hypothesis in ((problem, found.found), (judge, found.judged)):
        others = tuple(other for other in hypothesis.causes if other.name != cause.name)
        try:
            without = evaluate(logs, others)
        except UserError:  # the machine does not stand without it
            return True
        gained += 2.0 * (hypothesis.log_likelihood - without.log_likelihood)
    return left > share * gained


def disagreement(wanted: Sequence[Wanted]) -> tuple[float, int]:
    """Return Q and its degrees of freedom."""
    if not wanted:
        return 0.0, 0
    total = np.sum([item.information for item in wanted], axis=0)
    mean = np.linalg.pinv(total) @ np.sum([w.information @ w.change for w in wanted], axis=0)
    square = sum(float((w.change - mean) @ w.information @ (w.change - mean)) for w in wanted)
    ranks = [int(np.linalg.matrix_rank(item.information)) for item in wanted]
    return square, sum(ranks) - int(np.linalg.matrix_rank(total))


def _axes(cause: Cause, wanted: Sequence[Wanted]) -> tuple[str, ...]:
    """Return the axis of a cause, and first that where the logs gain most if each has its own values."""
    gained = {
        axis: sum(item.gained.get(axis, 0.0) for item in wanted)
        for axis in AXES
        if any(axis in item.gained for item in wanted)
    }
    most = max(gained, key=lambda axis: gained[axis], default=cause.axis)
    return tuple(dict.fromkeys([most, cause.axis]))


def by_log(problem: Problem, found: Hypothesis) -> list[list[Wanted]]:
    """
    Return for every cause what each log wants of it, nothing of causes in exact blocks alone.

    Raises `UserError` if the model's loop is unstable.
    """
    result: list[list[Wanted]] = [[] for _ in found.causes]
    without_noise = changes_without_noise(problem, found)
    if without_noise is None:
        return result
    changes, cause_of = without_noise.changes, without_noise.cause_of
    for record in problem.records:
        channels = list(_channels(problem, found, changes, record))
        shows = np.any([np.any(one.matrix != 0.0, axis=0) for one in channels], axis=0)
        if not np.any(shows):
            continue
        residuals = [one.residual for one in channels]
        matrices = [one.matrix[:, shows] for one in channels]
        estimate = fit(residuals, matrices, [one.channel.noise for one in channels])
        white = list(
            zip(
                prediction_errors(estimate, matrices),
                prediction_errors(estimate, residuals),
                strict=True,
            )
        )
        for place, wanted in enumerate(result):
            mine = cause_of[shows] == place
            if not mine.any():
                continue
            known = shows[cause_of == place]
            change, information = np.zeros(len(known)), np.zeros((len(known), len(known)))
            change[known] = estimate.value[mine]
            information[np.ix_(known, known)] = np.linalg.pinv(
                estimate.covariance[np.ix_(mine, mine)]
            )
            gained: dict[str, float] = {}
            for one, (rows, there) in zip(channels, white, strict=True):
                left = there + rows[:, mine] @ estimate.value[mine]
                axis = one.channel.axis
                gained[axis] = gained.get(axis, 0.0) + float(there @ there - left @ left)
            wanted.append(Wanted(record.name, change, information, gained))
    return result


@dataclass(frozen=True)
class WithoutNoise:
    """
    The noise-free logs of the model with causes, and what the causes' parameters change in them.

    `changes` has a column for every parameter; `cause_of` says of each to which cause it belongs.
    """

    ideal: Problem
    changes: Signature
    cause_of: NDArray[np.int64]


def changes_without_noise(problem: Problem, found: Hypothesis) -> WithoutNoise | None:
    """
    Return what causes change, seen without noise; None without causes or without commands in a log.

    Raises `UserError` if the model's loop is unstable.
    """
    ideal = problem.ideal(found.causes)
    if ideal is None or not found.causes:
        return None
    noise_free = evaluate(ideal, found.causes)
    own = [signature(ideal, noise_free, found.causes, place) for place in range(len(found.causes))]
    cause_of = np.array([place for place, _ in names_of(problem, found.causes)])
    counts = [int(np.sum(cause_of == place)) for place in range(len(found.causes))]
    return WithoutNoise(ideal, side_by_side(own, counts), cause_of)


@dataclass(frozen=True)
class _Shown:
    """A channel of one log: its residual, and what the parameters of all causes change in it."""

    channel: Channel
    residual: Array
    matrix: Array


def _channels(
    problem: Problem, found: Hypothesis, changes: Signature, record: Record
) -> Iterator[_Shown]:
    """Give the channels of a log in blocks with noise, in which any cause shows."""
    for block, matrix in changes.items():
        if block in problem.exact_blocks:
            continue
        residuals = found.residuals[block]
        every = zip(problem.channels(block), residuals, by_channel(matrix, residuals), strict=True)
        for channel, residual, rows in every:
            if channel.log.record is record:
                yield _Shown(channel, residual, rows)
