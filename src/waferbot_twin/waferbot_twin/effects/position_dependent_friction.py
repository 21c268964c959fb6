# SPDX-License-Identifier: Apache-2.0
"""
Dry friction that changes along the way: a bent rail, rail screws, an eccentric seal.

    F = max(0, mean + cosine cos(2 pi x / period) + sine sin(2 pi x / period)) sign(v)
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

_LEAST_SHARE = 1e-9
"""What stands for a mean of zero, in amplitudes: the mechanism multiplies the mean by the wave."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit, length = places.force_unit(variant, axis), places.length_unit(variant, axis)
    period = _periods(variant, axis)[0]
    most = 5.0 * rated
    return (
        Parameter('mean', unit, 0.0, 0.08 * rated, 0.0, most, 'mean friction'),
        Parameter('cosine', unit, 0.0, 0.06 * rated, -most, most, 'amplitude of the cosine'),
        Parameter('sine', unit, 0.0, 0.04 * rated, -most, most, 'amplitude of the sine'),
        Parameter(
            'period', length, period, period, 0.02 * period, 10.0 * period,
            'of a turn, or of what is along a guide', shape=True, fixed=True,
        ),
    )  # fmt: skip


def _periods(variant: Variant, axis: str) -> tuple[float, ...]:
    """Return a turn and half of it; the distance of a rail's screws, and 0.2 m for a bent one."""
    if places.rotary(variant, axis):
        return 2.0 * math.pi, math.pi
    return 0.06, 0.2


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    amplitude = math.hypot(values['cosine'], values['sine'])
    mean = max(values['mean'], _LEAST_SHARE * amplitude)
    law = {}
    if mean > 0.0:
        period = 'period_rad' if places.rotary(variant, axis) else 'period_m'
        law = {
            'position_amplitude': amplitude / mean,
            'position_phase_rad': math.atan2(values['sine'], values['cosine']),
            period: values['period'],
        }
    return Overlay(
        frictions.slot(variant, axis, 'position_dependent_friction', [0.0], [mean], law)
    )


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    return tuple({'period': period} for period in _periods(variant, axis))


EFFECT = Effect(
    'position_dependent_friction',
    Block.PLANT,
    'dry friction that changes periodically along the way',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation='F = max(0, mean + cosine cos kx + sine sin kx) sign(v), k = 2 pi / period',
)
