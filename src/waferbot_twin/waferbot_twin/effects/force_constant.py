# SPDX-License-Identifier: Apache-2.0
"""The motor's force or torque constant (and back-EMF) is not what the model has, k = ratio k_model."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_plant.description_drives import FORCE_KEYS
from waferbot_plant.motors import force_constant
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('ratio', '', 1.0, 0.95, 0.3, 2.0, 'real constant over that of the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    motor = variant.description.motors[axis]
    turns = places.motor_rotary(variant, axis)
    if motor.by_force:
        constant = force_constant(motor) * values['ratio']
        return Overlay({'motors': {axis: {FORCE_KEYS[turns]: constant}}})
    unit = 'rad' if turns else 'm'
    key = f'back_emf_lead_to_lead_v_s_{unit}'
    return Overlay({'motors': {axis: {key: motor.back_emf * values['ratio']}}})


EFFECT = Effect(
    'force_constant',
    Block.MOTOR,
    'force or torque per ampere is wrong (weak or hot magnets)',
    places.motor_axes,
    _parameters,
    _overlay,
    equation='k = ratio k_model',
    usual=True,
    title='force constant error',
)
