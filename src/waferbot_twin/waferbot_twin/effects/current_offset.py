# SPDX-License-Identifier: Apache-2.0
"""
The current sensors show a current where there is none, line by line.

    measured_k = i_k + offset_k

The amplifier makes the measured current right, so the true one is wrong by the offset: a force of
one period per electrical cycle, constant where the axis stands still.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    peak = places.peak_current(variant, axis)
    most = 0.2 * peak
    return (
        Parameter('line_1', 'A', 0.0, 0.004 * peak, -most, most, 'offset of the sensor of line 1'),
        Parameter(
            'line_2', 'A', 0.0, -0.002 * peak, -most, most, 'offset of the sensor of line 2'
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    sensors = variant.description.current_sensors.get(axis)
    first, second = sensors.offsets if sensors else (0.0, 0.0)
    entry = {'offset_1_a': first + values['line_1'], 'offset_2_a': second + values['line_2']}
    return Overlay({'current_sensors': {axis: entry}})


EFFECT = Effect(
    'current_offset',
    Block.AMPLIFIER,
    'offset of the current sensors',
    places.amplified_axes,
    _parameters,
    _overlay,
    equation='measured_k = i_k + line_k',
    title='current-sensor offset',
)
