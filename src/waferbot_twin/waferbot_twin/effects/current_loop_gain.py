# SPDX-License-Identifier: Apache-2.0
"""
The current loop is faster or slower than in the model: both gains times `ratio`.

By the settings' scale `gain_scale`, which is continuous where Cp and Ci are whole numbers.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('ratio', '', 1.0, 0.6, 0.05, 2.5, 'real gains over those of the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    scale = variant.amplifier_setting(axis, 'gain_scale') * values['ratio']
    return Overlay(copley={axis: {'gain_scale': scale}})


EFFECT = Effect(
    'current_loop_gain',
    Block.AMPLIFIER,
    'gains of the current loop (Cp and Ci) are not those of the model',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='Cp, Ci = ratio Cp, ratio Ci of the model',
    title='current-loop gain error',
)
