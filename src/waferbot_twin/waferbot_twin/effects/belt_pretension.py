# SPDX-License-Identifier: Apache-2.0
"""
The belt has lost pretension: one strand goes slack under load, and only the other still pulls.

    F = k e  up to 2 pretension,    slope k / 2 beyond

On models in which the belt gives. At the neutral value, fifty times what moves usually take, no
strand ever goes slack.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import belt_force, stage, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

_BELT = stage('belt')


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose belt gives."""
    connections = variant.description.connections
    return tuple(
        axis
        for axis in places.jointed_axes(variant)
        if any(connections[name].flexible for name in _BELT(variant, axis))
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    usual = belt_force(variant, axis)
    most = 50.0 * usual
    return (Parameter('pretension', 'N', most, 0.2 * usual, 0.01 * usual, most, 'of each strand'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['pretension'] >= 50.0 * belt_force(variant.base, axis):
        return Overlay()
    law = {'slack_preload_n': values['pretension']}
    return Overlay(with_law({}, _BELT(variant, axis)[:1], law))


EFFECT = Effect(
    'belt_pretension',
    Block.PLANT,
    'the belt has lost pretension: a strand goes slack',
    _axes,
    _parameters,
    _overlay,
    equation='F = k e up to 2 pretension, slope k / 2 beyond',
    threshold=True,
    title='lost belt pretension',
)
