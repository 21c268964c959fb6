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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.effects.variant import Variant
from waferbot_twin.metrics import rms
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.record import Array, Record

ENOUGH_SAMPLES = 12_000
"""Samples of the residual that are enough, of several logs an equal share each: 12 s at 1 kHz."""

WINDOWS = 6
"""How many windows are taken of a log that is longer than needed; neighbours are one."""

LEAD = 0.1
"""Share of a window that is simulated before it and not judged."""


@dataclass(frozen=True)
class Windows:
    """A log and the times (s, s) of the windows that are used of it; none if all of it is."""

    record: Record
    spans_s: tuple[tuple[float, float], ...] = ()
    lead_s: float = 0.0

    @property
    def records(self) -> list[Record]:
        """What is used, as logs."""
        return [
            self.record.part(first, last, max(first - self.lead_s, 0.0))
            for first, last in self.spans_s
        ] or [self.record]

    def rms_errors(self, nominal: Variant, variant: Variant) -> dict[str, tuple[float, float]]:
        """
        Return what a variant leaves over of every encoder, counts RMS, in the windows and in the rest.

        Raises `UserError` if the simulation blows up.
        """
        block = PlantBlock(self.record, nominal)
        found = {}
        for channel, error in zip(block.channels, block.innovations(variant), strict=True):
            time_s = block.times_s(channel)
            inside = np.any([(time_s >= a) & (time_s < b) for a, b in self.spans_s], axis=0)
            found[channel] = (rms(error[inside]), rms(error[~inside]))
        return found


def in_windows(records: Sequence[Record], nominal: Variant) -> list[Windows]:
    """Return what is used of some logs, of each what tells most if it is longer than needed."""
    return [_chosen(record, nominal, ENOUGH_SAMPLES / len(records)) for record in records]


def _chosen(record: Record, nominal: Variant, enough: float) -> Windows:
    if any(nominal.pmac.values()):
        return Windows(record)
    block = PlantBlock(record, nominal)
    judged_s = record.duration_s - record.judged_from_s
    enough_s = enough / max(block.rates_hz, default=1.0)
    if judged_s <= enough_s:
        return Windows(record)
    length_s = enough_s / WINDOWS
    count = int(judged_s / length_s)
    edges_s: Array = record.judged_from_s + length_s * np.arange(count + 1.0)
    spans: list[tuple[float, float]] = []
    for place in sorted(_most_informative(_told(block, edges_s), WINDOWS)):
        first, last = float(edges_s[place]), float(edges_s[place + 1])
        if spans and spans[-1][1] == first:
            spans[-1] = (spans[-1][0], last)
        else:
            spans.append((first, last))
    return Windows(record, tuple(spans), LEAD * length_s)


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
