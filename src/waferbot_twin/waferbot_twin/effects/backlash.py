# SPDX-License-Identifier: Apache-2.0
"""
The gear of a drive has play: no force while it crosses from one flank to the other.

    F = k max(|e| - gap / 2, 0) sign(e)

with e the deflection at the output of the gear stage. Where the model holds the gear rigid, its
flanks become springs, much stiffer than its data say, so that it is the play that is seen.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import let_go, stage, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

_GEAR = stage('gear')


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _GEAR(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('gap', 'rad', 0.0, 1e-3, 0.0, 0.1, 'whole play, at the output of the gear'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['gap'] == 0.0:
        return Overlay()
    names = _GEAR(variant, axis)
    return Overlay(with_law(let_go(variant, names), names[:1], {'gap_rad': values['gap']}))


EFFECT = Effect(
    'backlash',
    Block.PLANT,
    'play of the gear',
    _axes,
    _parameters,
    _overlay,
    tried_at=tuple(2.0**power for power in range(-8, 2)),
    equation='F = k max(|e| - gap / 2, 0) sign(e)',
    title='gear backlash',
)
