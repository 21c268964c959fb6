# SPDX-License-Identifier: Apache-2.0
"""
Drag of a fluid that is cold at the start of the run and thins as it warms: ferrofluid, grease.

    F = d v exp(-t / tau)

beyond what the model has when warm. `drag` is its torque or force at the rated speed of the axis
(see `places.rated_speed`), at t = 0. Assumption: it warms by itself with one time constant,
however much the axis moves. Runs are taken to begin cold, each of them.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, several_trials
from waferbot_twin.effects.variant import Overlay, Variant

_COLD_OVER_WARM = 1e6
"""The mechanism multiplies a warm friction by 1 + this exp(-t / tau): what is left when warm is 1e-6."""

_FASTEST = 20.0
"""Speed up to which the drag is proportional, in rated speeds."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit = places.force_unit(variant, axis)
    return (
        Parameter('drag', unit, 0.0, 0.2 * rated, 0.0, 10.0 * rated, 'at rated speed, cold'),
        Parameter('time_constant', 's', 2.0, 2.0, 0.1, 3600.0, 'of warming', shape=True),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    highest = _FASTEST * places.rated_speed(variant, axis)
    warm = _FASTEST * values['drag'] / _COLD_OVER_WARM
    law = {'cold_amplitude': _COLD_OVER_WARM, 'cold_time_s': values['time_constant']}
    return Overlay(
        frictions.slot(
            variant,
            axis,
            'cold_ferrofluid',
            [0.0, highest],
            [0.0, warm],
            law if warm > 0.0 else {},
        )
    )


EFFECT = Effect(
    'cold_ferrofluid',
    Block.PLANT,
    'drag of a ferrofluid seal or grease that warms up',
    places.motor_axes,
    _parameters,
    _overlay,
    several_trials('time_constant', 0.5, 2.0, 10.0),
    equation='F = drag v / v_rated exp(-t / time_constant)',
    title='viscous drag that fades as it warms',
)
