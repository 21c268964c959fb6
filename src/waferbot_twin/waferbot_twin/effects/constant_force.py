# SPDX-License-Identifier: Apache-2.0
"""A constant force from outside: a hose, a spring, a weight that the model does not have."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit = places.force_unit(variant, axis)
    return (
        Parameter('force', unit, 0.0, 0.1 * rated, -10.0 * rated, 10.0 * rated, 'on the axis'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    force = {'kind': 'constant', places.force_key(variant, axis): values['force']}
    return Overlay(places.disturbance(variant, axis, 'constant_force', force))


EFFECT = Effect(
    'constant_force',
    Block.ENVIRONMENT,
    'a constant force from outside',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = force',
)
