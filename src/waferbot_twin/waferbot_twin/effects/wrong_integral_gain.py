# SPDX-License-Identifier: Apache-2.0
"""The integral gain (Ixx33) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects.gains import ratio_effect

EFFECT = ratio_effect(
    'wrong_integral_gain',
    'Ixx33',
    'integral gain (Ixx33) is not that of the model',
    lowest=0.0,
    typical=0.6,
    title='integral gain error',
)
