# SPDX-License-Identifier: Apache-2.0
"""
What an extension gains: nominal and extended model against logs that were not used for the fit.

Error is simulated less measured position, its RMS by (4.2), the improvement by (6.1). With commanded
positions the closed loop is simulated; without them the plant is driven by the measured currents and the
error is the innovation of its observer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.closed_loop_record import simulate
from waferbot_twin.diagnosis.plant_block import PlantBlock
from waferbot_twin.diagnosis.record import Array, Record
from waferbot_twin.effects.variant import Variant
from waferbot_twin.metrics import performance_improvement, rms


@dataclass(frozen=True)
class AxisGain:
    """One axis of one log: times in s, position and both errors in m or rad."""

    log: str
    axis: str
    unit: str
    time_s: Array
    measured: Array
    error_before: Array
    error_after: Array
    closed_loop: bool

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


def gains(nominal: Variant, extended: Variant, records: list[Record]) -> list[AxisGain]:
    """Return the gain of every axis in every log; raises `UserError` if a model is unstable."""
    return [item for record in records for item in _gains_of(nominal, extended, record)]


def _gains_of(nominal: Variant, extended: Variant, record: Record) -> list[AxisGain]:
    closed_loop = record.commanded is not None
    if closed_loop:
        before, after = (simulate(variant, record).reading for variant in (nominal, extended))
    first_s = record.judged_from_s
    found = []
    for place, axis in enumerate(AXES):
        encoder = nominal.description.encoders.get(ENCODERS[place])
        if encoder is None or axis not in nominal.description.motors:
            continue
        measured = record.reading[:, place]
        if not np.isfinite(measured).any():
            continue
        if closed_loop:
            errors = [side[:, place] - measured for side in (before, after)]
            time_s = (
                np.arange(len(measured)) * record.timing.encoder_divider * record.timing.tick_s
            )
        else:
            errors = [_innovation(variant, record, place) for variant in (nominal, extended)]
            block = PlantBlock(record, nominal)
            rows = (block.first_cycle + np.arange(len(errors[0]))) * block.averaged
            measured = measured[rows]
            time_s = rows * record.timing.encoder_divider * record.timing.tick_s
        known = np.isfinite(errors[0]) & np.isfinite(measured) & (time_s >= first_s)
        unit = 'rad' if nominal.description.revolute[encoder.coordinate] else 'm'
        found.append(
            AxisGain(
                record.name,
                axis,
                unit,
                np.asarray(time_s[known], np.float64),
                measured[known] / encoder.counts_per_unit,
                errors[0][known] / encoder.counts_per_unit,
                errors[1][known] / encoder.counts_per_unit,
                closed_loop,
            )
        )
    return found


def _innovation(variant: Variant, record: Record, place: int) -> Array:
    block = PlantBlock(record, variant)
    if ENCODERS[place] not in block.channels:
        raise UserError(f'{record.name}: {ENCODERS[place]} was not logged')
    return -block.residuals(variant)[block.channels.index(ENCODERS[place])]
