# SPDX-License-Identifier: Apache-2.0
"""
The units in which people are told of an imported log.

Counts and servo cycles are the twin's own: somebody whose log has metres and seconds never chose them.
Of an imported log residuals are told in m or rad, those of a described controller in the unit of its
output. Of a recording of the twin everything stays as it is.
"""

from __future__ import annotations

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Parameter
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.problem import CONTROLLER, PLANT, UNITS
from waferbot_twin.residuals.record import Record


def shown_residual(
    record: Record, variant: Variant, block: str, channel: str
) -> tuple[float, str]:
    """Return what a residual of a channel is multiplied by when it is told, and its unit then."""
    if record.is_imported and block == PLANT:
        encoder = variant.base.description.encoders[channel]
        unit = 'rad' if variant.base.description.revolute[encoder.coordinate] else 'm'
        return 1.0 / abs(encoder.counts_per_unit), unit
    if block == CONTROLLER and channel in places.described_axes(variant):
        output = variant.base.description.controllers[channel].output
        unit = 'of full scale' if output == 'share' else output
        return 1.0 / places.amperes_per_output(variant, channel), unit
    return 1.0, UNITS[block]


def shown_value(record: Record, variant: Variant, axis: str, item: Parameter) -> tuple[float, str]:
    """Return what the value of an effect's parameter is multiplied by when it is told, and its unit."""
    if not record.is_imported:
        return 1.0, item.unit
    own = variant.base.layout.encoders_of(axis)
    if item.unit == 'counts' and own and own[0] in variant.base.description.encoders:
        per_unit = places.counts_per_unit(variant)[variant.base.layout.place(axis)]
        return 1.0 / abs(float(per_unit)), places.length_unit(variant, axis)
    return 1.0, item.unit
