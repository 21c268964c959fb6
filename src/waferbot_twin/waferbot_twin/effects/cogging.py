# SPDX-License-Identifier: Apache-2.0
"""
Cogging: the magnets pull on teeth and ends of the iron, with or without current.

    F = sum over j = 1, 2, 3 of c_j cos(j n theta) + s_j sin(j n theta)

at the motor, theta the electrical angle, n the `order` of the fundamental. Where it comes from
says which: n = 2 (once per pole) from uneven teeth or the ends of a linear motor; n = 6 from three
teeth per pole; n = 1 from uneven magnets; teeth per pole pair where every tooth meets an odd
magnet. It takes out what it gives back: no loss, unlike friction. `torque_ripple` grows with the
current, this does not.

A real motor has several of these at once. `with_orders` gives the same effect with whatever orders a
log shows (`diagnosis.proposals.cogging_orders`), each with a cosine and a sine of its own.

Source: Z. Q. Zhu, D. Howe, Influence of design parameters on cogging torque in permanent magnet
machines, IEEE Trans. Energy Conversion 15 (2000).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

NAME = 'cogging'
SUMMARY = 'magnets pull on the iron: a force over the position, without current'
HARMONICS = (1, 2, 3)
SHARES = {'cosine_1': 0.03, 'sine_1': 0.02, 'cosine_2': -0.01, 'sine_2': 0.01}
"""Typical amplitudes, in rated forces of the motor."""

LEAST_SHARE = 0.005
"""Typical amplitude of everything else."""


def period(variant: Variant, axis: str) -> float:
    """Return what orders of `with_orders` count from: a turn (rad), or an electrical cycle (m)."""
    if places.motor_rotary(variant, axis):
        return 2.0 * math.pi
    return places.electrical_cycle(variant, axis)


def with_orders(orders: Mapping[str, Sequence[int]]) -> Effect:
    """
    Return the effect with certain orders on each axis, per turn of the motor.

    Of a linear motor per electrical cycle. Parameters are named after the order: `cosine_14`.
    """

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        return tuple(
            _amplitude(variant, axis, f'{wave}_{order}', f'{wave} of order {order}')
            for order in orders[axis]
            for wave in ('cosine', 'sine')
        )

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        lines = {
            order: (order, values[f'cosine_{order}'], values[f'sine_{order}'])
            for order in orders[axis]
        }
        return _periodic(variant, axis, period(variant, axis), lines)

    def axes(variant: Variant) -> tuple[str, ...]:
        return tuple(axis for axis in places.motor_axes(variant) if orders.get(axis))

    def longest(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
        return period(variant, axis) / min(orders[axis]) / places.motor_ratio(variant, axis)

    return Effect(
        NAME, Block.MOTOR, SUMMARY, axes, parameters, overlay,
        equation='F = sum over orders n of cosine_n cos(n phi) + sine_n sin(n phi)',
        repeats_after=longest,
    )  # fmt: skip


def _amplitude(variant: Variant, axis: str, name: str, meaning: str) -> Parameter:
    rated = places.rated_motor_force(variant, axis)
    typical = SHARES.get(name, LEAST_SHARE) * rated
    unit = places.motor_force_unit(variant, axis)
    return Parameter(name, unit, 0.0, typical, -3.0 * rated, 3.0 * rated, meaning)


def _periodic(
    variant: Variant, axis: str, length: float, lines: Mapping[int, tuple[float, float, float]]
) -> Overlay:
    """Return forces with an order in `length` (m, rad), a cosine and a sine (N, Nm), by name."""
    turns = places.motor_rotary(variant, axis)
    unit = 'nm' if turns else 'n'
    entries: dict[str, Any] = {
        f'{axis}_cogging_{name}': {
            'kind': 'periodic',
            'coordinate': places.motor_coordinate(variant, axis),
            'period_rad' if turns else 'period_m': length,
            'order': order,
            f'cosine_{unit}': cosine,
            f'sine_{unit}': sine,
        }
        for name, (order, cosine, sine) in lines.items()
    }
    return Overlay({'disturbances': entries})


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    amplitudes = [
        _amplitude(variant, axis, f'{wave}_{harmonic}', f'{wave} of harmonic {harmonic}')
        for harmonic in HARMONICS
        for wave in ('cosine', 'sine')
    ]
    order = Parameter(
        'order', '1/cycle', 2.0, 2.0, 0.01, 100.0, 'per electrical cycle', shape=True, fixed=True
    )
    return (*amplitudes, order)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    lines = {
        harmonic: (
            harmonic * values['order'],
            values[f'cosine_{harmonic}'],
            values[f'sine_{harmonic}'],
        )
        for harmonic in HARMONICS
    }
    return _periodic(variant, axis, places.electrical_cycle(variant, axis), lines)


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    """
    Return once per pole, six per cycle, once per cycle; of rotary motors also the teeth.

    None of a motor whose poles nobody described: then logs have to show an order (`with_orders`).
    """
    if not places.has_poles(variant, axis):
        return ()
    orders = [2.0, 6.0, 1.0]
    if places.motor_rotary(variant, axis):
        pole_pairs = abs(variant.description.motors[axis].electrical_gain)
        # Three phases and nearly one tooth per pole: the usual winding with one tooth per coil.
        teeth = 6.0 * max(1.0, round(2.0 * pole_pairs / 6.0))
        orders.append(teeth / pole_pairs)
    return tuple({'order': order} for order in dict.fromkeys(orders))


EFFECT = Effect(
    NAME, Block.MOTOR, SUMMARY, places.motor_axes, _parameters, _overlay, _trials,
    equation='F = sum of cosine_j cos(j order theta) + sine_j sin(j order theta), j = 1, 2, 3',
    repeats_after=places.period_of_order,
)  # fmt: skip
