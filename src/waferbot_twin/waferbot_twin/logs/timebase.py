# SPDX-License-Identifier: Apache-2.0
"""
Times of samples: put in order, doubled ones left out, gaps found.

A logger's clock may be read out late (jitter), its buffer may have rolled over (the log then starts
in the middle), its clock may have been set back. The first is left as it is, the second is put in
order, of the third only the longest stretch is kept, because two stretches that claim the same time
cannot both be right.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.logs.findings import Finding, rows_text

Array = NDArray[np.float64]

LONG_STRETCH = 8
"""Rows in order that make a stretch of their own, rather than rows that arrived a little late."""


def median_step_s(time_s: Array) -> float:
    """Return the median of the steps of time, s."""
    return float(np.median(np.diff(time_s)))


def longest_step_s(time_s: Array) -> float:
    """
    Return the longest step of time that counts as usual, s; a longer one is a gap.

    max(1.5 m, m + 4 (p - m)) with m the median and p the 95th percentile of the steps: with even
    sampling one missing sample is a gap; a logger that jitters widens the limit by its own jitter.
    """
    if len(time_s) < 3:
        return float('inf')
    steps = np.diff(time_s)
    median, high = np.percentile(steps, [50.0, 95.0])
    return float(max(1.5 * median, median + 4.0 * (high - median)))


def unwrap(time: Array, period: float) -> Array:
    """Return a clock that starts again at `period` as one that runs on (NaN stays)."""
    finite = np.isfinite(time)
    result = time.copy()
    result[finite] = np.unwrap(time[finite], period=period)
    return result


def in_order(
    time_s: Array, value_rows: Array | None, file: str, place_of: Callable[[int], str]
) -> tuple[NDArray[np.intp], list[Finding]]:
    """
    Return the rows to use, in rising order of time, and what was wrong.

    `value_rows` (rows, columns) tells rows that repeat each other from rows that contradict each
    other at one time; of either only the first is used. `place_of` says where a row is.
    """
    findings = []
    finite = np.isfinite(time_s)
    if not finite.all():
        where = rows_text(np.flatnonzero(~finite), place_of)
        findings.append(Finding(where, 'time is missing or no number'))
    rows = np.flatnonzero(finite)
    back = np.flatnonzero(np.diff(time_s[rows]) < 0.0)
    if len(back):
        rows, remark = _sorted(rows, back, time_s, place_of)
        findings += remark
    same = np.flatnonzero(np.diff(time_s[rows]) == 0.0)
    if len(same):
        findings += _doubled(rows, same, time_s, value_rows, file, place_of)
        rows = np.delete(rows, same + 1)
    return rows, findings


def _sorted(
    rows: NDArray[np.intp],
    back: NDArray[np.intp],
    time_s: Array,
    place_of: Callable[[int], str],
) -> tuple[NDArray[np.intp], list[Finding]]:
    """Return rows whose time goes back (behind places `back`) in rising order."""
    stretches = np.split(rows, back + 1)
    where = rows_text(rows[back + 1], place_of)
    long = [stretch for stretch in stretches if len(stretch) >= LONG_STRETCH]
    kept: list[NDArray[np.intp]] = []
    for stretch in sorted(long, key=lambda stretch: -len(stretch)):
        if not any(_overlap(time_s, stretch, other) for other in kept):
            kept.append(stretch)
    if len(kept) == len(long):
        order = rows[np.argsort(time_s[rows], kind='stable')]
        return order, [Finding(where, 'time goes back; rows were sorted by time', 'put in order')]
    used = np.sort(np.concatenate(kept))
    order = used[np.argsort(time_s[used], kind='stable')]
    reason = (
        f'time starts again, so that {len(rows) - len(used)} rows claim times that longer '
        'stretches have already; import them as logs of their own'
    )
    return order, [Finding(where, reason)]


def _overlap(time_s: Array, one: NDArray[np.intp], other: NDArray[np.intp]) -> bool:
    """Tell whether two stretches share more than a little of their time."""
    begin = max(time_s[one[0]], time_s[other[0]])
    end = min(time_s[one[-1]], time_s[other[-1]])
    inside = [
        np.count_nonzero((time_s[rows] >= begin) & (time_s[rows] <= end)) for rows in (one, other)
    ]
    return bool(min(inside) >= LONG_STRETCH)


def _doubled(
    rows: NDArray[np.intp],
    same: NDArray[np.intp],
    time_s: Array,
    value_rows: Array | None,
    file: str,
    place_of: Callable[[int], str],
) -> list[Finding]:
    """Return what to say of rows with the time of the row before them."""
    where = rows_text(rows[same + 1], place_of)
    findings = []
    if len(same) > 0.2 * len(rows):
        reason = (
            f'{len(same)} of {len(rows)} rows have the time of the row before: the time column is '
            'coarser than the sampling; give time.sample_time_s instead of the column'
        )
        return [Finding(file, reason)]
    differs = np.zeros(len(same), bool)
    if value_rows is not None:
        one, other = value_rows[rows[same]], value_rows[rows[same + 1]]
        equal = (one == other) | (np.isnan(one) & np.isnan(other))
        differs = ~equal.all(axis=1)
    if differs.any():
        reason = (
            f'{int(differs.sum())} rows have the time of the row before and other values; '
            'the first of them was used'
        )
        findings.append(Finding(rows_text(rows[same[differs] + 1], place_of), reason))
    if not differs.all():
        findings.append(Finding(where, 'the same time as the row before (repeated)'))
    return findings
