# SPDX-License-Identifier: Apache-2.0
"""
A drive has play, in its gear, its coupling or its screw: no force while it crosses from flank to flank.

    F = k max(|e| - gap / 2, 0) sign(e)

with e the deflection at the output of that stage. Where the model holds it rigid, its flanks become
springs, much stiffer than its data say, so that it is the play that is seen. A drive with several such
stages has its play in the first of them: which one it is makes no difference between its ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from waferbot_plant.description import Connection
from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import let_go, stage, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

_STAGE = stage('gear', 'coupling', 'rack')

USUAL_RAD, USUAL_M = 1e-3, 1e-5
"""Whole play of a gear at its output, and of a ball screw without preload."""


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _STAGE(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rotary = _first(variant, axis).rotary
    usual = USUAL_RAD if rotary else USUAL_M
    return (
        Parameter(
            'gap', 'rad' if rotary else 'm', 0.0, usual, 0.0, 100.0 * usual,
            'whole play, at the output of the stage',
        ),
    )  # fmt: skip


def _first(variant: Variant, axis: str) -> Connection:
    return variant.description.connections[_STAGE(variant, axis)[0]]


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['gap'] == 0.0:
        return Overlay()
    names = _STAGE(variant, axis)
    key = 'gap_rad' if _first(variant, axis).rotary else 'gap_m'
    return Overlay(with_law(let_go(variant, names), names[:1], {key: values['gap']}))


NAME = 'backlash'

EFFECT = Effect(
    NAME,
    Block.PLANT,
    'play of the drive: its gear, coupling or screw',
    _axes,
    _parameters,
    _overlay,
    tried_at=tuple(2.0**power for power in range(-8, 7)),
    equation='F = k max(|e| - gap / 2, 0) sign(e)',
    title='backlash',
)


def with_gaps(gaps: Mapping[str, float]) -> Effect:
    """Return the effect on the axes of `gaps` alone, each tried with its gap, in units of the axis."""

    def trials(variant: Variant, axis: str) -> tuple[Values, ...]:
        return ({'gap': gaps[axis]},)

    def axes(variant: Variant) -> tuple[str, ...]:
        return tuple(axis for axis in _axes(variant) if axis in gaps)

    return replace(EFFECT, axes=axes, trials=trials, tried_at=())
