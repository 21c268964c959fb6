# SPDX-License-Identifier: Apache-2.0
"""
What the thesis demands of a candidate beyond the figures of steps: RMS errors, signs, statements.

    distance of a value v from a limit l that it does not keep:  |v - l| / max(|v|, |l|), at most 1

It is 0 for a value within its limits, has no unit and no scale of its own, and is 1 for one that does
not exist or is on the other side of zero. A candidate is charged (1 + distance) / 2 for each demand that
it does not meet: mostly for not meeting it, so that many near misses are worse than one far one.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from waferbot_twin.metrics import FIGURES, percent_difference, performance_improvement
from waferbot_twin.statement_quantities import measure
from waferbot_twin.statements import Statement, statements
from waferbot_twin.step_runs import Runs
from waferbot_twin.thesis import RMS_TOLERANCE, improvement_admits, thesis

MODELS_NAMED_BY = ('model', 'reference', 'other_model')
"""What a statement is about by these keys are models."""

COMPARED = frozenset(
    {
        'percent_from_measured',
        'least_percent_from_measured',
        'improvement',
        'least_improvement',
        'rms_percent',
        'first_error_peak_ratio',
        'error_after_overshoot_ratio',
        'rms_error_ratio',
        'difference_of_errors',
    }
)
"""Quantities that compare with the measured response without naming it."""


def distance(value: float, least: float = -math.inf, most: float = math.inf) -> float:
    """Return how far a value is outside its limits, 0 to 1; 1 for what is no number."""
    if math.isnan(value):
        return 1.0
    limit = least if value < least else most if value > most else value
    if limit == value:
        return 0.0
    if math.isinf(value):
        return 1.0
    return min(abs(value - limit) / max(abs(value), abs(limit)), 1.0)


def charge(distances: Collection[float]) -> float:
    """Return what unmet demands cost: half of one each, and half of their distances."""
    return sum((1.0 + value) / 2.0 for value in distances if value > 0.0)


def models_of(statement: Statement) -> set[str]:
    """Return the models whose runs a statement is measured on."""
    named = {statement.about[key] for key in MODELS_NAMED_BY if key in statement.about}
    return named | {'as_built'} if statement.quantity in COMPARED else named


def statement_demands(runs: Runs, axis: str, models: Collection[str]) -> dict[str, float]:
    """Return the distance of every statement about an axis that is measured on `models` alone."""
    found = {}
    for said in statements():
        if said.about.get('axis') != axis or not models_of(said) <= set(models):
            continue
        try:
            value = measure(said.quantity, runs, said.about).value
        except (ValueError, ArithmeticError, IndexError):  # a candidate that does not even settle
            value = math.nan
        found[said.name] = distance(value, said.least, said.most)
    return found


def row_demands(runs: Runs, axis: str) -> dict[str, float]:
    """Return the distance of RMS errors and of the signs of improvements of an axis."""
    steps = thesis()['steps'][axis]
    found = {}
    for model in ('rigid', 'flexible'):
        expected = steps[model]['rms_error']['printed']
        width = RMS_TOLERANCE.width(expected)
        found[f'{axis}.{model}.rms_error'] = distance(
            runs.rms_error(model, axis), expected - width, expected + width
        )
    figures = {model: runs.metrics(model, axis) for model in ('rigid', 'flexible', 'as_built')}
    for name in FIGURES:
        measured = getattr(figures['as_built'], name)
        wrong = [
            percent_difference(getattr(figures[model], name), measured)
            for model in ('rigid', 'flexible')
        ]
        ours = performance_improvement(*wrong) if wrong[0] else math.nan
        met = improvement_admits(steps['improvement'][name], ours)
        found[f'{axis}.improvement.{name}'] = (
            0.0 if met else 1.0 if math.isnan(ours) else min(max(abs(ours), 1.0) / 100.0, 1.0)
        )
    return found
