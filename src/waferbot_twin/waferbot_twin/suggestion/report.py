# SPDX-License-Identifier: Apache-2.0
"""The suggestion as a table, a sentence, JSON, and an experiment that every engine runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from waferbot_twin.cli.console import finite, significant
from waferbot_twin.diagnosis.search_state import TELLS_APART
from waferbot_twin.recording.writer import as_json
from waferbot_twin.suggestion.suggest import Rated, Suggestion

SCHEMA = 1


def sentence(found: Suggestion) -> str:
    """Return what to do, in one or a few sentences."""
    names = ' and '.join(cause.name for cause in found.causes)
    best = found.best
    if best is not None:
        return (
            f'{best.candidate.label} tells {names} apart best: 2 ln L = {best.evidence:.0f} is '
            f'expected, {TELLS_APART:.0f} is needed.'
        )
    if found.special_case is not None:
        special, general = found.special_case
        return (
            f'{general.name} can do whatever {special.name} does. No experiment shows that '
            f'{special.name} is the cause; one that would show {general.name} is '
            f'{_best_case(found).candidate.label}. If that shows nothing, take the simpler one.'
        )
    text = (
        f'{names} are equivalent for every motion that was tried: {len(found.rated)} experiments.'
    )
    if found.instead:
        return text + ''.join(f' Or {line}.' if place else f' Instead, {line}.'
                              for place, line in enumerate(found.instead))  # fmt: skip
    return text + ' Measure one of them by itself: a mass on scales, a force with a load cell.'


def _best_case(found: Suggestion) -> Rated:
    possible = [item for item in found.rated if not item.impossible]
    return max(possible, key=lambda item: item.best_case)


def as_dict(found: Suggestion) -> dict[str, Any]:
    """Return the suggestion as plain values, as `report.json` has them (schema 1)."""
    return {
        'schema': SCHEMA,
        'sentence': sentence(found),
        'causes': [
            {'effect': cause.effect.name, 'axis': cause.axis, 'values': cause.values}
            for cause in found.causes
        ],
        'best': None if found.best is None else found.best.candidate.label,
        'special_case': (
            None if found.special_case is None else [cause.name for cause in found.special_case]
        ),
        'instead': list(found.instead),
        'experiments': [
            {
                'experiment': item.candidate.label,
                'designed': item.candidate.design is not None,
                'duration_s': item.candidate.experiment.duration_s,
                'evidence': item.evidence,
                'detectable': item.detectable,
                'best_case': item.best_case,
                'speed_share': max((one.load.speed for one in item.separations), default=None),
                'current_share': max((one.load.current for one in item.separations), default=None),
                'impossible': item.impossible or None,
            }
            for item in found.rated
        ],
    }


def table_rows(found: Suggestion) -> list[tuple[str, ...]]:
    """Return label, evidence, times the detectable, length, speed and current of what can be run."""
    return [
        (
            item.candidate.label,
            significant(item.evidence, 3),
            significant(item.detectable, 3),
            f'{item.candidate.experiment.duration_s:.1f}',
            f'{100.0 * max(one.load.speed for one in item.separations):.0f}',
            f'{100.0 * max(one.load.current for one in item.separations):.0f}',
        )
        for item in found.rated
        if not item.impossible
    ]


def remainder(found: Suggestion, shown: int) -> str:
    """Return how many experiments a table of so many does not show, and why."""
    impossible = sum(bool(item.impossible) for item in found.rated)
    less = max(0, len(found.rated) - impossible - shown)
    return f'{less} others give less, {impossible} are beyond what the machine can do'


def write(found: Suggestion, folder: Path) -> None:
    """Write `report.json`, and `experiment.yaml` if there is a best one, into an existing folder."""
    (folder / 'report.json').write_text(as_json(finite(as_dict(found))) + '\n', 'utf-8')
    if found.best is not None:
        (folder / 'experiment.yaml').write_text(found.best.candidate.experiment.text, 'utf-8')
