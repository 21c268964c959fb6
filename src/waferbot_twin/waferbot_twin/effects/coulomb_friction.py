# SPDX-License-Identifier: Apache-2.0
"""Dry friction that does not depend on speed, F = F_c sign(v); adds to what the model has."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit = places.force_unit(variant, axis)
    return (
        Parameter('friction', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'friction at any speed'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(frictions.slot(variant, axis, 'coulomb_friction', [0.0], [values['friction']]))


EFFECT = Effect(
    'coulomb_friction',
    Block.PLANT,
    'dry friction of seals, guides or bearings',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = friction sign(v)',
    tried_at=frictions.STICKS,
    usual=True,
    title='Coulomb friction',
)
