# SPDX-License-Identifier: Apache-2.0
"""
The iron of the motor saturates: force grows less than the current, F = k I / sqrt(1 + (I /
I_s)^2).

`curvature` is 1 / I_s^2: the loss of force is about curvature I^2 / 2 while it is small.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    _, moving = places.usual_currents(variant, axis)
    # A loss of 5 % at the current of usual moves.
    typical = 0.1 / moving**2
    return (
        Parameter(
            'curvature', '1/A2', 0.0, typical, 0.0, 100.0 * typical, '1 / saturation current^2'
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    own = variant.description.motors[axis].saturation_current
    curvature = values['curvature'] + (own**-2 if own > 0.0 else 0.0)
    if values['curvature'] == 0.0:
        return Overlay()
    return Overlay({'motors': {axis: {'saturation_current_a': curvature**-0.5}}})


EFFECT = Effect(
    'motor_saturation',
    Block.MOTOR,
    'iron saturates: less force per ampere at high current',
    places.current_axes,
    _parameters,
    _overlay,
    equation='F = k I / sqrt(1 + curvature I^2)',
    title='magnetic saturation of the motor',
)
