# SPDX-License-Identifier: Apache-2.0
"""
The integral gain of the current loop (Ci) is not that of the model.

By the settings' `integral_scale`, which is continuous where Ci is a whole number.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('ratio', '', 1.0, 0.5, 0.0, 10.0, 'real Ci over that of the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    scale = variant.amplifier_setting(axis, 'integral_scale') * max(values['ratio'], 1e-3)
    return Overlay(copley={axis: {'integral_scale': scale}})


EFFECT = Effect(
    'current_loop_integral',
    Block.AMPLIFIER,
    'integral gain of the current loop (Ci) is not that of the model',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='Ci = ratio Ci of the model',
    title='current-loop integral gain error',
)
