# SPDX-License-Identifier: Apache-2.0
"""
The encoder loses counts for good whenever it passes a mark, in either direction: dirt on the
scale.

Marks are at 1/2, 3/2, ... of `every` on both sides of zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from waferbot_twin.effects import sensors
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    encoder = sensors.of_axis(variant, axis)
    unit = sensors.unit(variant, encoder)
    every = _spacings(variant, axis)[0]
    return (
        Parameter('counts', 'counts', 0.0, 20.0, -1e5, 1e5, 'lost at a mark', resolution=1.0),
        Parameter(
            'every',
            unit,
            every,
            every,
            1e-3 * every,
            100.0 * every,
            'apart',
            shape=True,
            fixed=True,
        ),
    )


def _spacings(variant: Variant, axis: str) -> tuple[float, float]:
    """Return 20 and 100 mm, or an eighth and half of a turn."""
    turns = sensors.turns(variant, sensors.of_axis(variant, axis))
    return (math.pi / 4.0, math.pi) if turns else (0.02, 0.1)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['counts'] == 0.0:
        return Overlay()
    encoder = sensors.of_axis(variant, axis)
    every = f'every_{sensors.unit(variant, encoder)}'
    entry = {'counts': values['counts'], every: values['every']}
    return sensors.overlay(encoder, {'lost_counts': entry})


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    return tuple({'every': every} for every in _spacings(variant, axis))


EFFECT = Effect(
    'lost_counts',
    Block.SENSOR,
    'the encoder loses counts at marks',
    sensors.measured_axes,
    _parameters,
    _overlay,
    _trials,
    equation='n_shown = n - counts (marks passed)',
    title='lost encoder counts',
)
