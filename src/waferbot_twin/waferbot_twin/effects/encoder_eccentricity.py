# SPDX-License-Identifier: Apache-2.0
"""
The encoder's disc is off its axis, or its scale is uneven: a periodic error along the way.

    x_shown = x + cosine cos(2 pi x / period) + sine sin(2 pi x / period)

An error that the model has already is added to; then its period is the first trial.
"""

from __future__ import annotations

from waferbot_twin.effects import sensors

EFFECT = sensors.eccentricity_effect(
    'encoder_eccentricity',
    'periodic error of the encoder: eccentric disc, uneven scale',
    sensors.measured_axes,
    sensors.of_axis,
    cycle='period',
)
