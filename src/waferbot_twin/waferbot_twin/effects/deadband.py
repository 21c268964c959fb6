# SPDX-License-Identifier: Apache-2.0
"""
The controller does nothing about small following errors: a true deadband (Ixx64 = -16) of a size
(Ixx65).

    error = 0 within +-size,    error - size sign(error) outside
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

TRUE_DEADBAND = -16
PER_COUNT = 16.0
"""Ixx65 is in sixteenths of a count."""

MOST_COUNTS = 2000.0


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes without a deadband."""
    return tuple(
        axis
        for axis in places.controlled_axes(variant)
        if variant.i_variable(axis, 'Ixx64') == 0.0
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter(
            'size', 'counts', 0.0, 40.0, 0.0, MOST_COUNTS, 'from zero error to its edge',
            resolution=1.0 / PER_COUNT,
        ),
    )  # fmt: skip


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    size = round(PER_COUNT * values['size'])
    if size == 0:
        return Overlay()
    return Overlay(pmac={axis: {'Ixx64': TRUE_DEADBAND, 'Ixx65': size}})


EFFECT = Effect(
    'deadband',
    Block.CONTROLLER,
    'deadband of the following error in the controller',
    _axes,
    _parameters,
    _overlay,
    equation='error = 0 within size, else error - size sign(error)',
    title='deadband of the following error',
)
