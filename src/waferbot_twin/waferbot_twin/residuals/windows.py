# SPDX-License-Identifier: Apache-2.0
"""
Informative windows of logs that are longer than needed.

What a parameter of an axis changes in its residual goes with its motion: with orthonormal columns Q
(n, k) of position, speed, acceleration, direction and what follows from these
(`noise_model.motion_basis`). The rows Q_w of a window tell Q_w' Q_w of what the whole log tells, which
is 1. Of m windows some are taken, one after another, each the one with which

    J = sum over channels of ln |1 / m^2 + sum over windows of Q_w' Q_w|                           (1)

is largest: a D-optimal design (V. Fedorov, Theory of Optimal Experiments, 1972), of experiments that
were made already. It knows nothing of what the logs leave over, so it favours no cause.

A window begins in motion, as a log may. A little before it is simulated and not judged: what sticks and
rings is in the state that it had by then.

Not of machines with the twin's own controller: how full its integrators were in the middle of a log is
not known, and it follows to the last bit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.record import Array, Record

ENOUGH_SAMPLES = 12_000
"""Samples of the residual, of logs together, that are as many as needed: 12 s of a log with 1 kHz."""

WINDOWS = 6
"""In how many windows a log is used at least, if it is longer than needed."""

LEAD = 0.1
"""Share of a window that is simulated before it and not judged."""


def in_windows(records: Sequence[Record], nominal: Variant) -> tuple[list[Record], list[str]]:
    """Return what is used of some logs, and for each that is longer than needed a note what that is."""
    found: list[Record] = []
    notes: list[str] = []
    for record in records:
        windows = _chosen(record, nominal, ENOUGH_SAMPLES / len(records))
        found += [record.part(first, last, begin) for begin, first, last in windows] or [record]
        if windows:
            used_s, whole_s = sum(last - first for _, first, last in windows), record.duration_s
            spans = ', '.join(f'{first:.1f} to {last:.1f}' for _, first, last in windows)
            notes.append(
                f'{record.name} is longer than needed: of its {whole_s:.1f} s those {used_s:.1f} '
                f's were used that tell most of its motion ({spans} s)'
            )
    return found, notes


def _chosen(record: Record, nominal: Variant, enough: float) -> list[tuple[float, float, float]]:
    """Return the beginning, the first and the last time judged of windows, s; none if all is needed."""
    if any(nominal.pmac.values()):
        return []
    block = PlantBlock(record, nominal)
    judged_s = record.duration_s - record.judged_from_s
    enough_s = enough / max(block.rates_hz, default=1.0)
    if judged_s <= enough_s:
        return []
    length_s = enough_s / WINDOWS
    count = int(judged_s / length_s)
    edges_s: Array = record.judged_from_s + length_s * np.arange(count + 1.0)
    told = _told(block, edges_s)
    chosen = sorted(_most_informative(told, WINDOWS))
    lead_s = LEAD * length_s
    windows: list[tuple[float, float, float]] = []
    for place in chosen:
        first, last = float(edges_s[place]), float(edges_s[place + 1])
        if windows and windows[-1][2] == first:
            windows[-1] = (*windows[-1][:2], last)
        else:
            windows.append((max(first - lead_s, 0.0), first, last))
    return windows


def _told(block: PlantBlock, edges_s: Array) -> list[Array]:
    """Return Q_w' Q_w of every window between two times (windows, k, k), channel by channel."""
    found = []
    for channel, noise in zip(block.channels, block.noises, strict=True):
        assert noise.shapes is not None
        basis, time_s = noise.shapes.motion, block.times_s(channel)
        rows = np.searchsorted(time_s, edges_s)
        if basis.shape[1] == 0:  # it stands: every sample tells as much
            basis = np.full((len(time_s), 1), len(time_s) ** -0.5)
        own = [basis[first:last] for first, last in itertools.pairwise(rows)]
        found.append(np.array([part.T @ part for part in own]))
    return found


def _most_informative(told: Sequence[Array], count: int) -> list[int]:
    """Return the windows with which equation (1) is largest, one after another."""
    windows = len(told[0]) if told else 0
    known = [np.eye(part.shape[1]) / windows**2 for part in told]
    chosen: list[int] = []
    left: NDArray[np.bool_] = np.ones(windows, np.bool_)
    for _ in range(min(count, windows)):
        gains = sum(
            np.linalg.slogdet(before + part)[1] for before, part in zip(known, told, strict=True)
        )
        best = int(np.argmax(np.where(left, gains, -np.inf)))
        known = [before + part[best] for before, part in zip(known, told, strict=True)]
        left[best] = False
        chosen.append(best)
    return chosen
