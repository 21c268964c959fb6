# SPDX-License-Identifier: Apache-2.0
"""What a search has found so far, and what else it tried."""

from __future__ import annotations

from dataclasses import dataclass, field

from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.problem import Cause

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
