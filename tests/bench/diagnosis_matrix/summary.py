# SPDX-License-Identifier: Apache-2.0
"""Rates, errors, times and confusions of many cases, with their intervals."""

from __future__ import annotations

import itertools
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from diagnosis_matrix.cases import (
    AMONG_KNOWN,
    DEMO,
    GROUPS,
    NOTHING,
    OFF,
    OTHER,
    SEVERAL,
    SINGLE,
    TWO,
    UNKNOWN,
)
from diagnosis_matrix.requirements import rate, share
from diagnosis_matrix.trial import CRASHED, LEFT_OUT

Line = dict[str, Any]

NAMED = {
    SINGLE: ('right', 'group'),
    NOTHING: ('right',),
    TWO: ('both', 'both and a false one'),
    UNKNOWN: ('right',),
    AMONG_KNOWN: ('right',),
    SEVERAL: ('all',),
    OFF: ('all',),
    OTHER: ('right', 'all'),
    DEMO: ('all names true',),
}
"""Outcomes that count as right, by kind."""

SIZES = (0.7, 1.5, 2.2, 4.5, 8.0, 15.0, 50.0, float('inf'))
"""Edges of the detection curve."""

LARGEST_ERROR = {'other': 0.05, 'shape': 0.05, 'gain': 0.01, 'inertia': 0.01, 'delay': 0.1}


def is_named(line: Line) -> bool:
    """Return whether a case came out right."""
    return line['outcome'] in NAMED[GROUPS[line['group']].kind]


def summarise(lines: Sequence[Line]) -> dict[str, Any]:
    """Return everything that is known of these cases, as plain values."""
    judged = [line for line in lines if line['outcome'] != LEFT_OUT]
    of = {name: [line for line in judged if line['group'] == name] for name in GROUPS}
    singles = [line for line in judged if GROUPS[line['group']].kind == SINGLE]
    errors = [error for line in of['single-10'] for error in line.get('errors', [])]
    return {
        'groups': {
            name: {
                'right': share(of[name], is_named),
                'left_out': sum(
                    line['group'] == name and line['outcome'] == LEFT_OUT for line in lines
                ),
                'outcomes': dict(Counter(line['outcome'] for line in of[name]).most_common()),
            }
            for name in GROUPS
        },
        'shown_to_judges': {
            name: share(
                [line for line in of[name] if line.get('judging_size', 1.0) >= 1.0], is_named
            )
            for name in ('single-10', 'single-3')
        },
        'false_alarms': share(of['nothing'], lambda line: line['outcome'] == 'false alarm'),
        'wrong_and_sure': share(
            of['single-10'] + of['single-3'], lambda line: line.get('wrong_and_sure', False)
        ),
        'false_in_place_of_two': share(
            of['two'], lambda line: line['outcome'] == 'false in place'
        ),
        'unknown_without_twins': share(
            of['unknown'], lambda line: line.get('without_twins', line)['outcome'] == 'right'
        ),
        'detection': _detection(singles),
        'confusions': _confusions(judged),
        'left_out': _left_out(lines),
        'parameters': _parameters(errors),
        'errors': {
            kind: _median([error['error'] for error in errors if error['kind'] == kind])
            for kind in LARGEST_ERROR
        },
        'coverage': share(
            [error for error in errors if error['covered'] is not None],
            lambda error: error['covered'],
        ),
        'gain_share': _gain_shares(of['single-10']),
        'other_simulator': other_simulator(of['other-simulator']),
        'times_s': {
            name: times([line['runtime_s'] for line in own if 'runtime_s' in line])
            for name, own in of.items()
        },
        'commits': dict(Counter(line.get('commit') or 'not known' for line in lines)),
    }


BINS = (0.0, 0.5, 0.9, 0.99, 1.0)
"""Edges of the probabilities of names, to compare with how often these are true."""


