# SPDX-License-Identifier: Apache-2.0
"""
The windings are warmer than in the model: R = R_model (1 + 0.00393 dT), copper.

With a current loop that copes, hardly anything of it is seen outside the amplifier. Magnets, which
weaken by 0.1 % per kelvin as they warm, are another cause (`force_constant`).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

COPPER_1_K = 0.00393


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('rise', 'K', 0.0, 80.0, -50.0, 150.0, "above that of the model's resistance"),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    cold = variant.description.motors[axis].resistance
    warm = cold * (1.0 + COPPER_1_K * values['rise'])
    return Overlay({'motors': {axis: {'resistance_lead_to_lead_ohm': warm}}})


EFFECT = Effect(
    'winding_temperature',
    Block.MOTOR,
    'windings warmer than in the model: more resistance',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='R = R_model (1 + 0.00393 rise)',
    title='winding temperature rise',
)
