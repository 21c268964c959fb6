# SPDX-License-Identifier: Apache-2.0
"""
A bearing becomes stiffer under load: rolling contacts of Hertz, more of which carry.

    M = k c (1 + H c^2)

with c the tilt from that at home. For the guide of a linear and the bearing of a rotary axis, on
models in which these give, and whose springs do not follow the maker's chart (`stiffness_by: chart`),
which says it already. `stiffening` is H c_0^2 with c_0 the tilt under the carried weight: by
how much stiffer the bearing is there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_twin.effects import places
from waferbot_twin.effects.compliances import tilting_bearing, tilting_guide
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

GRAVITY_M_S2 = 9.81


def _group(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return the connections that give in the bearing of an axis, by a stiffness."""
    tilting = tilting_bearing if places.rotary(variant, axis) else tilting_guide
    connections = variant.description.connections
    return tuple(
        name
        for name in tilting(variant, axis)
        if connections[name].flexible and connections[name].curve is None
    )


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.jointed_axes(variant) if _group(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('stiffening', '', 0.0, 1.0, 0.0, 100.0, 'at the tilt under the weight'),)


def _weight_moment(variant: Variant, axis: str) -> float:
    """Return the moment of the heaviest carried body about the joint of the axis, Nm."""
    joint, body = places.joint_of(variant, axis), places.carried_body(variant, axis)
    assert joint is not None
    arm = body.centre_of_gravity - joint.at
    return GRAVITY_M_S2 * body.mass * max(float(np.linalg.norm(arm)), LEAST_ARM_M)


LEAST_ARM_M = 0.01


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    moment = _weight_moment(variant.base, axis)
    laws = {
        name: {
            'hardening_1_rad2': values['stiffening']
            * (variant.base.description.connections[name].stiffness / moment) ** 2
        }
        for name in _group(variant, axis)
    }
    return Overlay({'connections': laws} if values['stiffening'] > 0.0 else {})


EFFECT = Effect(
    'load_dependent_bearing_stiffness',
    Block.PLANT,
    'a bearing that becomes stiffer under load',
    _axes,
    _parameters,
    _overlay,
    equation='M = k c (1 + stiffening (c / c_0)^2)',
    title='bearing stiffness that grows with load',
)
