# SPDX-License-Identifier: Apache-2.0
"""Dry friction that does not depend on speed; adds to what the model has."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit = 'Nm' if places.rotary(variant, axis) else 'N'
    return (
        Parameter('friction', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'friction at any speed'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(places.extra_friction(variant, axis, [0.0], [values['friction']]))


EFFECT = Effect(
    'coulomb_friction', Block.PLANT, 'dry friction of seals, guides or bearings',
    places.motor_axes, _parameters, _overlay,
)  # fmt: skip
