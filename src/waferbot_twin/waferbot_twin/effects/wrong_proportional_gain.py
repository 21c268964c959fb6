# SPDX-License-Identifier: Apache-2.0
"""The proportional gain (Ixx30) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects.gains import ratio_effect

EFFECT = ratio_effect(
    'wrong_proportional_gain',
    'Ixx30',
    'proportional gain (Ixx30) is not that of the model',
    title='proportional gain error',
)
