# SPDX-License-Identifier: Apache-2.0
"""What readings say themselves of an encoder's resolution: of which counts all of them are multiples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_twin.effects import sensors
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.record import Record, common_step

LEAST_READINGS = 20
"""Different readings that an encoder must have shown for their common step to be its resolution."""


def coarser_steps(variant: Variant, records: Sequence[Record]) -> dict[str, float]:
    """Return by axis the step, counts, of readings that is more than that of the model's encoder."""
    steps = {}
    for axis in sensors.measured_axes(variant):
        encoder = sensors.of_axis(variant, axis)
        readings = np.concatenate(
            [record.reading[:, variant.layout.encoder_place(encoder.place)] for record in records]
        )
        known = np.unique(readings[np.isfinite(readings)])
        step = float(common_step(known))
        if len(known) >= LEAST_READINGS and step > encoder.errors.coarseness:
            steps[axis] = step
    return steps
