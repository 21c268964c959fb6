# SPDX-License-Identifier: Apache-2.0
"""
What the logs cannot tell from a cause, and how sure that leaves it.

Of causes that were as likely before, logs make one exp(-d / 2) times as likely as another, with d the
difference in Schwarz' criterion,

    d = 2 ln L_other - 2 ln L_one + (k_one - k_other) ln N,

k parameters and N samples: each parameter costs what it had to be narrowed down. One that the logs tell
nothing of (how a friction changes along the way, where the axis goes by a hundredth of that) had not to
be, whatever its value, and costs nothing. So k counts by how much the logs narrow down what is possible,

    k = sum over i of min(ln(1 + e_i) / ln N, 1),

e_i the eigenvalues of D F D, with F the information of the parameters (white signatures) and
D = diag((high - low) / sqrt 12), the deviations of uniform distributions; 1/2 ln(1 + e_i) is what a
direction costs in ln L that had a normal distribution as wide before.

Limit: F is that at the values found, without what the other causes could do in their place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.likeness import likeness
from waferbot_twin.diagnosis.search_state import TELLS_APART, Rival, Search
from waferbot_twin.estimation.hypothesis import evaluate, parameters_of, signature
from waferbot_twin.estimation.stacked_least_squares import by_channel
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.residuals.problem import Cause, Problem

MOST_ALIKE = 2
"""How many causes at most are named that the logs cannot tell from one that was found."""

LEAST_CORRELATION = 0.3
"""Below it two causes explain different things, as much by chance."""

UNRIVALLED = 0.8
"""Confidence in a cause beside others that no rival was fitted in place of: likely, not more."""


@dataclass(frozen=True)
class Alike:
    """A cause that explains the logs as well: how much less likely it is, and how alike it looks."""

    cause: Cause
    behind: float
    correlation: float


@dataclass(frozen=True)
class Weighed:
    """A rival, how far it is behind by the evidence, and how many of its parameters the logs tell."""

    rival: Rival
    by_evidence: float
    told: float

    @property
    def behind(self) -> float:
        """
        How far it is behind at least, by the evidence or with the whole price of each parameter.

        A form that logs happen to tell badly is cheap, and what is left of slow forces in the noise is
        10 or 20 in 2 ln L now and then: a simple rival is not out of question then.
        """
        return min(self.by_evidence, self.rival.behind)


def weighed_by_evidence(
    problem: Problem, judge: Problem, found: Search, place: int
) -> list[Weighed]:
    """Return the rivals of a cause; of those that may be as plausible what all logs tell of each."""
    causes = found.found.causes
    rivals = found.rivals.get(causes[place].name, [])
    as_searched = [Weighed(item, item.behind, item.cause.free) for item in rivals]
    if not any(map(_close, as_searched)):
        return as_searched
    every = Problem(problem.nominal, (*problem.records, *judge.records))
    a_parameter = math.log(found.found.samples + found.judged.samples)

    def by_evidence(item: Rival) -> Weighed:
        told = parameters_told(every, (*causes[:place], item.cause, *causes[place + 1 :]), place)
        return Weighed(item, item.less_likely + (told - own) * a_parameter, told)

    try:
        own = parameters_told(every, causes, place)
        return [by_evidence(item.rival) if _close(item) else item for item in as_searched]
    except UserError:  # one of them blows up: all stay as they were, measured alike
        return as_searched


def _close(item: Weighed) -> bool:
    """Return whether a rival explains the logs about as well, or is about as plausible."""
    return min(item.rival.less_likely, item.behind) < TELLS_APART


def parameters_told(problem: Problem, causes: Sequence[Cause], place: int) -> float:
    """
    Return how many of a cause's parameters the logs tell, one that is told in part as a part.

    Raises `UserError` if the simulation blows up.
    """
    found = evaluate(problem, tuple(causes))
    parameters = parameters_of(problem, causes[place])
    information = np.zeros((len(parameters), len(parameters)))
    for block, change in signature(problem, found, tuple(causes), place).items():
        channels = by_channel(change, found.residuals[block])
        white = np.vstack(in_deviations(found.fits[block].colours, channels))
        information += white.T @ white
    deviations = np.array([(item.high - item.low) / math.sqrt(12.0) for item in parameters])
    narrowed = np.linalg.eigvalsh(information * np.outer(deviations, deviations))
    told = np.log1p(np.maximum(narrowed, 0.0)) / math.log(found.samples)
    return float(np.sum(np.minimum(told, 1.0)))


def alike(
    problem: Problem, found: Search, cause: Cause, weighed: Sequence[Weighed]
) -> Iterator[Alike]:
    """
    Give the most plausible rivals of a cause that the logs cannot tell from it.

    Every effect that contains the cause as a special case explains the logs as well (of a friction there
    are six); more than a few help nobody to decide what to do. They are those that are best by Akaike's
    criterion: Schwarz' would always put one with more parameters behind, and of those that were chosen
    because they are simple one with more parameters is often the truth.
    """
    close = filter(_close, weighed)

    def unlikely(item: Weighed) -> float:
        return item.rival.less_likely + 2.0 * item.told

    given = 0
    for item in sorted(close, key=unlikely):
        try:
            correlation = likeness(problem, found.found, cause, item.rival.cause)
        except UserError:
            correlation = math.nan
        if abs(correlation) < LEAST_CORRELATION:
            continue
        yield Alike(item.rival.cause, item.behind, correlation)
        given += 1
        if given == MOST_ALIKE:
            return


def confidence_in(weighed: Sequence[Weighed], causes: int) -> float:
    """
    Return how sure it is that this and not a rival is the cause, of so many that were found.

    Of a cause that was fitted together with others nobody knows what else could stand in its place.
    """
    if not weighed and causes > 1:
        return UNRIVALLED
    return 1.0 / (1.0 + sum(math.exp(-0.5 * max(item.behind, -100.0)) for item in weighed))
