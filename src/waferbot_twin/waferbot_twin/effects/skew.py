# SPDX-License-Identifier: Apache-2.0
"""
The drive of an axis stands in the log later than the position: they came by different ways.

    F(t) = F_logged(t + late)

A property of the log: nothing in the machine changes. A position that stands later than the drive is
`encoder_delay`: whether encoder, drive or logger is late a log does not show.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

TYPICAL_MS, MOST_MS = 1.0, 20.0
"""A sample of a usual log, and as late as an encoder of a machine alone may be."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('late', 'ms', 0.0, TYPICAL_MS, 0.0, MOST_MS, 'the drive behind the position'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['late'] == 0.0:
        return Overlay()
    own = variant.skew_s.get(axis, 0.0)
    return Overlay(skew_s={axis: own + 1e-3 * values['late']})


EFFECT = Effect(
    'skew',
    Block.PLANT,
    'the drive stands in the log later than the position',
    places.skewed_axes,
    _parameters,
    _overlay,
    equation='F(t) = F_logged(t + late)',
    title='skew of drive and position',
    usual=True,
)
