# SPDX-License-Identifier: Apache-2.0
"""The suggestion as a table, a sentence, JSON, and an experiment that every engine runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from waferbot_twin.plain_values import finite, listed, significant
from waferbot_twin.recording.writer import as_json
from waferbot_twin.suggestion.separation import TELLS_APART
from waferbot_twin.suggestion.suggest import Rated, Suggestion

SCHEMA = 1


def sentence(found: Suggestion) -> str:
    """Return what to do, in one or a few sentences."""
    if not found.told:
        return _equivalent(found)
    said = []
    names = [cause.name for cause in found.causes]
    counted = f'2 ln L = {{:.0f}} is expected, {TELLS_APART:.0f} is needed'
    if found.best is None:
        said += [
            f'No experiment tells all of {listed(names)} apart.',
            *(
                f'{found.best_for(pair).candidate.label} tells {pair[0]} from {pair[1]} best: '
                f'{counted.format(found.best_for(pair).evidence((pair,)))}.'
                for pair in found.told
            ),
        ]
    else:
        what = 'whatever can be told apart of ' if found.imitated else ''
        apart = '' if found.imitated else ' apart'
        said.append(
            f'{found.best.candidate.label} tells {what}{listed(names)}{apart} best: '
            f'{counted.format(found.best.evidence(found.told))}.'
        )
    for special in dict.fromkeys(pair[0] for pair in found.imitated):
        generals = [pair[1] for pair in found.imitated if pair[0] == special]
        same = [name for name in generals if (name, special) in found.imitated]
        more = [name for name in generals if name not in same]
        if more:
            said.append(
                f'{listed(more)} can do whatever {special} does: no experiment shows that '
                f'{special} is the cause. If nothing else shows, take it as the simpler one.'
            )
        said += [
            f'{special} and {name} are equivalent for every motion that was tried.'
            for name in same
            if special < name
        ]
    return ' '.join([*said, *_instead(found)])


def _equivalent(found: Suggestion) -> str:
    text = (
        f'{listed([cause.name for cause in found.causes])} are equivalent for every motion '
        f'that was tried: {len(found.rated)} experiments.'
    )
    if found.instead:
        return ' '.join([text, *_instead(found)])
    return f'{text} Measure one of them by itself: a mass on scales, a force with a load cell.'


def _instead(found: Suggestion) -> list[str]:
    return [f'{"Or" if place else "Instead,"} {line}.' for place, line in enumerate(found.instead)]


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
        'imitated': [list(pair) for pair in found.imitated],
        'instead': list(found.instead),
        'experiments': [
            {
                'experiment': item.candidate.label,
                'designed': item.candidate.design is not None,
                'duration_s': item.candidate.experiment.duration_s,
                'evidence': item.evidence(found.counted),
                'detectable': item.detectable(found.counted),
                'given_up': not all(pair in item.separations for pair in found.counted),
                'pairs': [
                    {'true': true, 'rival': rival, 'evidence': one.evidence}
                    for (true, rival), one in item.separations.items()
                ],
                'speed_share': _largest(item, 'speed'),
                'current_share': _largest(item, 'current'),
                'impossible': item.impossible or None,
            }
            for item in found.rated
        ],
    }


def _largest(item: Rated, share: str) -> float | None:
    """Return the largest share of a limit with any of the causes; None if nothing was simulated."""
    return max((getattr(one.load, share) for one in item.separations.values()), default=None)


def table_rows(found: Suggestion) -> list[tuple[str, ...]]:
    """Return label, evidence, times the detectable, length, speed and current of what can be run."""
    return [
        (
            item.candidate.label,
            significant(item.evidence(found.counted), 3),
            significant(item.detectable(found.counted), 3),
            f'{item.candidate.experiment.duration_s:.1f}',
            f'{100.0 * (_largest(item, "speed") or 0.0):.0f}',
            f'{100.0 * (_largest(item, "current") or 0.0):.0f}',
        )
        for item in found.possible
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
