# SPDX-License-Identifier: Apache-2.0
"""
The counterweight of a lifting axis is heavier or lighter than in the model.

Its mass both moves with the axis and pulls on it by its weight, dM g: unlike `wrong_inertia` on
the same axis, where the weight is on the other side.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _body(variant: Variant, axis: str) -> str:
    """Return the name of the body that a cable from the axis drives."""
    driven = places.counterweight_coordinate(variant, axis)
    return next(
        joint.child
        for joint in variant.description.joints.values()
        if any(freedom.name == driven for freedom in joint.freedoms)
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    mass = variant.description.bodies[_body(variant, axis)].mass
    return (
        Parameter(
            'mass', 'kg', 0.0, 0.02 * mass, -0.8 * mass, 2.0 * mass, 'more than the model has'
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    name = _body(variant, axis)
    mass = variant.description.bodies[name].mass + values['mass']
    return Overlay({'bodies': {name: {'mass_kg': mass}}})


EFFECT = Effect(
    'counterweight_mass',
    Block.PLANT,
    'counterweight heavier or lighter than in the model',
    places.counterweight_axes,
    _parameters,
    _overlay,
    equation="(M + mass) x'' = ... + mass g",
    usual=True,
    title='counterweight mass error',
)
