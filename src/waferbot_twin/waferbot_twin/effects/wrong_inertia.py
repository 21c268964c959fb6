# SPDX-License-Identifier: Apache-2.0
"""The moving mass or inertia of an axis is not what the model has, M = M_model + dM."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    whole = places.joined_inertia(variant, axis)
    rotary = places.rotary(variant, axis)
    lowest = -0.9 * places.own_inertia(variant, axis)
    return (
        Parameter(
            'inertia' if rotary else 'mass', 'kg m2' if rotary else 'kg', 0.0, 0.05 * whole,
            lowest, 3.0 * whole, 'more than the model has',
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(places.more_inertia(variant, axis, next(iter(values.values()))))


EFFECT = Effect(
    'wrong_inertia',
    Block.PLANT,
    'mass or inertia that moves with the axis is wrong',
    places.jointed_axes,
    _parameters,
    _overlay,
    equation='M = M_model + mass (inertia)',
    usual=True,
    title='mass or inertia error',
)
