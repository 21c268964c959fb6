# SPDX-License-Identifier: Apache-2.0
"""
The friction that the model has on an axis is there, but not as large: F = ratio F_model.

Only on axes whose model has dry friction, of seals, guides, bearings or gears. With part data
(`part:`), what rises with speed is scaled as well.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.motor_axes(variant) if frictions.of_axis(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('ratio', '', 1.0, 1.5, 0.0, 30.0, 'real friction over that of the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    entries = variant.machine['frictions']
    return Overlay(
        {
            'frictions': {
                name: {
                    'factor': values['ratio']
                    * places.plain(variant, entries[name].get('factor', 1.0))
                }
                for name in frictions.of_axis(variant, axis)
            }
        }
    )


EFFECT = Effect(
    'wrong_friction',
    Block.PLANT,
    'the friction of the model has the wrong size',
    _axes,
    _parameters,
    _overlay,
    equation='F = ratio F_model',
    title="error of the model's friction",
)
