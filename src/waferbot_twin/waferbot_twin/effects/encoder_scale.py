# SPDX-License-Identifier: Apache-2.0
"""
The encoder shows more or fewer counts per unit than the model has: x_shown = (1 + error) x.

A tenth at most. Further off it is no error of an encoder but another encoder, or another unit in the
description; and with half the travel and half the force constant a machine does nearly the same, so that
such a scale stands in for whatever lacks. Of a length alone: the marks of a disc close after a turn, so
that its scale is exact, whatever is wrong between them (`encoder_eccentricity`).
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_twin.effects import sensors
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def _axes(variant: Variant) -> tuple[str, ...]:
    return tuple(
        axis
        for axis in sensors.measured_axes(variant)
        if not sensors.turns(variant, sensors.of_axis(variant, axis))
    )


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('error', '', 0.0, 2e-3, -0.1, 0.1, 'relative'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    encoder = sensors.of_axis(variant, axis)
    return sensors.overlay(encoder, {'scale_error': encoder.errors.scale + values['error']})


EFFECT = Effect(
    'encoder_scale',
    Block.SENSOR,
    'scale of the encoder is not that of the model',
    _axes,
    _parameters,
    _overlay,
    equation='x_shown = (1 + error) x',
    title='encoder scale error',
)
