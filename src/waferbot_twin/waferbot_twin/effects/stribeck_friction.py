# SPDX-License-Identifier: Apache-2.0
"""
Friction that is higher at rest than in motion, and falls as a film of lubricant builds up.

    F = F_b exp(-(|v| / v_s)^2) sign(v)

with F_b the part that has to be broken away from and v_s Stribeck's speed. Only that part: with
`coulomb_friction` it is the usual curve. Of the other sign, lower at rest than in motion, it is
`velocity_strengthening_friction`. As a table of ten speeds up to 3 v_s, an error below 2 %
of F_b.

Source: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and
compensation methods for the control of machines with friction, Automatica 30 (1994).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    speed = 0.02 * places.rated_speed(variant, axis)
    unit = places.force_unit(variant, axis)
    # Far above what an axis reaches, Stribeck's speed makes this Coulomb friction by another name.
    fastest = 8.0 * speed
    speed_unit = f'{places.length_unit(variant, axis)}/s'
    return (
        Parameter('breakaway', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, 'more at rest'),
        Parameter(
            'speed', speed_unit, speed, speed, 0.02 * speed, fastest,
            "Stribeck's speed: a third is left there", shape=True,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    speeds = [share * values['speed'] for share in frictions.STRIBECK_SHARES]
    resistances = [values['breakaway'] * share for share in frictions.stribeck_curve()]
    return Overlay(frictions.slot(variant, axis, 'stribeck_friction', speeds, resistances))


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    speed = 0.02 * places.rated_speed(variant, axis)
    return tuple({'speed': share * speed} for share in (0.25, 1.0, 5.0))


EFFECT = Effect(
    'stribeck_friction',
    Block.PLANT,
    'friction that falls with speed: stick-slip when moving slowly',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation='F = breakaway exp(-(v / speed)^2) sign(v)',
    tried_at=frictions.STICKS,
    title='Stribeck friction',
)
