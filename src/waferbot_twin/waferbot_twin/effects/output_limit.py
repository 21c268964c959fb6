# SPDX-License-Identifier: Apache-2.0
"""
The controller's output ends at less than in the model (Ixx69).

Nothing happens while the axis needs less. Where it needs more, if only for a cycle, the largest command
is the limit itself: `with_limits` gives the effect on these axes, tried with that limit alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

NAME = 'output_limit'


def with_limits(limits: Mapping[str, float]) -> Effect:
    """Return the effect on the axes of `limits` alone, each tried with its limit, DAC bits."""

    def trials(variant: Variant, axis: str) -> tuple[Values, ...]:
        return ({'limit': limits[axis]},)

    return replace(EFFECT, axes=lambda variant: tuple(limits), trials=trials, threshold=False)


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    own = variant.i_variable(axis, 'Ixx69')
    per_bit = places.current_per_bit(variant, axis)
    tight = float(round(places.tight_current(variant, axis) / per_bit))
    return (
        Parameter(
            'limit', 'DAC bits', own, min(tight, 0.9 * own), min(10.0, own), own,
            'largest output', resolution=1.0,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(pmac={axis: {'Ixx69': round(values['limit'])}})


EFFECT = Effect(
    NAME,
    Block.CONTROLLER,
    'output limit of the controller (Ixx69) is lower than in the model',
    places.controlled_axes,
    _parameters,
    _overlay,
    equation='|output| <= limit',
    threshold=True,
    title='output limit of the controller',
)
