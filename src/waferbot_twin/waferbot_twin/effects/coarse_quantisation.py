# SPDX-License-Identifier: Apache-2.0
"""
The encoder shows only multiples of some counts: a lower resolution than the model has.

    n_shown = step floor(n / step)
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import sensors
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    own = sensors.of_axis(variant.base, axis).errors.coarseness
    return (Parameter('step', 'counts', own, 16.0 * own, 1.0, 4096.0 * own, 'what is seen'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    encoder = sensors.of_axis(variant, axis)
    return sensors.overlay(encoder, {'coarseness_counts': values['step']})


EFFECT = Effect(
    'coarse_quantisation',
    Block.SENSOR,
    'the encoder is coarser than in the model',
    sensors.measured_axes,
    _parameters,
    _overlay,
    equation='n_shown = step floor(n / step)',
)