def other_simulator(lines: Sequence[Line]) -> dict[str, Any]:
    """
    Return what became of every kind of hidden effect, false names, coverage, and calibration.

    A name with a probability counts as true if it, or one of its set, is right.
    """
    ended = [line for line in lines if line['outcome'] != CRASHED]
    became: dict[str, Counter[str]] = {}
    for line in ended:
        for kind, value in line['became'].items():
            became.setdefault(kind, Counter())[value] += 1
    names = [name for line in ended for name in line['names'] if not name['related']]
    empty = [line for line in ended if not line['hidden']]
    effects = [value for line in ended for value in line['became'].values()]
    errors = [error for line in ended for error in line['other_errors']]
    return {
        'effects': {kind: dict(counts) for kind, counts in sorted(became.items())},
        'named': rate(sum(value in ('named', 'noted') for value in effects), len(effects)),
        'named_or_in_set': rate(sum(value != 'missed' for value in effects), len(effects)),
        'with_false_names': share(ended, lambda line: bool(line['false'])),
        'empty_right': share(empty, is_named),
        'false_names': dict(
            Counter(item['name'] for line in ended for item in line['false']).most_common()
        ),
        'coverage': share(
            [error for error in errors if error['covered'] is not None],
            lambda error: error['covered'],
        ),
        'calibration': [
            {
                'from': low,
                'to': high,
                'true': share(
                    [name for name in names if low < name['probability'] <= high],
                    lambda name: name['in_set'],
                ),
            }
            for low, high in itertools.pairwise(BINS)
        ],
        'crashed': len(lines) - len(ended),
    }


def _detection(singles: Sequence[Line]) -> list[dict[str, Any]]:
    """Return how often an effect of some size is named, and how often anything is seen."""
    rows = []
    for low, high in itertools.pairwise(SIZES):
        inside = [line for line in singles if 'sizes' in line and low <= line['sizes'][0] < high]
        rows.append(
            {
                'from': low,
                'to': high if high < float('inf') else None,
                'size': statistics.geometric_mean([line['sizes'][0] for line in inside])
                if inside
                else None,
                'named': share(inside, is_named),
                'seen': share(inside, lambda line: line['outcome'] != 'missed'),
            }
        )
    return rows


def _confusions(judged: Sequence[Line]) -> list[dict[str, Any]]:
    """
    Return what was reported in place of the truth, the most frequent first.

    With how often the true model itself wins in the logs for judging: no diagnosis can confirm one that
    loses there, such as a ring whose phase the noise decides.
    """
    found: dict[tuple[str, str, str], list[Line]] = {}
    for line in judged:
        if not is_named(line):
            key = (' + '.join(line['hidden']) or 'nothing', _reported(line), line['group'])
            found.setdefault(key, []).append(line)
    ordered = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
    return [
        {
            'truth': truth,
            'reported': reported,
            'group': group,
            'cases': len(lines),
            'truth_wins': sum(line.get('gain_of_truth', [0.0])[-1] > 0.0 for line in lines),
        }
        for (truth, reported, group), lines in ordered
    ]


def _reported(line: Line) -> str:
    names = [item['name'] for item in line.get('reported', [])]
    if names:
        return ' + '.join(names)
    return str(line['outcome'])


def _left_out(lines: Sequence[Line]) -> dict[str, int]:
    """Return how often an effect could not be had in the size wanted."""
    found = Counter(' + '.join(line['hidden']) for line in lines if line['outcome'] == LEFT_OUT)
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def _parameters(errors: Sequence[Line]) -> list[dict[str, Any]]:
    """Return median error and coverage of every parameter of every effect."""
    keys = sorted({(error['effect'], error['name']) for error in errors})
    rows = []
    for effect, name in keys:
        own = [e for e in errors if (e['effect'], e['name']) == (effect, name)]
        rows.append(
            {
                'effect': effect,
                'parameter': name,
                'kind': own[0]['kind'],
                'cases': len(own),
                'median_error': _median([e['error'] for e in own])['median'],
                'coverage': share([e for e in own if e['covered'] is not None], _covered),
            }
        )
    return rows


def _covered(error: Line) -> bool:
    return bool(error['covered'])


def _median(values: Sequence[float]) -> dict[str, Any]:
    return {'cases': len(values), 'median': statistics.median(values) if values else None}


def _gain_shares(lines: Iterable[Line]) -> dict[str, Any]:
    """Return how much of the true model's improvement the extended models reach."""
    values = [line['gain_share'] for line in lines if line.get('gain_share') is not None]
    return {**_median(values), 'enough': rate(sum(value >= 0.8 for value in values), len(values))}


