# SPDX-License-Identifier: Apache-2.0
"""
Dry friction that differs with the direction: a seal lip, a cable carrier, a canted guide.

    F = forward (v > 0), -backward (v < 0)

This is Coulomb friction of the mean and a constant force of half the difference,

    friction = (forward + backward) / 2,    force = (backward - forward) / 2,

in every motion, standing still included: as friction is not less than nothing in either direction, that
force never moves the axis by itself. No log can tell the two apart, so a diagnosis names the sum.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, nowhere
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit = places.force_unit(variant, axis)
    most = 10.0 * rated
    return (
        Parameter('forward', unit, 0.0, 0.15 * rated, 0.0, most, 'friction moving forward'),
        Parameter('backward', unit, 0.0, 0.05 * rated, 0.0, most, 'friction moving backward'),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    total = values['forward'] + values['backward']
    difference = values['forward'] - values['backward']
    law = {'asymmetry': difference / total} if total > 0.0 else {}
    return Overlay(
        frictions.slot(variant, axis, 'direction_dependent_friction', [0.0], [0.5 * total], law)
    )


EFFECT = Effect(
    'direction_dependent_friction',
    Block.PLANT,
    'dry friction that differs with the direction',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='F = forward (v > 0), -backward (v < 0)',
    tried_at=frictions.STICKS,
    same_as=('coulomb_friction', 'constant_force'),
    distinct=nowhere,
    title='Coulomb friction that differs with direction',
)
