# SPDX-License-Identifier: Apache-2.0
"""
What earlier diagnoses of the same machine found, put together with what this one found.

Which causes there are is decided by these logs alone. The values of those that were found before, and
of corrected parameters, then take part as a reading more (`estimation.known_values`), and all others
follow by their covariance. So a second diagnosis needs less data for the same intervals, and what has
changed since is told and left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis import notes as said
from waferbot_twin.diagnosis.inference.nuisance import Number, is_nuisance
from waferbot_twin.diagnosis.wording import title
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.estimation.hypothesis import Hypothesis, evaluate, parameters_of
from waferbot_twin.estimation.known_values import Known, disagree, together, without_prior
from waferbot_twin.estimation.size_prior import precision
from waferbot_twin.residuals.problem import Cause, Problem


def with_known(
    problem: Problem, found: Hypothesis, known: Mapping[str, Known], numbers: list[Number]
) -> tuple[Hypothesis, list[str]]:
    """
    Return a hypothesis with what is known, by path, and what the reader of its values must know.

    Paths are those of the library: `bodies.carriage.mass_kg` of a correction, EFFECT.AXIS.PARAMETER of
    a cause. `numbers` are those of the dense effect.
    """
    free = [
        (place, cause, item, weight)
        for place, cause in enumerate(found.causes)
        for item, weight in zip(parameters_of(problem, cause), _prior(problem, cause), strict=True)
    ]
    if len(found.covariance) != len(free) or not free:
        return found, []
    by_path = {number.path: number for number in numbers}
    values = np.array([cause.values[item.name] for _, cause, item, _ in free])
    places: list[int] = []
    taken: list[Known] = []
    notes: list[str] = []
    for row, (_, cause, item, weight) in enumerate(free):
        path = item.name if is_nuisance(cause) else f'{cause.name.replace(":", ".")}.{item.name}'
        here = known.get(path)
        if here is None:
            continue
        if is_nuisance(cause):
            here = _as_share(here, by_path[path])
        before = without_prior(here, item.neutral, weight)
        variance = float(found.covariance[row, row])
        if before is None or variance <= 0.0:
            continue
        if disagree(before, float(values[row]), variance):
            what = (
                by_path[path].words
                if is_nuisance(cause)
                else f'{item.name} of {title(problem.nominal, cause)}'
            )
            apart = abs(before.value - values[row]) / np.sqrt(variance + before.error**2)
            notes.append(said.not_what_it_was(what, before.origin, float(apart)))
            continue
        places.append(row)
        taken.append(before)
    if not taken:
        return found, notes
    better, covariance = together(values, found.covariance, places, taken)
    causes = list(found.causes)
    for (place, _, item, _), value in zip(free, better, strict=True):
        causes[place] = causes[place].with_values({item.name: _within(item, float(value))})
    try:
        updated = evaluate(problem, tuple(causes))
    except UserError:
        return found, [
            *notes,
            'with what was known of it the machine does not run: it is left out',
        ]
    names = 'one value' if len(taken) == 1 else f'{len(taken)} values'
    notes.append(f'{names} of earlier logs of this machine took part')
    curvature = found.curvature.copy()
    curvature[places, places] += [known.error**-2.0 for known in taken]
    return replace(updated, covariance=covariance, curvature=curvature), notes


def _prior(problem: Problem, cause: Cause) -> list[float]:
    """Return the precision that the prior has for each free parameter of a cause."""
    own = precision(problem, cause)
    return [
        item.spread**-2.0 if item.spread > 0.0 else float(weight)
        for item, weight in zip(parameters_of(problem, cause), own, strict=True)
    ]


def _as_share(known: Known, number: Number) -> Known:
    """Return a known value as that of the dense effect: how far it is from the model's."""
    if number.is_damping:
        return Known(math.log(known.value / number.value), known.error / known.value, known.origin)
    return Known(
        (known.value - number.value) / number.per_x, abs(known.error / number.per_x), known.origin
    )


def _within(item: Parameter, value: float) -> float:
    return min(max(value, item.low), item.high)
