# SPDX-License-Identifier: Apache-2.0
"""
Dry friction in the guide of a counterweight: seals of its blocks.

F = F_c sign(v) at the speed of the counterweight. Only cables that stretch tell it from friction of the
axis itself, which it stands for where they do not: a counterweight that sticks leaves the axis hanging
on its cables.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    turns = variant.description.revolute[places.counterweight_coordinate(variant, axis)]
    meaning = 'of the guide of the counterweight'
    unit = 'Nm' if turns else 'N'
    return (Parameter('friction', unit, 0.0, 0.1 * rated, 0.0, 10.0 * rated, meaning),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    friction = [values['friction']]
    return Overlay(frictions.slot(variant, axis, 'counterweight_friction', [0.0], friction))


EFFECT = Effect(
    'counterweight_friction',
    Block.PLANT,
    'dry friction in the guide of the counterweight, behind its cables',
    places.counterweight_axes,
    _parameters,
    _overlay,
    equation='F = friction sign(v_counterweight)',
    tried_at=frictions.STICKS,
    usual=True,
    same_as=('coulomb_friction',),
    distinct=places.drive_gives,
    title='Coulomb friction of the counterweight',
)
