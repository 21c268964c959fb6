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
    unit = places.force_unit(variant, axis)
    return (
        Parameter(
            'rise', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'more in motion than at rest'
        ),
        frictions.stribeck_speed(variant, axis, 'at which two thirds of the rise are there'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    name = 'velocity_strengthening_friction'
    speeds = [share * values['speed'] for share in frictions.STRIBECK_SHARES]
    resistances = [values['rise'] * (1.0 - share) for share in frictions.stribeck_curve()]
    return Overlay(frictions.slot(variant, axis, name, speeds, resistances))


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    return tuple({'speed': speed} for speed in frictions.stribeck_speeds(variant, axis))


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
