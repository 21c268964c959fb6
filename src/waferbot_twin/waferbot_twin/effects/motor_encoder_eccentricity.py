# SPDX-License-Identifier: Apache-2.0
"""
The disc of the motor's own encoder is off its axis: a periodic error once per turn of the motor.

    x_shown = x + cosine cos(2 pi x / period) + sine sin(2 pi x / period)

For axes that have an encoder at the load and another at the motor.
"""

from __future__ import annotations

from waferbot_twin.effects import sensors

EFFECT = sensors.eccentricity_effect(
    'motor_encoder_eccentricity',
    "periodic error of the motor's own encoder",
    sensors.motor_measured_axes,
    sensors.of_motor,
)
