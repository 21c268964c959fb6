# SPDX-License-Identifier: Apache-2.0
"""
Dry friction before the transmission: bearings of the motor, seals and teeth of the gearbox.

F = F_c sign(v) at the speed of the motor. Felt at the axis it is larger by the ratio of the drive. Only
what gives between motor and axis tells it from friction of the axis itself: where nothing does, Coulomb
friction stands for both.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_motor_force(variant, axis)
    unit = places.motor_force_unit(variant, axis)
    meaning = 'of the motor and gearbox, at the motor'
    return (Parameter('friction', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, meaning),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(frictions.slot(variant, axis, 'gearbox_friction', [0.0], [values['friction']]))


EFFECT = Effect(
    'gearbox_friction',
    Block.PLANT,
    'dry friction of motor and gearbox, before what gives in the drive',
    places.geared_axes,
    _parameters,
    _overlay,
    equation='F = friction sign(v_motor)',
    tried_at=frictions.STICKS,
    usual=True,
    same_as=('coulomb_friction',),
    distinct=places.drive_gives,
    title='Coulomb friction of motor and gearbox',
)
