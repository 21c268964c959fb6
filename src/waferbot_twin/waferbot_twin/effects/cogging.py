# SPDX-License-Identifier: Apache-2.0
"""
Cogging: the magnets pull on teeth and ends of the iron, with or without current.

    F = sum over j = 1, 2, 3 of c_j cos(j n theta) + s_j sin(j n theta)

at the motor, theta the electrical angle, n the `order` of the fundamental. Where it comes from
says which: n = 2 (once per pole) from uneven teeth or the ends of a linear motor; n = 6 from three
teeth per pole; n = 1 from uneven magnets; teeth per pole pair where every tooth meets an odd
magnet. It takes out what it gives back: no loss, unlike friction. `torque_ripple` grows with the
current, this does not.

Source: Z. Q. Zhu, D. Howe, Influence of design parameters on cogging torque in permanent magnet
machines, IEEE Trans. Energy Conversion 15 (2000).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

HARMONICS = (1, 2, 3)
SHARES = {'cosine_1': 0.03, 'sine_1': 0.02, 'cosine_2': -0.01, 'sine_2': 0.01, 'cosine_3': 0.0}
"""Typical amplitudes, in rated forces of the motor; zero if not here."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_motor_force(variant, axis)
    unit = places.motor_force_unit(variant, axis)
    amplitudes = [
        Parameter(
            f'{wave}_{harmonic}', unit, 0.0, SHARES.get(f'{wave}_{harmonic}', 0.005) * rated,
            -3.0 * rated, 3.0 * rated, f'{wave} of harmonic {harmonic}',
        )
        for harmonic in HARMONICS
        for wave in ('cosine', 'sine')
    ]  # fmt: skip
    order = Parameter(
        'order', '1/cycle', 2.0, 2.0, 0.01, 100.0, 'per electrical cycle', shape=True
    )
    return (*amplitudes, order)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    turns = places.motor_rotary(variant, axis)
    cycle = 2.0 * math.pi / abs(variant.description.motors[axis].electrical_gain)
    unit = 'nm' if turns else 'n'
    return Overlay(
        {
            'disturbances': {
                f'{axis}_cogging_{harmonic}': {
                    'kind': 'periodic',
                    'coordinate': places.motor_coordinate(variant, axis),
                    'period_rad' if turns else 'period_m': cycle,
                    'order': harmonic * values['order'],
                    f'cosine_{unit}': values[f'cosine_{harmonic}'],
                    f'sine_{unit}': values[f'sine_{harmonic}'],
                }
                for harmonic in HARMONICS
            }
        }
    )


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    """Return once per pole, six per cycle, once per cycle; of rotary motors also the teeth."""
    orders = [2.0, 6.0, 1.0]
    if places.motor_rotary(variant, axis):
        pole_pairs = abs(variant.description.motors[axis].electrical_gain)
        # Three phases and nearly one tooth per pole: the usual winding with one tooth per coil.
        teeth = 6.0 * max(1.0, round(2.0 * pole_pairs / 6.0))
        orders.append(teeth / pole_pairs)
    return tuple({'order': order} for order in dict.fromkeys(orders))


EFFECT = Effect(
    'cogging',
    Block.MOTOR,
    'magnets pull on the iron: a force over the position, without current',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation='F = sum of cosine_j cos(j order theta) + sine_j sin(j order theta), j = 1, 2, 3',
)
