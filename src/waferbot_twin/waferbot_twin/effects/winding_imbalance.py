# SPDX-License-Identifier: Apache-2.0
"""
The three windings of the motor differ: turns, magnets' field, a short between turns.

    k_1 = k (1 + winding_1),    k_2 = k (1 + winding_2),    k_3 = k

Force of a constant current then changes twice per electrical cycle, and by the mean of the three.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('winding_1', '', 0.0, 0.06, -0.5, 0.5, 'relative change of winding 1'),
        Parameter('winding_2', '', 0.0, -0.04, -0.5, 0.5, 'relative change of winding 2'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    first, second = variant.description.motors[axis].phase_imbalance
    pair = [first + values['winding_1'], second + values['winding_2']]
    return Overlay({'motors': {axis: {'phase_imbalance': pair}}})


EFFECT = Effect(
    'winding_imbalance',
    Block.MOTOR,
    'force constants of the three windings differ',
    places.wound_axes,
    _parameters,
    _overlay,
    equation='k_w = k (1 + winding_w)',
)
