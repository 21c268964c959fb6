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


def _driven_body(variant: Variant, axis: str) -> str | None:
    """Return the body that a cable from the axis drives."""
    for transmission in variant.description.transmissions.values():
        if transmission.pulls_only and transmission.driving == places.coordinate(variant, axis):
            for joint in variant.description.joints.values():
                if any(freedom.name == transmission.driven for freedom in joint.freedoms):
                    return joint.child
    return None


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.motor_axes(variant) if _driven_body(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    mass = variant.description.bodies[_driven_body(variant, axis) or ''].mass
    return (
        Parameter(
            'mass', 'kg', 0.0, 0.02 * mass, -0.8 * mass, 2.0 * mass, 'more than the model has'
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    name = _driven_body(variant, axis) or ''
    mass = variant.description.bodies[name].mass + values['mass']
    return Overlay({'bodies': {name: {'mass_kg': mass}}})


EFFECT = Effect(
    'counterweight_mass',
    Block.PLANT,
    'counterweight heavier or lighter than in the model',
    _axes,
    _parameters,
    _overlay,
    equation="(M + mass) x'' = ... + mass g",
    usual=True,
)
