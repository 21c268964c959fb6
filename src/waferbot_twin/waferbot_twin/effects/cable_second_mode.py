# SPDX-License-Identifier: Apache-2.0
"""
The cables to the counterweight, with their pulleys, are not massless: they swing along themselves.

Mass in the middle of the cables, a spring of twice the stiffness on either side (the first two
modes of a rod). It adds a coordinate, so the machine is compiled anew. Where the model holds the
cables rigid they become springs of their data.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import giving, stage, with_compliance, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

_CABLE = stage('cable')


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _CABLE(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (
        Parameter('mass', 'kg', 0.0, 1.0, 0.0, 50.0, 'of cables and pulleys, along the cables'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['mass'] == 0.0:
        return Overlay()
    names = _CABLE(variant, axis)
    parts = giving(variant, names)
    machine = {} if parts[0].flexible else with_compliance(variant, parts, 1.0)
    return Overlay(with_law(machine, names[:1], {'rope_mass_kg': values['mass']}))


EFFECT = Effect(
    'cable_second_mode',
    Block.PLANT,
    'mass of the cables to the counterweight: a second mode',
    _axes,
    _parameters,
    _overlay,
    equation='mass in the middle of two springs of 2 k',
    rings=True,
    tried_at=(0.25, 0.5, 1.0, 2.0),
    title='mass of the cables',
)
