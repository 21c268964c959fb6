# SPDX-License-Identifier: Apache-2.0
"""The electrical angle of the amplifier is off: F = k I cos(offset), the rest only heats."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

LARGEST_RAD = 1.2
"""At pi / 2 the motor has no force, beyond it runs the wrong way."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('offset', 'rad', 0.0, 0.2, -LARGEST_RAD, LARGEST_RAD, 'of the electrical angle'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    angle = variant.amplifier_setting(axis, 'commutation_offset') + values['offset']
    return Overlay(copley={axis: {'commutation_offset': angle}})


EFFECT = Effect(
    'commutation_offset',
    Block.AMPLIFIER,
    'electrical angle of the amplifier is off',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='F = k I cos(offset)',
)
