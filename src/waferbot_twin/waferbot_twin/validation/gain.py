# SPDX-License-Identifier: Apache-2.0
"""
What an extension gains: nominal and extended model against logs that were not used for the fit.

Error is simulated less measured position, its RMS by (4.2), the improvement by (6.1). Where the log has
commanded positions and the controller is known, the closed loop is simulated; otherwise the plant is
driven by the measured currents, and the error is the innovation of an observer that is much slower
than the one of the search: it leaves the model alone for about as long as `FREE_S`, and holds no more
than its drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from waferbot_twin.effects.places import axis_counts, length_unit, position_encoder
from waferbot_twin.effects.variant import Variant
from waferbot_twin.metrics import performance_improvement, rms
from waferbot_twin.residuals.closed_loop_record import simulate
from waferbot_twin.residuals.plant_block import OBSERVER_HZ, PlantBlock
from waferbot_twin.residuals.record import Array, Record

FREE_S = 0.08
"""Time constant with which a plant without commands is held to the measurement, s: 2 Hz."""

CYCLES = 8.0
"""Cycles of that observer in a log at least, however short it is."""


@dataclass(frozen=True)
class AxisGain:
    """
    One axis of one log: times in s, position, both errors and the smallest step of readings in m or
    rad.
    """

    log: str
    axis: str
    unit: str
    time_s: Array
    measured: Array
    error_before: Array
    error_after: Array
    closed_loop: bool
    resolution: float

    @property
    def rms_before(self) -> float:
        """RMS error of the nominal model."""
        return rms(self.error_before)

    @property
    def rms_after(self) -> float:
        """RMS error of the extended model."""
        return rms(self.error_after)

    @property
    def improvement_percent(self) -> float:
        """Equation (6.1)."""
        return performance_improvement(self.rms_before, self.rms_after)

    @property
    def mean_square_before(self) -> float:
        """Mean square error of the nominal model, with that of rounding."""
        return self.rms_before**2 + self._rounding

    @property
    def mean_square_after(self) -> float:
        """Mean square error of the extended model, with that of rounding."""
        return self.rms_after**2 + self._rounding

    @property
    def mean_square_ratio(self) -> float:
        """Mean square error of the extended model over that of the nominal one."""
        return self.mean_square_after / self.mean_square_before

    @property
    def _rounding(self) -> float:
        """The variance r^2 / 12 of readings in steps of r: less than that is no error."""
        return self.resolution**2 / 12.0


def gains(nominal: Variant, extended: Variant, records: Sequence[Record]) -> list[AxisGain]:
    """Return the gain of every axis in every log; raises `UserError` if a model is unstable."""
    return [item for record in records for item in _gains_of(nominal, extended, record)]


def _gains_of(nominal: Variant, extended: Variant, record: Record) -> list[AxisGain]:
    closed_loop = record.closes_loop
    errors = (_closed_loop_errors if closed_loop else _plant_errors)(nominal, extended, record)
    found = []
    layout = record.layout
    for axis in layout.axes:
        per_unit = axis_counts(nominal, axis)
        place = layout.encoder_place(position_encoder(nominal, axis))
        if axis not in nominal.description.motors or place not in errors:
            continue
        time_s, measured, before, after = errors[place]
        known = np.isfinite(measured) & (time_s >= record.judged_from_s)
        if not known.any():  # no stretch without a gap is long enough for its observer
            continue
        found.append(
            AxisGain(
                record.name,
                axis,
                length_unit(nominal, axis),
                time_s[known],
                measured[known] / per_unit,
                before[known] / per_unit,
                after[known] / per_unit,
                closed_loop,
                record.resolution[place] / per_unit,
            )
        )
    return found


def gain_of_axes(gains: Sequence[AxisGain]) -> dict[str, Any]:
    """Return the gain of every axis over all logs as plain values."""
    return {
        axis: _gain([item for item in gains if item.axis == axis])
        for axis in dict.fromkeys(item.axis for item in gains)
    }


def _gain(items: Sequence[AxisGain]) -> dict[str, Any]:
    """Return the gain of one axis over all validation logs."""
    before = math.sqrt(float(np.mean([item.rms_before**2 for item in items])))
    after = math.sqrt(float(np.mean([item.rms_after**2 for item in items])))
    improvement = 100.0 * (before - after) / before if before > 0.0 else 0.0
    return {
        'unit': items[0].unit,
        'rms_before': before,
        'rms_after': after,
        'improvement_percent': improvement,
        'metrics': {
            item.log: {
                'rms_before': item.rms_before,
                'rms_after': item.rms_after,
                'improvement_percent': item.improvement_percent,
            }
            for item in items
        },
    }


Errors = dict[int, tuple[Array, Array, Array, Array]]
"""By place of an encoder: times (s), reading, error of nominal and extended model (counts)."""


def _closed_loop_errors(nominal: Variant, extended: Variant, record: Record) -> Errors:
    time_s = np.arange(len(record.reading)) / record.timing.encoder_hz
    before, after = (simulate(variant, record).reading for variant in (nominal, extended))
    return {
        place: (
            time_s,
            record.reading[:, place],
            before[:, place] - record.reading[:, place],
            after[:, place] - record.reading[:, place],
        )
        for place in range(len(record.layout.encoders))
        if np.isfinite(record.reading[:, place]).any()
    }


def _plant_errors(nominal: Variant, extended: Variant, record: Record) -> Errors:
    judged_s = record.duration_s - record.judged_from_s
    observer_hz = min(max(1.0 / (2.0 * math.pi * FREE_S), CYCLES / judged_s), OBSERVER_HZ)
    block = PlantBlock(record, nominal, observer_hz)
    before, after = (block.innovations(variant) for variant in (nominal, extended))
    return {
        record.layout.encoder_place(channel): (
            block.times_s(channel), block.measured(channel), -before[row], -after[row]
        )
        for row, channel in enumerate(block.channels)
    }  # fmt: skip
