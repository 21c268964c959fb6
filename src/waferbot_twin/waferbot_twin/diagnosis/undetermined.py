# SPDX-License-Identifier: Apache-2.0
"""
Causes that the logs show as a whole, but of whose parts they tell none.

Harmonics of a cogging over a small part of its period are large and cancel: together they are any
smooth force over the position, a spring's or a stiction's as well as a magnet's. Each of them by itself
could be nothing,

    |value - neutral| < 1.96 standard errors    for every part,

though the logs are far more likely with all of them. Then it is not known that the force repeats, which
is what the name says.

Limits: a cause with one part only, shapes not counted, is never asked; nor is one none of whose parts
has a standard error, as in a block that calculates in whole numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_twin.diagnosis.fitting import names_of
from waferbot_twin.diagnosis.hypothesis import Hypothesis, standard_errors
from waferbot_twin.diagnosis.intervals import NORMAL_95
from waferbot_twin.diagnosis.problem import Cause, Problem


@dataclass(frozen=True)
class Undetermined:
    """A cause of so many `parts`, none of which the logs tell."""

    cause: Cause
    parts: int

    def __str__(self) -> str:
        """Return what that means."""
        return (
            f'{self.cause.name}: the logs tell that something like it is there, but each of its '
            f'{self.parts} parts by itself could be nothing; another cause may look the same in these '
            'logs'
        )


def undetermined(problem: Problem, found: Hypothesis) -> list[Undetermined]:
    """Return the causes none of whose parts the logs tell; none where no covariance is known."""
    names, errors = names_of(problem, found.causes), standard_errors(found)
    if len(names) != len(errors):
        return []
    result = []
    for place, cause in enumerate(found.causes):
        parts = [
            (abs(cause.values[item.name] - item.neutral), error)
            for (owner, item), error in zip(names, errors, strict=True)
            if owner == place and not item.shape
        ]
        told = [size >= NORMAL_95 * error for size, error in parts if error > 0.0]
        if len(parts) > 1 and told and not any(told):
            result.append(Undetermined(cause, len(parts)))
    return result