def times(values: Sequence[float]) -> dict[str, Any]:
    """Return the median, the 90 % quantile and the largest of times, s; None without any."""
    found = _median(values)
    most = float(np.quantile(values, 0.9)) if values else None
    return {**found, 'most': most, 'longest': max(values) if values else None}


def _text(item: dict[str, Any]) -> str:
    if not item['cases']:
        return '-'
    return f'{100 * item["share"]:.1f} ({100 * item["low95"]:.1f} to {100 * item["high95"]:.1f})'


def _number(value: float | None) -> str:
    return '-' if value is None else f'{value:.3g}'


def plain_console() -> Console:
    """Return a console for tables."""
    return Console(markup=False, highlight=False, width=130)


def print_tables(found: dict[str, Any]) -> None:
    """Print groups, detection curve, confusions, errors and times."""
    console = plain_console()
    table = _table('Cases by group', 'group', 'judged', 'left out', 'right [%] (95 %)', 'outcomes')
    for name, group in found['groups'].items():
        outcomes = ', '.join(f'{count} {outcome}' for outcome, count in group['outcomes'].items())
        table.add_row(
            name,
            str(group['right']['cases']),
            str(group['left_out']),
            _text(group['right']),
            outcomes,
        )
    console.print(table)
    table = _table('Detection by size', 'size', 'cases', 'named [%] (95 %)', 'seen [%] (95 %)')
    for row in found['detection']:
        upper = 'more' if row['to'] is None else f'{row["to"]:g}'
        table.add_row(
            f'{row["from"]:g} to {upper}', str(row['named']['cases']), _text(row['named']),
            _text(row['seen']),
        )  # fmt: skip
    console.print(table)
    table = _table('Not right', 'hidden', 'reported', 'group', 'cases', 'where the truth wins')
    for row in found['confusions'][:40]:
        table.add_row(
            row['truth'], row['reported'], row['group'], str(row['cases']), str(row['truth_wins'])
        )
    if found['confusions']:
        console.print(table)
    table = _table(
        'Parameters at 10 x',
        'effect',
        'parameter',
        'error of',
        'cases',
        'median error',
        'covered [%]',
    )
    for row in found['parameters']:
        table.add_row(
            row['effect'], row['parameter'], row['kind'], str(row['cases']),
            _number(row['median_error']), _text(row['coverage']),
        )  # fmt: skip
    if found['parameters']:
        console.print(table)
    _print_other_simulator(console, found['other_simulator'])
    table = _table('Time of a diagnosis [s]', 'group', 'cases', 'median', '90 %', 'longest')
    for name, time in found['times_s'].items():
        if time['cases']:
            values = (_number(time[key]) for key in ('median', 'most', 'longest'))
            table.add_row(name, str(time['cases']), *values)
    if table.row_count:
        console.print(table)
    commits = ', '.join(f'{name} ({count})' for name, count in found['commits'].items())
    console.print(f'found with commits: {commits}')
    if found['left_out']:
        names = ', '.join(f'{name} ({count})' for name, count in found['left_out'].items())
        console.print(f'left out, because the size is out of reach on that motion: {names}')


def _print_other_simulator(console: Console, found: dict[str, Any]) -> None:
    if not found['named']['cases'] and not found['empty_right']['cases']:
        return
    table = _table('Machines of another simulator', 'what', 'cases', '[%] (95 %)')
    rows = {
        'effects named': found['named'],
        'named or in the set': found['named_or_in_set'],
        'cases with a false name': found['with_false_names'],
        'nothing hidden, nothing found': found['empty_right'],
        '95 % intervals that cover': found['coverage'],
    }
    for row in found['calibration']:
        rows[f'true, of names with {row["from"]:g} to {row["to"]:g}'] = row['true']
    for what, item in rows.items():
        table.add_row(what, str(item['cases']), _text(item))
    console.print(table)
    for kind, counts in found['effects'].items():
        console.print(f'  {kind}: ' + ', '.join(f'{n} {what}' for what, n in counts.items()))
    if found['false_names']:
        names = ', '.join(f'{name} ({n})' for name, n in found['false_names'].items())
        console.print(f'  false names: {names}')
    if found['crashed']:
        console.print(f'  commands that failed: {found["crashed"]}')


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify='left')
    for place, heading in enumerate(headings):
        table.add_column(heading, justify='left' if place in (0, len(headings) - 1) else 'right')
    return table
