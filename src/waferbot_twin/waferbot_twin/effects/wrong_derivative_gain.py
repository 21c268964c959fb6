# SPDX-License-Identifier: Apache-2.0
"""The derivative gain (Ixx31) in the controller is not the one of the model."""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant

NAME = 'Ixx31'


def _axes(variant: Variant) -> tuple[str, ...]:
    return places.controlled_axes(variant, NAME)


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('ratio', '', 1.0, 0.95, 0.2, 3.0, f'real {NAME} over that of the model'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    return Overlay(pmac={axis: {NAME: round(variant.i_variable(axis, NAME) * values['ratio'])}})


EFFECT = Effect(
    'wrong_derivative_gain', Block.CONTROLLER, 'derivative gain (Ixx31) is not that of the model',
    _axes, _parameters, _overlay,
)  # fmt: skip
