# SPDX-License-Identifier: Apache-2.0
"""
Long signals thinned out so that no peak is lost: of each stretch the least and the greatest sample.

What is kept are samples that were there, at their own times. Drawn as a line they look as all of them
do, as a column of a picture shows no more of a signal than how low and how high it goes there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.logs.timebase import longest_step_s

Array = NDArray[np.float64]

GROUP = 4
"""Samples of which two are kept."""


def extremes(time_s: Array, values: Array, stretch: int) -> tuple[Array, Array]:
    """
    Return the least and the greatest sample of every `stretch` samples, in the order of time.

    `time_s` and `values` (n,); the last stretch may be shorter.
    """
    whole = len(values) // stretch
    blocks = values[: whole * stretch].reshape(whole, stretch)
    starts = np.arange(whole) * stretch
    rows = [starts + blocks.argmin(axis=1), starts + blocks.argmax(axis=1)] if whole else []
    rest = values[whole * stretch :]
    if len(rest):
        rows.append(whole * stretch + np.array([rest.argmin(), rest.argmax()]))
    kept = np.unique(np.concatenate(rows)) if rows else np.zeros(0, np.intp)
    return time_s[kept], values[kept]


def thinned(time_s: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return a signal as at most `most` of its samples, or as it is if it has no more."""
    if len(values) <= most:
        return time_s, values
    return extremes(time_s, values, -(-2 * len(values) // most))


def thinned_with_gaps(time_s: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Return a signal as about `most` of its samples, with a NaN in every gap: no line goes across."""
    gaps = np.flatnonzero(np.diff(time_s) > longest_step_s(time_s)) + 1
    share = min(1.0, most / max(len(time_s), 1))
    times, parts = [], []
    for own_s, own in zip(np.split(time_s, gaps), np.split(values, gaps), strict=True):
        kept_s, kept = thinned(own_s, own, max(2, round(share * len(own))))
        times += [kept_s, kept_s[-1:]]
        parts += [kept, np.full(len(kept_s[-1:]), np.nan)]
    return np.concatenate(times), np.concatenate(parts)


class Thinned:
    """
    A signal that comes piece by piece, of which no more than `most` samples are kept.

    Whole up to there; then the stretches double each time that there are too many, so that all parts
    of the signal are as fine as the others.
    """

    def __init__(self, most: int) -> None:
        """Begin with nothing."""
        self._most = most
        self._stretch = 1
        self._kept: list[tuple[Array, Array]] = []
        self._count = 0
        self._pending: tuple[Array, Array] = (np.zeros(0), np.zeros(0))

    def add(self, time_s: Array, values: Array) -> None:
        """Add samples (n,) that follow those before."""
        pending = tuple(
            np.concatenate(pair) for pair in zip(self._pending, (time_s, values), strict=True)
        )
        whole = len(pending[0]) // self._stretch * self._stretch
        self._keep(pending[0][:whole], pending[1][:whole])
        self._pending = (pending[0][whole:], pending[1][whole:])

    def samples(self) -> tuple[Array, Array]:
        """Return times and values of what is kept."""
        times, values = zip(*self._kept, self._pending, strict=True)
        return np.concatenate(times), np.concatenate(values)

    def _keep(self, time_s: Array, values: Array) -> None:
        if len(values) == 0:
            return
        part = (time_s, values) if self._stretch == 1 else extremes(time_s, values, self._stretch)
        self._kept.append(part)
        self._count += len(part[0])
        while self._count > self._most:
            self._stretch = GROUP if self._stretch == 1 else 2 * self._stretch
            whole = tuple(np.concatenate(parts) for parts in zip(*self._kept, strict=True))
            self._kept = [extremes(whole[0], whole[1], GROUP)]
            self._count = len(self._kept[0][0])
