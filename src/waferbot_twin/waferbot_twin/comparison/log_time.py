# SPDX-License-Identifier: Apache-2.0
"""When the record of an imported log begins, on the log's own clock."""

from __future__ import annotations

import numpy as np

from waferbot_twin.comparison.traces import Array
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.residuals.record import Record

COMPARED = 2000
"""Readings that are looked for in the log."""

MOST_LATER = 2000
"""Samples of the log at most before the first that is in the record."""


def reading_times_s(record: Record, variant: Variant, place: int) -> tuple[np.ndarray, Array]:
    """Return the rows in which an encoder was read, and when, s from the record's beginning."""
    rows = np.flatnonzero(np.isfinite(record.reading[:, place]))
    return rows, when_read_s(record, variant, place, rows)


def when_read_s(record: Record, variant: Variant, place: int, rows: np.ndarray) -> Array:
    """
    Return when the readings in rows were taken, s from the record's beginning.

    What is published in a row was read some rows before, and at a time beside that of its tick.
    """
    own = variant.description.encoders[record.layout.encoders[place]].errors.extra_delay
    delay = variant.description.encoder_delay + own
    time_s = (rows - delay) * record.timing.encoder_divider * record.timing.tick_s
    return time_s if record.late_s is None else time_s + record.late_s[rows, place]


def beginning_s(record: Record, log: MeasuredLog, variant: Variant) -> float:
    """
    Return the time of a record's first tick on the clock of the log that it is of, s.

    A record begins where drive and position are known, at a cycle of the controller. Its readings are
    samples of the log: the beginning is the one with which they are found there. An axis that stands
    throughout tells it to a few samples.
    """
    best = (np.inf, 0.0)
    for axis in log.usable_axes():
        encoder = record.layout.encoders_of(axis)[0]
        if axis not in places.motor_axes(variant) or encoder not in variant.description.encoders:
            continue
        place = record.layout.encoder_place(encoder)
        rows, time_s = reading_times_s(record, variant, place)
        if len(rows) == 0:
            continue
        signal = log[axis, 'position']
        few = np.unique(np.linspace(0, len(rows) - 1, COMPARED).astype(np.intp))
        read = record.reading[rows[few], place]
        later = len(signal.time_s) - len(rows)
        span = float(np.ptp(read)) or 1.0
        for first in range(min(max(later, 0), MOST_LATER) + 1):
            begin_s = float(signal.time_s[first] - time_s[0])
            at = np.searchsorted(signal.time_s, time_s[few] + begin_s - 1e-7)
            value = signal.value[np.minimum(at, len(signal.value) - 1)]
            # Counts are linear in the value; which line it is does not matter here.
            slope, offset = np.polyfit(value, read, 1) if np.ptp(value) else (0.0, read.mean())
            apart = float(np.max(np.abs(slope * value + offset - read))) / span
            if apart < best[0]:
                best = (apart, begin_s)
            if apart < 1e-9:
                break
    return best[1]
