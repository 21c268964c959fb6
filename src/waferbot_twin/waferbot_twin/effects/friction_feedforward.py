# SPDX-License-Identifier: Apache-2.0
"""The friction feedforward (Ixx68) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects import places
from waferbot_twin.effects.gains import difference_effect

EFFECT = difference_effect(
    'friction_feedforward',
    'Ixx68',
    'friction feedforward (Ixx68) is not that of the model',
    lambda variant, axis: 0.01 * places.DAC_BITS,
    0,
    32767,
    title='friction feedforward error',
)
