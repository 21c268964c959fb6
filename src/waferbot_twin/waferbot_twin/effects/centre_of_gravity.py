# SPDX-License-Identifier: Apache-2.0
"""
What an axis turns is out of balance in another way than in the model.

The centre of gravity of the heaviest body that the axis carries moves by an offset across the
axis, given along the base axes at home. Gravity then makes the torque m g x offset, and speed
couples into the other axes. On a vertical axis gravity is felt only when another axis has tilted
it. Of bodies of one density none is further off its axis than a rod that turns about its end,
(3 J / (4 m))^(1/2). Each of the two offsets may be as much as makes that together, or as makes 0.4 of
the rated force, if that is more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if places.rotary(variant, axis))


def _across(variant: Variant, axis: str) -> tuple[int, ...]:
    """Return the two base axes that are farthest from the direction of the axis."""
    direction = np.abs(places.direction_of(variant, axis))
    return tuple(sorted(np.argsort(direction, kind='stable')[:2].tolist()))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    body = places.carried_body(variant, axis)
    typical = 0.05 * places.rated_force(variant, axis) / (9.81 * body.mass)
    rod = math.sqrt(3.0 / 8.0) * places.radius_of_gyration(variant, axis, body)
    most = max(8.0 * typical, rod)
    return tuple(
        Parameter(
            f'offset_{"xyz"[place]}', 'm', 0.0, typical, -most, most,
            f'along {"xyz"[place]} at home',
        )
        for place in _across(variant, axis)
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    body = places.carried_body(variant, axis)
    centre = body.centre_of_gravity.copy()
    for place in _across(variant, axis):
        centre[place] += values[f'offset_{"xyz"[place]}']
    return Overlay({'bodies': {body.name: {'centre_of_gravity_m': centre.tolist()}}})


EFFECT = Effect(
    'centre_of_gravity',
    Block.PLANT,
    'centre of gravity off where the model has it: gravity turns the axis',
    _axes,
    _parameters,
    _overlay,
    equation='torque = m g x offset',
    usual=True,
    title='centre-of-gravity offset',
)
