# SPDX-License-Identifier: Apache-2.0
"""
Compliances that may have made the lines in what the plant leaves over.

At which values they ring as a line does (`modal_candidates`) depends on what else gives, hardly on
anything else that is known: values, and what they change, are found once for a line. Those that gain
most in any phase are tried closer (`compliance_scan`): a ring that goes on shows its value to parts of a
thousand. How likely each is, is said by its change as it is, in size and phase: a compliance has no
other, and in any phase the ring of a wrong part suits, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.compliance_scan import (
    closer,
    gain_as_it_is,
    gain_in_any_phase,
    same_ring,
)
from waferbot_twin.diagnosis.proposals.modal_candidates import Ring, at_line, ring_of
from waferbot_twin.diagnosis.proposals.screening import Screened, untempered
from waferbot_twin.diagnosis.proposals.spectral_lines import Line, lines
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import Cause, Problem

_Place = tuple[tuple[str, ...], str, float, bool]
"""What gives in the model already; channel and frequency of a line, and whether it is brief."""


class Rings:
    """What was found at lines of some logs."""

    def __init__(self, problem: Problem, most: int, workers: int = 1) -> None:
        """Take the logs, how many values are tried closer for an answer, and how many at a time."""
        self.problem, self.most, self.workers = problem, most, workers
        self._at_lines: dict[_Place, list[Ring]] = {}
        self._closer: dict[tuple[tuple[str, ...], str, float], Ring | None] = {}

    def __call__(self, base: Hypothesis, rivals: Sequence[Cause]) -> list[Screened]:
        """Return which of the rivals may have made lines in what `base` leaves over."""
        there = tuple(cause.name for cause in base.causes if cause.effect.rings)
        names = {cause.name for cause in rivals}
        begun: list[Ring] = []
        for line in lines(self.problem, base):
            for ring in self._at(line, there, base, rivals):
                known = any(
                    ring[0].name == other.name and same_ring(ring[0], other) for other, _ in begun
                )
                if ring[0].name in names and not known:
                    begun.append(ring)
        pool = Parallel(n_jobs=self.workers if len(begun) > 1 else 1)
        gains = pool(delayed(gain_in_any_phase)(self.problem, base, change) for _, change in begun)
        best_first = sorted(range(len(begun)), key=lambda place: -gains[place])
        best = [begun[place][0] for place in best_first[: self.most]]
        return [
            untempered(
                cause, 0.5 * (gain_as_it_is(self.problem, base, change) - math.log(base.samples))
            )
            for cause, change in self._tried_closer(base, there, best)
        ]

    def _at(
        self, line: Line, there: tuple[str, ...], base: Hypothesis, rivals: Sequence[Cause]
    ) -> list[Ring]:
        """Return the rings that a line may be."""
        key = there, line.channel, line.frequency_hz, line.brief
        if key not in self._at_lines:
            self._at_lines[key] = at_line(self.problem, base, rivals, line, self.workers)
        return self._at_lines[key]

    def _tried_closer(
        self, base: Hypothesis, there: tuple[str, ...], causes: Sequence[Cause]
    ) -> list[Ring]:
        """Return each compliance at the best value close to the one that it has."""
        keys = [(there, cause.name, cause.values[cause.narrow[0]]) for cause in causes]
        new = [place for place, key in enumerate(keys) if key not in self._closer]
        pool = Parallel(n_jobs=self.workers, batch_size=1)
        found = pool(delayed(_closer)(self.problem, base, causes[place]) for place in new)
        self._closer |= {keys[place]: ring for place, ring in zip(new, found, strict=True)}
        return [ring for key in keys if (ring := self._closer[key]) is not None]


def _closer(problem: Problem, base: Hypothesis, cause: Cause) -> Ring | None:
    try:
        return ring_of(problem, base, closer(problem, base, cause))
    except UserError:
        return None
