# SPDX-License-Identifier: Apache-2.0
"""The derivative gain (Ixx31) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects.gains import ratio_effect

EFFECT = ratio_effect(
    'wrong_derivative_gain',
    'Ixx31',
    'derivative gain (Ixx31) is not that of the model',
    title='derivative gain error',
)
