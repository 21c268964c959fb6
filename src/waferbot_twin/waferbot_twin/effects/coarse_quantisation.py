# SPDX-License-Identifier: Apache-2.0
"""
The encoder shows only multiples of some counts: a lower resolution than the model has.

    n_shown = step floor(n / step)

How large the step is, readings say themselves: `with_steps` gives the effect on the axes whose readings
are all multiples of more than the model's, with that step, which is held. A fit could not find it: a
step that is a little wrong explains nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from waferbot_twin.effects import sensors
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

NAME = 'coarse_quantisation'


def with_steps(steps: Mapping[str, float]) -> Effect:
    """Return the effect on the axes of `steps` alone, each with its step, counts."""

    def trials(variant: Variant, axis: str) -> tuple[Values, ...]:
        return ({'step': steps[axis]},)

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        return tuple(replace(item, fixed=True) for item in _parameters(variant, axis))

    return replace(
        EFFECT,
        axes=lambda variant: tuple(steps),
        parameters=parameters,
        trials=trials,
        evident=True,
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    own = sensors.of_axis(variant.base, axis).errors.coarseness
    return (
        Parameter(
            'step', 'counts', own, 16.0 * own, 1.0, 4096.0 * own, 'what is seen', resolution=own
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    encoder = sensors.of_axis(variant, axis)
    return sensors.overlay(encoder, {'coarseness_counts': values['step']})


EFFECT = Effect(
    NAME,
    Block.SENSOR,
    'the encoder is coarser than in the model',
    sensors.measured_axes,
    _parameters,
    _overlay,
    equation='n_shown = step floor(n / step)',
    title='coarse encoder resolution',
)
