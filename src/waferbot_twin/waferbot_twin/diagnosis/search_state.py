# SPDX-License-Identifier: Apache-2.0
"""What a search has found so far, and what else it tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Cause

TELLS_APART = 10.0
"""Difference in 2 ln L from which on one cause explains the logs better than another."""

STRONG = 6.0
"""
Difference in Schwarz' criterion from which on evidence is strong: R. E. Kass, A. E. Raftery, Bayes
factors, Journal of the American Statistical Association 90 (1995).
"""


@dataclass(frozen=True)
class Rival:
    """
    What else was fitted in place of a cause.

    By how much it is `behind` in Schwarz' criterion, and by how much `less_likely`, 2 ln L, all logs
    together. One with more parameters may be far behind, and the logs cannot tell it all the same.
    `in_finding` is by how much it is less likely in the logs that it was fitted to; `beside` are the
    other causes, as they were fitted with it.
    """

    cause: Cause
    behind: float
    less_likely: float
    in_finding: float = 0.0
    beside: tuple[Cause, ...] = ()


@dataclass(frozen=True)
class Score:
    """How good a hypothesis is: Schwarz' criterion, ln L, and how many parameters it has."""

    criterion: float
    log_likelihood: float
    parameters: int


def preferred(scores: Sequence[Score]) -> int:
    """
    Return the place of the hypothesis to be taken.

    The best by Schwarz' criterion; but of those that do about as well one that is not the simplest needs
    strong evidence.
    """
    best = min(scores, key=lambda item: item.criterion)
    alike = [
        place
        for place, item in enumerate(scores)
        if item.criterion - best.criterion <= TELLS_APART
        or 2.0 * (best.log_likelihood - item.log_likelihood) < TELLS_APART
    ]
    fewest = min(scores[place].parameters for place in alike)
    return min(
        alike,
        key=lambda place: (
            scores[place].criterion + (STRONG if scores[place].parameters > fewest else 0.0)
        ),
    )


@dataclass
class Search:
    """
    What a search found.

    `found` and `judged` are the causes in the logs for finding and for judging; `nothing` and
    `judged_nothing` the nominal model there; `gains` what each cause gained in Schwarz' criterion,
    `rivals` what was fitted in its place; `trials` of all that was fitted from several, those that
    explain the logs for finding as well as its best; `feigned` names what noise made: it is not fitted
    again; `far_off` tells whether what is left is too large for noise: nothing more can be told from it;
    `outdone` whether a rival explains all logs better, but not with values from those for finding.
    """

    found: Hypothesis
    judged: Hypothesis
    nothing: Hypothesis
    judged_nothing: Hypothesis
    gains: dict[str, float] = field(default_factory=dict)
    rivals: dict[str, list[Rival]] = field(default_factory=dict)
    trials: dict[str, list[Cause]] = field(default_factory=dict)
    feigned: set[str] = field(default_factory=set)
    far_off: bool = False
    outdone: bool = False
    tried: int = 0
