# SPDX-License-Identifier: Apache-2.0
"""Readings of the motor's own encoder are older than in the model: a skew against the load's."""

from __future__ import annotations

from waferbot_twin.effects import sensors

EFFECT = sensors.delay_effect(
    'motor_encoder_delay',
    "readings of the motor's own encoder arrive late: a skew between encoders",
    sensors.motor_measured_axes,
    sensors.of_motor,
)
