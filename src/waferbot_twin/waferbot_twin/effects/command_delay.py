# SPDX-License-Identifier: Apache-2.0
"""
The command takes longer from the controller to the amplifier than in the model.

In whole servo interrupts of the usual rate, 0.444 ms: the model has nothing in between, and the
parameter is rounded. A delay of the feedback, which a loop feels alike, is continuous
(`encoder_delay`).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_lockstep.timing import Timing
from waferbot_pmac.i_variables import LONGEST_COMMAND_DELAY
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

INTERRUPT_MS = 1e3 / Timing().servo_hz
"""Time between two servo interrupts."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    interrupts = LONGEST_COMMAND_DELAY - variant.i_variable(axis, 'command_delay')
    most = interrupts * INTERRUPT_MS
    return (
        Parameter(
            'delay', 'ms', 0.0, min(2.0 * INTERRUPT_MS, most), 0.0, most, 'more than in the model',
            resolution=INTERRUPT_MS,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    delay = round(variant.i_variable(axis, 'command_delay') + values['delay'] / INTERRUPT_MS)
    return Overlay(pmac={axis: {'command_delay': delay}})


EFFECT = Effect(
    'command_delay',
    Block.CONTROLLER,
    'the command reaches the amplifier late',
    places.controlled_axes,
    _parameters,
    _overlay,
    equation='I(t) = command(t - delay)',
    # An interrupt turns what swings at a quarter of their rate by 90 degrees, two by 180: of a loop that
    # a delay sets swinging, one says nothing of two.
    tried_at=(0.5, 1.0, 1.5, 2.0),
)
