# SPDX-License-Identifier: Apache-2.0
"""
Viscous friction that differs with the direction: a grease or a wiper that is drawn one way.

    F = forward v (v > 0), backward v (v < 0)

That is a mean damping, which `viscous_friction` describes as well, and a force of half the difference
times |v|, which nothing else in the library describes.

Source: A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear
System Identification Benchmarks, Eindhoven 2019 (the friction of a ball screw's axis, by direction).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    scale = places.rated_force(variant, axis) / places.rated_speed(variant, axis)
    unit = places.damping_unit(variant, axis)
    most = 30.0 * scale
    return (
        Parameter('forward', unit, 0.0, 0.12 * scale, 0.0, most, 'friction per speed, forward'),
        Parameter('backward', unit, 0.0, 0.06 * scale, 0.0, most, 'friction per speed, backward'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    total = values['forward'] + values['backward']
    difference = values['forward'] - values['backward']
    law = {'asymmetry': difference / total} if total > 0.0 else {}
    return Overlay(
        frictions.drag(variant, axis, 'direction_dependent_damping', 0.5 * total, 1.0, law)
    )


EFFECT = Effect(
    'direction_dependent_damping',
    Block.PLANT,
    'friction proportional to speed, by another factor in each direction',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = forward v (v > 0), backward v (v < 0)',
    title='viscous friction that differs with direction',
)
