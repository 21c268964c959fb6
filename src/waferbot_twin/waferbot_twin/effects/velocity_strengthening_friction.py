# SPDX-License-Identifier: Apache-2.0
"""
Dry friction that rises with speed to a plateau: polymer on metal, wipers, dry bushes.

    F = rise (1 - exp(-(|v| / v_s)^2)) sign(v)

Stribeck's curve with the other sign: with Coulomb friction F_c beside it, F_c at rest and F_c + rise in
motion, that is F = F_0 + dF exp(-(|v| / v_s)^2) with F_0 = F_c + rise and dF = -rise. Written so,
friction never pushes, however little of it there is at rest. Nothing of it is there at rest, so it goes
with `presliding`: the bristles stay all there is before the axis slides. As a table of ten speeds up to
3 v_s, an error below 2 % of the rise.

Source: K. G. McLaren, D. Tabor, Visco-elastic properties and the friction of solids, Nature 197 (1963).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    speed = 0.2 * places.rated_speed(variant, axis)
    unit = places.force_unit(variant, axis)
    # Far below what an axis mostly moves at, this speed makes it Coulomb friction by another name.
    slowest = 0.2 * speed
    speed_unit = f'{places.length_unit(variant, axis)}/s'
    return (
        Parameter(
            'rise', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'more in motion than at rest'
        ),
        Parameter(
            'speed', speed_unit, speed, speed, slowest, 10.0 * speed,
            'at which two thirds of the rise are there', shape=True,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    name = 'velocity_strengthening_friction'
    speeds = [share * values['speed'] for share in frictions.STRIBECK_SHARES]
    resistances = [values['rise'] * (1.0 - share) for share in frictions.stribeck_curve()]
    return Overlay(frictions.slot(variant, axis, name, speeds, resistances))


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    speed = 0.2 * places.rated_speed(variant, axis)
    return tuple({'speed': share * speed} for share in (0.3, 1.0, 4.0))


EFFECT = Effect(
    'velocity_strengthening_friction',
    Block.PLANT,
    'dry friction that is lower near rest than in motion: polymer guides, wipers',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation='F = rise (1 - exp(-(v / speed)^2)) sign(v)',
    title='dry friction that rises with speed',
)
