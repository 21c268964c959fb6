# SPDX-License-Identifier: Apache-2.0
"""
The cables between a lifting axis and its counterweight are too long: they have to be taken up.

    e = x_1 + x_2 - rest - slack,    F = k max(e, 0)

At the start the counterweight hangs lower by `slack`. Where the model holds the cables rigid they
become springs, much stiffer than their data say, that go slack when the axis falls faster than the
counterweight can follow.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import let_go, stage, with_law
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

_CABLE = stage('cable')


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _CABLE(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('slack', 'm', 0.0, 1e-3, 0.0, 0.1, 'more than the length in balance'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['slack'] == 0.0:
        return Overlay()
    names = _CABLE(variant, axis)
    return Overlay(with_law(let_go(variant, names), names[:1], {'slack_m': values['slack']}))


EFFECT = Effect(
    'cable_slack',
    Block.PLANT,
    'cables to the counterweight are too long',
    _axes,
    _parameters,
    _overlay,
    equation='e = x_1 + x_2 - rest - slack, F = k max(e, 0)',
    title='slack in the cables',
)
