# SPDX-License-Identifier: Apache-2.0
"""
Dry friction that grows with what the motor does, F = mu |F_motor| sign(v): a gear, a lead screw.

It acts where the motor is, so in a gear it is the loss of a mesh of efficiency 1 - mu when
driving.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('share', '', 0.0, 0.08, 0.0, 0.8, 'friction per force of the motor'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    law = {'per_motor_force': values['share']}
    return Overlay(frictions.slot(variant, axis, 'load_dependent_friction', [0.0], [0.0], law))


EFFECT = Effect(
    'load_dependent_friction',
    Block.PLANT,
    'dry friction that grows with the force of the motor: gears, screws, loaded bearings',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = share |F_motor| sign(v)',
    tried_at=frictions.STICKS,
    title='friction that grows with motor force',
)
