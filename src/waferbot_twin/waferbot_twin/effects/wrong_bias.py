# SPDX-License-Identifier: Apache-2.0
"""The bias (Ixx29) that the controller adds to its output is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects import places
from waferbot_twin.effects.gains import difference_effect

EFFECT = difference_effect(
    'wrong_bias',
    'Ixx29',
    'bias of the output (Ixx29) is not that of the model',
    lambda variant, axis: 0.01 * places.DAC_BITS,
    -32768,
    32767,
    title='output bias error',
)
