# SPDX-License-Identifier: Apache-2.0
"""
The inertia of a motor's rotor is not what the model has, J = J_model + dJ.

Felt at the axis it is larger by the square of the drive's ratio. Only what gives between motor and axis
tells it from inertia of the axis itself: where nothing does, `wrong_inertia` stands for both.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_plant.description import Rotor
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _rotor(variant: Variant, axis: str) -> Rotor | None:
    """Return the rotor that turns as the motor of an axis does, the largest one."""
    coordinate = places.motor_coordinate(variant, axis)
    own = [one for one in variant.description.rotors.values() if one.coordinate == coordinate]
    return max(own, key=lambda one: one.inertia, default=None)


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(axis for axis in places.geared_axes(variant) if _rotor(variant, axis))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rotor = _rotor(variant, axis)
    assert rotor is not None
    whole = places.joined_motor_inertia(variant, axis)
    meaning = 'more than the model has, at the motor'
    return (
        Parameter(
            'inertia', 'kg m2', 0.0, 0.05 * whole, -0.9 * rotor.inertia, 3.0 * whole, meaning
        ),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    rotor = _rotor(variant, axis)
    assert rotor is not None
    inertia = rotor.inertia + values['inertia']
    return Overlay({'rotors': {rotor.name: {'inertia_kg_m2': inertia}}})


EFFECT = Effect(
    'motor_inertia',
    Block.PLANT,
    "inertia of the motor's rotor is wrong",
    _axes,
    _parameters,
    _overlay,
    equation='J = J_model + inertia',
    usual=True,
    same_as=('wrong_inertia',),
    distinct=places.drive_gives,
    title="inertia error of the motor's rotor",
)
