# SPDX-License-Identifier: Apache-2.0
"""
The current sensors of the lines have different gains.

    measured_k = (1 + gain_k) i_k

A ripple of two periods per electrical cycle, of the relative amplitude (gain_1 - gain_2) /
sqrt(3), and less force by (gain_1 + gain_2) / 2.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('line_1', '', 0.0, 0.04, -0.5, 0.5, 'relative gain error of line 1'),
        Parameter('line_2', '', 0.0, -0.03, -0.5, 0.5, 'relative gain error of line 2'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    sensors = variant.description.current_sensors.get(axis)
    first, second = sensors.gains if sensors else (0.0, 0.0)
    entry = {'gain_1': first + values['line_1'], 'gain_2': second + values['line_2']}
    return Overlay({'current_sensors': {axis: entry}})


EFFECT = Effect(
    'phase_gain_mismatch',
    Block.AMPLIFIER,
    'gains of the current sensors differ',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='measured_k = (1 + line_k) i_k',
    title='gain mismatch of the current sensors',
)
