# SPDX-License-Identifier: Apache-2.0
"""
The final table: what the diagnosis must do, and what it was seen to do, by one commit.

A row counts k of n. It is met if the share k / n is on the right side of its limit, and only so far if
cases of the group have not been run; a bin of calibration is met if Wilson's 95 % interval of the share
of true names meets the bin. Lines of other commits than the last one are refused: a table of several
commits is a table of none.

What counts as what:

- named: of a single effect as `scoring.outcome_of_single` has it; of several at once, those with a size
  of 3 at least in the logs, named or in a credible set of at most 3;
- a true name: a hidden effect, or in such a set with one; names that the logs cannot tell from an
  effect out of the library are left out;
- calibration, and wrong and sure: the name itself is true, whatever its set: the probability is that of
  the name;
- a case that crashed has named nothing, and is none that is clean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from diagnosis_matrix import scoring
from diagnosis_matrix.cases import AMONG_KNOWN, GROUPS, OTHER, UNKNOWN
from diagnosis_matrix.deviations import BESIDE_THEM, CORRECTED
from diagnosis_matrix.trial import CRASHED, LEFT_OUT

Line = dict[str, Any]

FINAL_SEED = 5000
"""Seeds from here on are run once, by one commit."""

SURE = 0.95

BINS = ((0.5, 0.8), (0.8, 0.95), (0.95, 1.0))
"""Probabilities of names, to compare with how often these are true; a bin holds its lower end."""

LEAST_GAINS = {'y_linear': 66.0, 'x_rotate': 90.0, 'y_rotate': 93.0}
"""Improvement of the RMS error in the logs of the demonstration, percent."""

LONGEST_DEMO_S = 60.0

NO_LINES, NO_COMMIT = 'none', 'not known'
"""What stands for a commit where there are no results, or where git knew none."""

OTHER_CASES = 60
"""Machines of another simulator, at least."""


def rate(hits: int, cases: int) -> dict[str, Any]:
    """Return a share with its 95 % interval (Wilson's score interval); None without cases."""
    if cases == 0:
        return {'hits': 0, 'cases': 0, 'share': None, 'low95': None, 'high95': None}
    interval = binomtest(hits, cases).proportion_ci(0.95, 'wilson')
    return {
        'hits': hits,
        'cases': cases,
        'share': hits / cases,
        'low95': float(interval.low),
        'high95': float(interval.high),
    }


def share(items: Iterable[Any], is_hit: Callable[[Any], bool]) -> dict[str, Any]:
    """Return the rate of items that are hits."""
    hits = [is_hit(item) for item in items]
    return rate(sum(hits), len(hits))


@dataclass(frozen=True)
class Row:
    """
    A row of the table.

    `seen` is a rate, or `text` says what was seen where nothing is counted; `met` is None if nothing is
    known. `lacks` is how many cases of the group have not been run.
    """

    group: str
    what: str
    must: str
    seen: dict[str, Any] | None
    met: bool | None
    text: str = ''
    lacks: int = 0

    @property
    def shown(self) -> str:
        """What was seen, as the table has it."""
        if self.seen is None:
            return self.text or '-'
        if not self.seen['cases']:
            return '-'
        low, high = 100.0 * self.seen['low95'], 100.0 * self.seen['high95']
        return (
            f'{self.seen["hits"]} of {self.seen["cases"]}, {100.0 * self.seen["share"]:.1f} % '
            f'({low:.1f} to {high:.1f})'
        )

    @property
    def verdict(self) -> str:
        """Whether it is met: `-` if nothing is known, with the cases that lack if it is not whole."""
        if self.met is None:
            return '-'
        said = 'met' if self.met else 'NOT MET'
        return f'{said} so far, {self.lacks} to run' if self.lacks else said


def of_one_commit(lines: Sequence[Line]) -> tuple[str, list[Line], int]:
    """Return the commit of the last line, the lines of that commit, and how many others there are."""
    if not lines:
        return NO_LINES, [], 0
    commit = lines[-1].get('commit') or ''
    own = [line for line in lines if (line.get('commit') or '') == commit]
    return commit or NO_COMMIT, own, len(lines) - len(own)


def is_false_alarm(line: Line) -> bool:
    """Return whether something is named where nothing is hidden, or the case crashed."""
    return line['outcome'] in ('false alarm', CRASHED)


def is_found_unexplained(line: Line) -> bool:
    """Return whether an effect out of the library, its twins too, is left unexplained on its axis."""
    return bool(line.get('without_twins', line)['outcome'] == 'right')


def effects_of(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return all effects that are to be named: of several at once those that the logs show."""
    return [
        item for line in lines for item in line.get('effects', []) if item['size'] >= scoring.SHOWN
    ]


def names_of(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return all names that are true or false, of an unknown effect with its twins unknown, too."""
    return [
        name
        for line in lines
        for name in line.get('without_twins', line).get('names', [])
        if not name['related']
    ]


def has_false_name(line: Line) -> bool:
    """Return whether a case has a name that is neither true nor in a set with a true one."""
    return any(not item['in_set'] for item in names_of([line]))


def is_correction(name: str) -> bool:
    """Return whether a name is that of a parameter that every machine has a little off."""
    return name.split(':')[0] in (*CORRECTED, *BESIDE_THEM)


def table_of(lines: Sequence[Line], is_named: Callable[[Line], bool]) -> list[Row]:
    """Return the rows of the table; `is_named` tells whether a case came out right."""
    judged = [line for line in lines if line['outcome'] != LEFT_OUT]
    of = {name: [line for line in judged if line['group'] == name] for name in GROUPS}
    lacks = {
        name: max(group.cases - sum(line['group'] == name for line in lines), 0)
        for name, group in GROUPS.items()
    }

    def row(
        group: str, what: str, seen: dict[str, Any], least: float, most: float = 1.0, left: int = 0
    ) -> Row:
        said = f'{100.0 * least:g} % at least' if most == 1.0 else f'{100.0 * most:g} % at most'
        if least > 0.0 and most < 1.0:
            said = f'{100.0 * least:g} to {100.0 * most:g} %'
        met = None if seen['share'] is None else least <= seen['share'] <= most
        return Row(group, what, said, seen, met, lacks=left)

    rows = [
        row(name, 'named', share(of[name], is_named), least, left=lacks[name])
        for name, least in (('single-10', 0.98), ('single-3', 0.91), ('typical', 0.95))
    ]
    rows.append(
        row(
            'nothing', 'a name in an empty log', share(of['nothing'], is_false_alarm), 0.0, 0.01,
            lacks['nothing'],
        )
    )  # fmt: skip
    for name in ('several', 'everything-off'):
        rows += [
            row(
                name, 'effects of size 3 and more named', share(effects_of(of[name]), _is_named),
                0.9, left=lacks[name],
            ),
            row(
                name, 'names that are true', share(names_of(of[name]), _is_in_set), 0.95,
                left=lacks[name],
            ),
        ]  # fmt: skip
    off = of['everything-off']
    corrections = [item for line in off for item in line.get('corrections', [])]
    rows += [
        row(
            'everything-off', 'corrections within their 95 % interval',
            share([one for one in corrections if one['covered'] is not None], _is_covered), 0.9,
            left=lacks['everything-off'],
        ),
        row(
            'everything-off', 'names that are a correction reported as a cause',
            share(names_of(off), lambda one: not one['in_set'] and is_correction(one['name'])),
            0.0, 0.0, lacks['everything-off'],
        ),
    ]  # fmt: skip
    unknown = [line for line in judged if GROUPS[line['group']].kind in (UNKNOWN, AMONG_KNOWN)]
    left = lacks['unknown'] + lacks['unknown-among-known']
    rows += [
        row(
            'unknown', 'unexplained on the right axis', share(unknown, is_found_unexplained), 0.92,
            left=left,
        ),
        row('unknown', 'cases with a false name', share(unknown, has_false_name), 0.0, 0.04, left),
    ]  # fmt: skip
    rows += _of_other_simulator(of['other-simulator'], lines, row)
    names = names_of(judged)
    for low, high in BINS:
        own = [
            one
            for one in names
            if low <= one['probability'] and (high == 1.0 or one['probability'] < high)
        ]
        seen = share(own, _is_true)
        met = None
        if seen['share'] is not None:
            met = bool(seen['low95'] <= high and seen['high95'] >= low)
        rows.append(
            Row(
                'calibration', f'names given with {low:g} to {high:g} that are true',
                f'{100 * low:g} to {100 * high:g} %', seen, met,
            )
        )  # fmt: skip
    sure = share(names, lambda one: one['probability'] >= SURE and not one['true'])
    rows.append(
        row('wrong and sure', f'names with {SURE:g} and more, and false', sure, 0.0, 0.005)
    )
    covered = [one for one in errors_of(judged) if one['covered'] is not None]
    rows.append(
        row('intervals', '95 % intervals that cover', share(covered, _is_covered), 0.9, 0.98)
    )
    return rows + _of_demo(of['demo'])


def errors_of(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return all parameters of true names, with whether their interval covers."""
    return [
        error
        for line in lines
        for key in ('errors', 'other_errors', 'demo_errors')
        for error in line.get(key, [])
    ]


def _is_named(effect: dict[str, Any]) -> bool:
    return bool(effect['became'] != scoring.MISSED)


def _is_true(name: dict[str, Any]) -> bool:
    return bool(name['true'])


def _is_in_set(name: dict[str, Any]) -> bool:
    return bool(name['in_set'])


def _is_covered(item: dict[str, Any]) -> bool:
    return bool(item['covered'])


def _of_other_simulator(
    own: Sequence[Line], lines: Sequence[Line], row: Callable[..., Row]
) -> list[Row]:
    """Return the rows of machines of another simulator; a case that crashed has found nothing."""
    kind = next(name for name, group in GROUPS.items() if group.kind == OTHER)
    left = max(OTHER_CASES - sum(line['group'] == kind for line in lines), 0)
    effects = [
        value
        for line in own
        for value in line.get('became', dict.fromkeys(line['hidden'], scoring.MISSED)).values()
    ]
    empty = [line for line in own if not line['hidden']]
    clean = share(empty, lambda line: line['outcome'] == 'right')
    named = share(effects, lambda value: value != scoring.MISSED)
    false = share(names_of(own), lambda one: not one['in_set'])
    return [
        row(kind, 'effects named', named, 0.92, left=left),
        row(kind, 'names that are false', false, 0.0, 0.03, left),
        row(kind, 'empty logs clean', clean, 0.97, left=left),
    ]


def _of_demo(lines: Sequence[Line]) -> list[Row]:
    """Return the rows of the demonstration; one crash and nothing of it is met."""
    group = 'as built against rigid'
    if not lines:
        return [Row(group, 'the demonstration', 'to be run', None, None)]
    line = lines[-1]
    if line['outcome'] == CRASHED:
        return [Row(group, 'the demonstration', 'to end', None, False, 'crashed')]
    true = share(line['names'], _is_true)
    met = true['share'] is not None and true['share'] >= 0.9
    rows = [Row(group, 'causes named that differ', '90 % at least', true, met)]
    rows += [
        Row(group, f'{what} among them', 'yes', None, found, 'yes' if found else 'no')
        for what, found in line['found'].items()
    ]
    known = [
        item
        for item in (*line['demo_errors'], *line['corrections'])
        if item['covered'] is not None
    ]
    within = share(known, _is_covered)
    all_within = None if within['share'] is None else within['share'] == 1.0
    rows.append(Row(group, 'values known within their interval', 'all', within, all_within))
    rows += [
        Row(
            group, f'gain on {axis}', f'{least:g} % at least', None,
            line['gains'].get(axis, 0.0) >= least, f'{line["gains"].get(axis, 0.0):.1f} %',
        )
        for axis, least in LEAST_GAINS.items()
    ]  # fmt: skip
    fast = line['runtime_s'] <= LONGEST_DEMO_S
    rows.append(
        Row(
            group,
            'time',
            f'{LONGEST_DEMO_S:g} s at most',
            None,
            fast,
            f'{line["runtime_s"]:.0f} s',
        )
    )
    return rows


def print_table(
    console: Console,
    rows: Sequence[Row],
    commit: str,
    refused: int,
    seed: int,
    same: dict[str, str],
) -> None:
    """Print the table, with what it is of and what was refused."""
    table = Table(title=f'What must be true: commit {commit}, seed {seed}', title_justify='left')
    for heading in ('group', 'what', 'must be', 'seen (95 %)', 'met'):
        table.add_column(heading, no_wrap=heading != 'what')
    before = ''
    for one in rows:
        table.add_row(
            one.group if one.group != before else '', one.what, one.must, one.shown, one.verdict
        )
        before = one.group
    console.print(table)
    if refused:
        console.print(f'refused: {refused} lines of other commits; a table is of one commit only')
    if commit == NO_COMMIT or '-dirty' in commit:
        console.print('these sources are no commit: nobody can make this table again')
    if seed < FINAL_SEED:
        console.print(
            f'seed {seed} is for development; a final table has one of {FINAL_SEED} and up'
        )
    if same:
        pairs = ', '.join(f'{name} and {other}' for name, other in same.items())
        console.print(f'do exactly the same in this model, and count as each other: {pairs}')
