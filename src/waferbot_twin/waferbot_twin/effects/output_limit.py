# SPDX-License-Identifier: Apache-2.0
"""
The controller's output ends at less than in the model (Ixx69).

Nothing happens while the axis needs less.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    own = variant.i_variable(axis, 'Ixx69')
    per_bit = variant.i_variable(axis, 'amplifier_peak_current') / places.DAC_BITS
    tight = float(round(places.tight_current(variant, axis) / per_bit))
    return (
        Parameter(
            'limit', 'DAC bits', own, min(tight, 0.9 * own), min(10.0, own), own,
            'largest output', resolution=1.0,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(pmac={axis: {'Ixx69': round(values['limit'])}})


EFFECT = Effect(
    'output_limit',
    Block.CONTROLLER,
    'output limit of the controller (Ixx69) is lower than in the model',
    places.controlled_axes,
    _parameters,
    _overlay,
    equation='|output| <= limit',
    threshold=True,
)
