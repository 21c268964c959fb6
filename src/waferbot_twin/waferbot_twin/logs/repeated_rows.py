# SPDX-License-Identifier: Apache-2.0
"""
Rows that repeat the row before: a recorder that is faster than what it records.

A recorder at 500 rows a second of a drive that reads its encoder 100 times a second writes every reading
five times. Taken as samples, the position is a staircase: its speed is zero for four rows and five times
too high for one, and its acceleration has spikes to both sides. Friction that follows the sign of the
speed is then fitted to a motion that nobody made. What was measured are the readings, so the rows that
only repeat one are left out, and the log has the rate of its readings.

**What shows it.** A coarse counter repeats, too, while the axis is slow or at rest, and that is right.
So only what no counter does is looked at: a value stands for m rows between two jumps the same way of
`JUMP_STEPS` steps of its resolution or more. An axis as fast as that passes a step in every row, so m is
1 unless its reading was held. With m of all such stands,

    share of rows that repeat = 1 - 1 / mean(m),      readings a second = row rate / mean(m)

What is the same as the row before by chance (a coarse current) is not looked at by itself: a signal goes
with a held one if its own changes are where those are, in `WITH` of all cases, while the axis moves.

**Regular or not.** If nearly all m are multiples of one k (`hold.run_length`), the clock of the recorder
is in step with that of the readings. Otherwise a reading is older than its row says, by up to the
longest usual stand less the shortest: a jitter that the log does not tell. Rows in which nothing is new
are left out all the same where they are most, as a staircase has that error and its steps beside.

**What is kept.** The first row of each reading, with its own time. Where nothing changes (an axis at
rest) every k-th row is kept, so that rest is no gap.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.hold import FEWEST_RUNS, run_length
from waferbot_twin.logs.measured import Signal
from waferbot_twin.plain_values import significant

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

JUMP_STEPS = 3.0
"""Steps of the resolution by which a reading of an axis in motion differs from the one before."""

SMALLEST = 1.0
"""Percentile of the jumps that is taken for a step where the resolution is not known."""

LONGEST = 3.0
"""Stands longer than so many usual ones are a rest between two motions."""

WITH = 0.95
"""Share of the changes of a signal that must be where readings of another change, to go with them."""

SOME_ROWS = 0.1
"""Share of repeated rows from which on it is said."""

USUAL = (5.0, 95.0)
"""Percentiles between which a stand is usual."""

LEADING = ('position', 'motor_position')
"""
Kinds that show it: what else is coarse repeats by chance, and a drive that stands alone is held by the
drive itself (`hold`).
"""

KEEP, LEAVE_OUT = 'keep', 'leave_out'
"""What a mapping may say of repeated rows (`options.repeated_rows`)."""


@dataclass(frozen=True)
class Stands:
    """
    For how many rows each reading stands while the axis moves: `rows` (n,), each begins at `first` (n,).

    `every` is k if that is regular, otherwise 0.
    """

    first: Rows
    rows: Rows
    every: int

    @property
    def repeated(self) -> float:
        """The share of rows that repeat the row before."""
        return 1.0 - 1.0 / float(np.mean(self.rows))

    @property
    def usual(self) -> int:
        """Rows that a reading usually stands for."""
        return self.every or max(1, round(float(np.median(self.rows))))

    @property
    def range(self) -> tuple[float, float]:
        """The shortest and the longest usual stand, in rows."""
        low, high = np.percentile(self.rows, USUAL)
        return float(low), float(high)

    @property
    def most(self) -> bool:
        """Whether most readings stand for more rows than one."""
        return self.usual > 1


def stands(value: Array, resolution: float) -> Stands | None:
    """Return how long readings (n,) stand while they move; None where too little tells that."""
    first = np.flatnonzero(np.diff(value) != 0.0) + 1
    jump = np.diff(value)[first - 1]
    rows = np.diff(first)
    if len(jump) == 0:
        return None
    step = resolution or float(np.percentile(np.abs(jump), SMALLEST))
    big = np.abs(jump) >= JUMP_STEPS * step * (1.0 - 1e-6)
    moving = big[:-1] & big[1:] & (np.sign(jump[:-1]) == np.sign(jump[1:]))
    if np.count_nonzero(moving) < FEWEST_RUNS:
        return None
    moving &= rows <= LONGEST * np.median(rows[moving])
    rows, first = rows[moving], first[:-1][moving]
    if len(rows) < FEWEST_RUNS:
        return None
    length = run_length(rows)
    regular = length > 1 and float(np.mean(rows % length == 0)) >= WITH
    return Stands(first, rows, length if regular else 0)


def without_repeated_rows(
    signals: Sequence[Signal], wish: str, findings: list[Finding]
) -> list[Signal]:
    """
    Return signals at the rate of their readings, and what to say of it.

    `wish` is `KEEP`, `LEAVE_OUT` or '' to decide by how many rows repeat a reading.
    """
    result = {signal.name: signal for signal in signals}
    for group in _with_common_times(signals):
        leader = next((one for one in group if one.kind in LEADING and _repeats(one)), None)
        if leader is None:
            continue
        held = stands(leader.value, leader.resolution)
        assert held is not None
        going = [one for one in group if one is leader or _goes_with(one, held)]
        leave = wish == LEAVE_OUT or (wish != KEEP and held.most)
        kept = _reading_rows(going, held) if leave else np.arange(len(leader.value))
        findings += _said(going, group, held, len(leader.value) - len(kept))
        for one in going if leave else []:
            result[one.name] = replace(one, time_s=one.time_s[kept], value=one.value[kept])
    return list(result.values())


def _repeats(signal: Signal) -> bool:
    """Tell whether a signal repeats its readings in motion, so often that it must be said."""
    held = stands(signal.value, signal.resolution)
    return held is not None and held.repeated >= SOME_ROWS


def _with_common_times(signals: Iterable[Signal]) -> list[list[Signal]]:
    """Return signals of one axis with the same times together, those that may lead first."""
    groups: list[list[Signal]] = []
    for signal in sorted(signals, key=lambda one: one.kind not in LEADING):
        for group in groups:
            if group[0].axis == signal.axis and np.array_equal(group[0].time_s, signal.time_s):
                group.append(signal)
                break
        else:
            groups.append([signal])
    return groups


def _goes_with(signal: Signal, held: Stands) -> bool:
    """Tell whether a signal changes, while the axis moves, where readings change; or never."""
    changes = _changes(signal)
    at_readings = np.count_nonzero(changes[held.first])
    return bool(at_readings >= WITH * np.count_nonzero(changes & _in_motion(signal, held)))


def _in_motion(signal: Signal, held: Stands) -> NDArray[np.bool_]:
    """Return in which rows (n,) of a signal the axis moves, as far as readings show it."""
    edges = np.zeros(len(signal.value) + 1, int)
    np.add.at(edges, held.first, 1)
    np.add.at(edges, held.first + held.rows, -1)
    return np.asarray(np.cumsum(edges[:-1]) > 0)


def _changes(signal: Signal) -> NDArray[np.bool_]:
    """Return in which rows (n,) a signal is not what it was in the row before."""
    return np.concatenate([[False], np.diff(signal.value) != 0.0])


def _reading_rows(signals: Sequence[Signal], held: Stands) -> Rows:
    """Return the first row of each reading; of a rest, which stands longer, every k-th one."""
    changes = np.logical_or.reduce([_changes(one) for one in signals])
    changes[0] = True
    new = np.flatnonzero(changes)
    stand = np.diff(np.append(new, len(changes)))
    # The last row of a rest is nearer to the next reading than to the one before, or is left out.
    count = np.where(stand > held.range[1], np.round(stand / held.usual), 1.0).astype(np.intp)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(np.repeat(new, count) + held.usual * within, np.intp)


def _said(
    going: Sequence[Signal], group: Sequence[Signal], held: Stands, left_out: int
) -> list[Finding]:
    """Return what the user must know of readings that stand for several rows."""
    names = ', '.join(one.name for one in going)
    row_hz, (low, high) = going[0].rate_hz, held.range
    reading_hz = row_hz / float(np.mean(held.rows))
    every = (
        f'in every {_ordinal(held.every)} row' if held.every else f'after {low:g} to {high:g} rows'
    )
    said = (
        f'{100.0 * held.repeated:.0f} % of the rows repeat the row before while the axis moves: '
        f'readings change {every}, {significant(reading_hz)} times a second in '
        f'{significant(row_hz)} rows a second'
    )
    others = [_rate_text(one, held) for one in group if one not in going]
    if others:
        said += f' ({", ".join(others)})'
    if left_out:
        said += (
            f'; {left_out} rows in which nothing is new were left out '
            '(options: {repeated_rows: keep} in the mapping, if not)'
        )
    else:
        said += (
            '; taken as samples they are a staircase, whose speed and acceleration are not those of the '
            'axis: record each reading once, or write options: {repeated_rows: leave_out} in the mapping'
        )
    findings = [Finding(names, said, 'left out' if left_out else 'suspect')]
    if not held.every:
        reason = (
            'not every reading stands for as many rows, so a row tells when it was measured only to '
            f'about {(high - low) / row_hz:.2g} s, and what is faster than that is noise: record the '
            'time that the drive gives to its readings and map that (time_column), or record in step '
            'with the drive'
        )
        findings.append(Finding(names, reason, 'suspect'))
    return findings


def _rate_text(signal: Signal, held: Stands) -> str:
    """Return how often a signal that does not go with the held ones changes in motion, in words."""
    share = float(np.mean(_changes(signal)[_in_motion(signal, held)]))
    return f'{signal.kind} changes {significant(share * signal.rate_hz)} times a second'


def _ordinal(number: int) -> str:
    ending = (
        'th' if 10 <= number % 100 <= 20 else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')
    )
    return f'{number}{ending}'
