# SPDX-License-Identifier: Apache-2.0
"""Friction proportional to speed, F = d v; adds to what the model has."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    scale = places.rated_force(variant, axis) / places.rated_speed(variant, axis)
    unit = places.damping_unit(variant, axis)
    return (Parameter('damping', unit, 0.0, 0.1 * scale, 0.0, 30.0 * scale, 'friction per speed'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(frictions.damper(variant, axis, 'viscous_friction', values['damping']))


EFFECT = Effect(
    'viscous_friction',
    Block.PLANT,
    'friction proportional to speed: grease, seals, eddy currents',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = damping v',
    usual=True,
)
