# SPDX-License-Identifier: Apache-2.0
"""
Friction before the transmission that grows with speed, F = d v_motor: grease in a gearbox.

Where nothing gives between motor and axis, viscous friction of the axis stands for both.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    speed = places.rated_speed(variant, axis) * places.motor_ratio(variant, axis)
    scale = places.rated_motor_force(variant, axis) / speed
    unit = 'Nm s/rad' if places.motor_rotary(variant, axis) else 'N s/m'
    return (Parameter('damping', unit, 0.0, 0.1 * scale, 0.0, 30.0 * scale, 'at the motor'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(frictions.damper(variant, axis, 'gearbox_damping', values['damping']))


EFFECT = Effect(
    'gearbox_damping',
    Block.PLANT,
    'friction of motor and gearbox proportional to speed: grease',
    places.geared_axes,
    _parameters,
    _overlay,
    equation='F = damping v_motor',
    usual=True,
    same_as=('viscous_friction',),
    distinct=places.drive_gives,
    title='viscous friction of motor and gearbox',
)
