# SPDX-License-Identifier: Apache-2.0
"""The velocity feedforward (Ixx32) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_twin.effects.gains import difference_effect

EFFECT = difference_effect(
    'wrong_velocity_feedforward',
    'Ixx32',
    'velocity feedforward (Ixx32) is not that of the model',
    # The derivative gain is what fully makes up for the lag of a moving axis.
    lambda variant, axis: 0.2 * max(variant.i_variable(axis, 'Ixx31'), 100.0),
    title='velocity feedforward error',
)
