# SPDX-License-Identifier: Apache-2.0
"""
What two encoders of an axis say of the play between them.

Where a drive has play, motor and load are apart by either half of it, as the drive pushes or pulls:

    gap = median of d above its middle - median of d below it,        d = load - motor, in axis units,

the middle that of the largest and the smallest d of a log, whose zero nobody knows. Two encoders know
that to parts of their steps, and a likelihood over the gap is as narrow: it is nowhere near a maximum at
sizes that are tried by powers of two. Without play this is what springs make of d, and no more than one
size more that is tried.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.record import Array, Record


def gaps_of(variant: Variant, records: Sequence[Record]) -> dict[str, float]:
    """Return by axis how far apart load and motor go, in units of the axis; the most of all logs."""
    gaps: dict[str, float] = {}
    for axis in places.jointed_axes(variant):
        scales = _counts_of_axis(variant, axis)
        for record in records:
            seen = [record.reading[:, place] / scale for place, scale in scales.items()]
            gap = _gap(*seen) if len(seen) == 2 else 0.0
            if gap > 0.0:
                gaps[axis] = max(gap, gaps.get(axis, 0.0))
    return gaps


def _counts_of_axis(variant: Variant, axis: str) -> dict[int, float]:
    """Return counts per m or rad of an axis for each of its encoders, by their place in a reading."""
    placing, layout = variant.base.rigid.placing, variant.base.layout
    own = placing[places.coordinate(variant, axis)][1]
    return {
        layout.encoder_place(name): encoder.counts_per_unit * placing[encoder.coordinate][1] / own
        for name, encoder in variant.base.description.encoders.items()
        if name in layout.encoders_of(axis)
    }


def _gap(load: Array, motor: Array) -> float:
    """Return the distance of the two places where the difference of two positions mostly is."""
    apart = load - motor
    apart = apart[np.isfinite(apart)]
    if not len(apart):
        return 0.0
    middle = 0.5 * (apart.max() + apart.min())
    above, below = apart[apart > middle], apart[apart <= middle]
    return float(np.median(above) - np.median(below)) if len(above) else 0.0
