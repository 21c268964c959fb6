# SPDX-License-Identifier: Apache-2.0
"""
A wafer is carried that the model does not have: a thin disc at the tip of the last axis.

Only an arm that turns about the vertical carries wafers: nothing is offered on a slide, a pendulum
or a wheel. The disc lies flat (across the vertical), with its centre twice as far from the joint as
the centre of gravity of what the axis carries: at the tip of an even arm. A wafer of 300 mm has
0.128 kg, one of 450 mm 0.34 kg; with what holds it, more.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

RADIUS_M = 0.15


_LEAST_ARM_M = 0.01
"""Distance of the centre of gravity from the axis from which a body counts as an arm."""


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axis whose body carries no other, if that is an arm that turns about the vertical."""
    parents = {joint.parent for joint in variant.description.joints.values()}
    return tuple(
        axis
        for axis in places.jointed_axes(variant)[-1:]
        if not parents.intersection(places.carried_bodies(variant, axis))
        and places.rotary(variant, axis)
        and _reach(variant, axis) > _LEAST_ARM_M
    )


def _reach(variant: Variant, axis: str) -> float:
    """Return how far an axis about the vertical holds its centre of gravity, m; 0 about another one."""
    joint, about = places.joint_of(variant, axis), places.direction_of(variant, axis)
    assert joint is not None
    if abs(about[1]) < 0.9:
        return 0.0
    arm = places.carried_body(variant.base, axis).centre_of_gravity - joint.at
    return float(np.linalg.norm(arm - (arm @ about) * about))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    highest = max(2.0, places.carried_body(variant, axis).mass)
    return (Parameter('mass', 'kg', 0.0, 0.3, 0.0, highest, 'of wafer and what holds it'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    body, joint = places.carried_body(variant, axis), places.joint_of(variant, axis)
    assert joint is not None
    mass = values['mass']
    tip = joint.at + 2.0 * (places.carried_body(variant.base, axis).centre_of_gravity - joint.at)
    across = mass * RADIUS_M**2 / 4.0
    disc = np.diag([across, 2.0 * across, across])
    arm = tip - body.centre_of_gravity
    whole = body.mass + mass
    # Both bodies about their common centre of gravity, by Steiner's theorem.
    both = (arm @ arm * np.eye(3) - np.outer(arm, arm)) * (body.mass * mass / whole)
    entry = {
        'mass_kg': whole,
        'centre_of_gravity_m': (body.centre_of_gravity + arm * (mass / whole)).tolist(),
        'inertia_kg_m2': places.tensor_entries(body.inertia + disc + both),
    }
    return Overlay({'bodies': {body.name: entry}})


EFFECT = Effect(
    'wafer',
    Block.ENVIRONMENT,
    'a carried wafer that the model does not have',
    _axes,
    _parameters,
    _overlay,
    equation='a disc of mass at the tip, inertia by Steiner',
    title='carried wafer',
)
