# SPDX-License-Identifier: Apache-2.0
"""The acceleration feedforward (Ixx35) in the controller is not the one of the model."""

from __future__ import annotations

from waferbot_lockstep.timing import Timing
from waferbot_twin.effects import places
from waferbot_twin.effects.gains import difference_effect
from waferbot_twin.effects.variant import Variant


def _typical(variant: Variant, axis: str) -> float:
    """
    Return a fifth of the value that makes the whole force of acceleration.

    Ixx30 Ixx08 Ixx35 / 2^26 DAC bits per count/cycle^2 shall be M a / K amperes, with a cycle of T s and
    c counts per unit: Ixx35 = 2^26 M / (K Ka Ixx30 Ixx08 c T^2), Ka in A per DAC bit.
    """
    per_bit = variant.i_variable(axis, 'amplifier_peak_current') / places.DAC_BITS
    force = places.force_per_ampere(variant, axis) * per_bit
    gain = variant.i_variable(axis, 'Ixx30') * variant.i_variable(axis, 'Ixx08')
    cycle = (1.0 + variant.i_variable(axis, 'Ixx60')) / Timing().servo_hz
    counts = variant.i_variable(axis, 'counts_per_unit')
    full = 2.0**26 * places.moving_inertia(variant, axis) / (force * gain * counts * cycle**2)
    return max(0.2 * full, 10.0)


EFFECT = difference_effect(
    'wrong_acceleration_feedforward',
    'Ixx35',
    'acceleration feedforward (Ixx35) is not that of the model',
    _typical,
    title='acceleration feedforward error',
)
