# SPDX-License-Identifier: Apache-2.0
"""
The controller filters its feedback, and the model does not.

    y(n) = y(n-1) + (x(n) - y(n-1)) / (1 + tau)
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

LONGEST = 20.0


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('time_constant', 'servo interrupts', 0.0, 2.0, 0.0, LONGEST, 'of the filter'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    time_constant = variant.i_variable(axis, 'feedback_filter') + values['time_constant']
    return Overlay(pmac={axis: {'feedback_filter': time_constant}})


EFFECT = Effect(
    'feedback_filter',
    Block.CONTROLLER,
    'first-order filter of the feedback in the controller',
    places.controlled_axes,
    _parameters,
    _overlay,
    equation='y(n) = y(n-1) + (x(n) - y(n-1)) / (1 + time_constant)',
    title='low-pass filter of the feedback',
)
