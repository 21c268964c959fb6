# SPDX-License-Identifier: Apache-2.0
"""
Causes whose names say more than the logs tell.

Harmonics of a cogging over a small part of its period are large and cancel: together they are any
smooth force over the position, a spring's or a stiction's as well as a magnet's. Each of them by itself
could be nothing,

    |value - neutral| < 1.96 standard errors    for every part,

though the logs are far more likely with all of them. Then it is not known that the force repeats, which
is what the name says. And a drag that fades with a time constant tau is any drag where tau is so long
that 1 / tau could be nothing,

    1 / tau < 1.96 standard errors of 1 / tau,  which is  tau < 1.96 standard errors of tau.

Limits: a cause with one part only, shapes not counted, is never asked for the first; nor is one none of
whose parts has a standard error, as in a block that calculates in whole numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.gauss_newton import names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, standard_errors
from waferbot_twin.estimation.intervals import NORMAL_95
from waferbot_twin.residuals.problem import Cause, Problem


@dataclass(frozen=True)
class Undetermined:
    """A cause of which the logs do not tell what `lacks`."""

    cause: Cause
    lacks: str

    def __str__(self) -> str:
        """Return what that means."""
        return (
            f'{self.cause.name}: the logs tell that something like it is there, but {self.lacks}; '
            'another cause may look the same in these logs'
        )


def undetermined(problem: Problem, found: Hypothesis) -> list[Undetermined]:
    """Return the causes whose names say more than is told; none where no covariance is known."""
    names, errors = names_of(problem, found.causes), standard_errors(found)
    if len(names) != len(errors):
        return []
    result = []
    for place, cause in enumerate(found.causes):
        own = {
            item.name: (item, error)
            for (owner, item), error in zip(names, errors, strict=True)
            if owner == place
        }
        lacks = _no_part(cause, list(own.values())) or _no_fading(cause, own)
        if lacks:
            result.append(Undetermined(cause, lacks))
    return result


def _no_part(cause: Cause, own: Sequence[tuple[Parameter, float]]) -> str:
    """Return what to say if none of several parts is told, else nothing."""
    parts = [
        (abs(cause.values[item.name] - item.neutral), error)
        for item, error in own
        if not item.shape
    ]
    told = [size >= NORMAL_95 * error for size, error in parts if error > 0.0]
    if len(parts) < 2 or not told or any(told):
        return ''
    return f'each of its {len(parts)} parts by itself could be nothing'


def _no_fading(cause: Cause, own: Mapping[str, tuple[Parameter, float]]) -> str:
    """Return what to say if a cause is to fade, but may as well stay, else nothing."""
    name = cause.effect.fades_after
    if name not in own:
        return ''
    _, error = own[name]
    if 0.0 < NORMAL_95 * error <= cause.values[name]:
        return ''
    return f'not that it fades away (time constant {cause.values[name]:.3g} s)'
