# SPDX-License-Identifier: Apache-2.0
"""
Drag of rolling bearings and ball screws in oil or grease: it grows less than linearly with speed.

    F = drag |v|^(2/3) sign(v)

Palmgren's friction of an unloaded bearing, M = 1e-7 f_0 (nu n)^(2/3) d_m^3 in N mm, with the kinematic
viscosity nu in mm2/s, n in 1/min and d_m in mm, where nu n > 2000; f_0 is 0.7 to 12 with kind of bearing
and of lubrication. Below that it does not fall any further, which is a part of Coulomb friction.

Source: A. Palmgren, Ball and Roller Bearing Engineering, SKF 1959; T. A. Harris, M. N. Kotzalas,
Essential Concepts of Bearing Technology, CRC Press 2006, chapter 10.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

EXPONENT = 2.0 / 3.0


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    scale = places.rated_force(variant, axis) / places.rated_speed(variant, axis) ** EXPONENT
    length = places.length_unit(variant, axis)
    unit = f'{places.force_unit(variant, axis)} (s/{length})^(2/3)'
    return (Parameter('drag', unit, 0.0, 0.1 * scale, 0.0, 30.0 * scale, 'per speed to the 2/3'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(frictions.drag(variant, axis, 'rolling_drag', values['drag'], EXPONENT))


EFFECT = Effect(
    'rolling_drag',
    Block.PLANT,
    'drag of lubricated rolling bearings and screws, less than proportional to speed',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = drag |v|^(2/3) sign(v)',
    title='rolling-bearing drag',
)
