# SPDX-License-Identifier: Apache-2.0
"""Readings of an axis' encoder are older than in the model: n_shown(t) = n(t - delay)."""

from __future__ import annotations

from waferbot_twin.effects import sensors

EFFECT = sensors.delay_effect(
    'encoder_delay',
    'readings of the encoder arrive late',
    sensors.measured_axes,
    sensors.of_axis,
)
