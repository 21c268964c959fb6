# SPDX-License-Identifier: Apache-2.0
"""
Loss of a gear or screw, another one where the load drives the motor: efficiencies below one.

    F = mu |F_motor| sign(v),    mu = driving if F_motor v > 0,  back_driving / (1 - back_driving) if not

`driving` is the share of the motor's power that is lost on its way to the load, 1 - eta; `back_driving`
that of the load's power on its way to the motor. Of a worm or a screw the latter is the larger one;
near one it locks itself. Where both are alike this is `load_dependent_friction`. Exact at constant
speed: F_motor includes what speeds up the motor's own rotor, which does not pass the teeth.

Source: G. Niemann, H. Winter, Maschinenelemente II, Springer 2003.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _axes(variant: Variant) -> tuple[str, ...]:
    """
    Return the axes with a gear.

    The description of a machine alone need not name its gears; of a motor whose poles turn with its axis
    it says that there is none.
    """
    geared = places.geared_axes(variant)
    if not variant.is_machine_alone:
        return geared
    return tuple(
        axis
        for axis in places.motor_axes(variant)
        if axis in geared or not (places.rotary(variant, axis) and places.has_poles(variant, axis))
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('driving', '', 0.0, 0.05, 0.0, 0.8, '1 - efficiency, the motor drives'),
        Parameter('back_driving', '', 0.0, 0.2, 0.0, 0.9, '1 - efficiency, the load drives'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    law = {
        'per_motor_force': values['driving'],
        'per_motor_force_back': values['back_driving'] / (1.0 - values['back_driving']),
    }
    return Overlay(frictions.slot(variant, axis, 'gear_efficiency', [0.0], [0.0], law))


EFFECT = Effect(
    'gear_efficiency',
    Block.PLANT,
    'loss of a gear or screw that differs with who drives: the motor or the load',
    _axes,
    _parameters,
    _overlay,
    equation='F = mu |F_motor| sign(v), mu = driving or back_driving / (1 - back_driving)',
    tried_at=frictions.STICKS,
    title='gear efficiency, driving and back-driving',
)
