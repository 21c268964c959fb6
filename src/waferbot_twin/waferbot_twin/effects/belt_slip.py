# SPDX-License-Identifier: Apache-2.0
"""
The belt jumps or creeps over its pulley: it carries no more than a force, the rest slips.

Nothing happens while the drive needs less than that: at the neutral value, a hundred times what
moves usually take, it is not there. Where the model holds the belt rigid it becomes a spring, much
stiffer than its data say.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import belt_force, let_go, stage, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

_BELT = stage('belt')


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _BELT(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    usual = belt_force(variant, axis)
    most = 100.0 * usual
    return (Parameter('force', 'N', most, usual, 0.01 * usual, most, 'most that it carries'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['force'] >= 100.0 * belt_force(variant.base, axis):
        return Overlay()
    names = _BELT(variant, axis)
    return Overlay(with_law(let_go(variant, names), names[:1], {'slip_force_n': values['force']}))


EFFECT = Effect(
    'belt_slip',
    Block.PLANT,
    'the belt slips beyond a force',
    _axes,
    _parameters,
    _overlay,
    equation='|F| <= force, the rest of the motion slips',
    threshold=True,
)
