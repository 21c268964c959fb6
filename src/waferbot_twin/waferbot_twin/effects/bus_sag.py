# SPDX-License-Identifier: Apache-2.0
"""
The supply of the amplifier is soft: its voltage falls with the power taken, U = U_0 - R P / U.

The amplifier goes on as if it had U_0, so that its loop weakens, and its voltage ends at what is
there (`voltage_limit`, which models leave off, is switched on with it).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

CIRCULAR_LIMIT = 1


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('resistance', 'ohm', 0.0, 8.0, 0.0, 10.0, 'of the supply behind the bus'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['resistance'] == 0.0:
        return Overlay()
    own = variant.amplifier_setting(axis, 'bus_resistance')
    limit = int(variant.amplifier_setting(axis, 'voltage_limit')) or CIRCULAR_LIMIT
    resistance = min(own + values['resistance'], 10.0)
    return Overlay(copley={axis: {'bus_resistance': resistance, 'voltage_limit': limit}})


EFFECT = Effect(
    'bus_sag',
    Block.AMPLIFIER,
    'bus voltage falls with the power taken',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='U = U_0 - resistance P / U',
    title='bus voltage sag',
)
