# SPDX-License-Identifier: Apache-2.0
"""
Dry friction that changes along the way: a bent rail, rail screws, an eccentric seal.

    F = mean (1 + cosine cos(2 pi x / period) + sine sin(2 pi x / period)) sign(v)

`cosine` and `sine` are shares of the mean, together less than all of it: friction never pushes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

from waferbot_twin.effects import frictions, places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

LARGEST = 0.7
"""Largest share of the mean of each of two waves, whose sum is never more than all of it."""


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    rated = places.rated_force(variant, axis)
    unit, length = places.force_unit(variant, axis), places.length_unit(variant, axis)
    period = _periods(variant, axis)[0]
    most = 5.0 * rated
    return (
        Parameter('mean', unit, 0.0, 0.08 * rated, 0.0, most, 'mean friction'),
        Parameter(
            'cosine', '', 0.5, 0.5, -LARGEST, LARGEST, 'cosine, as a share of it', shape=True
        ),
        Parameter('sine', '', 0.0, 0.0, -LARGEST, LARGEST, 'sine, as a share of it', shape=True),
        Parameter(
            'period', length, period, period, 0.02 * period, 10.0 * period,
            'of a turn, or of what is along a guide', shape=True, fixed=True,
            guessed=not places.rotary(variant, axis),
        ),
    )  # fmt: skip


def _periods(variant: Variant, axis: str) -> tuple[float, ...]:
    """Return a turn and half of it; the distance of a rail's screws, and 0.2 m for a bent one."""
    if places.rotary(variant, axis):
        return 2.0 * math.pi, math.pi
    return 0.06, 0.2


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    period = 'period_rad' if places.rotary(variant, axis) else 'period_m'
    law = {
        'position_amplitude': math.hypot(values['cosine'], values['sine']),
        'position_phase_rad': math.atan2(values['sine'], values['cosine']),
        period: values['period'],
    }
    resistances = [values['mean']]
    return Overlay(
        frictions.slot(variant, axis, 'position_dependent_friction', [0.0], resistances, law)
    )


def _repeats_after(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
    return values['period']


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    """Return both periods, each with the highest friction at a beginning, a quarter, a half ..."""
    quarters = ((0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5))
    return tuple(
        {'cosine': cosine, 'sine': sine, 'period': period}
        for period, (cosine, sine) in itertools.product(_periods(variant, axis), quarters)
    )


EFFECT = Effect(
    'position_dependent_friction',
    Block.PLANT,
    'dry friction that changes periodically along the way',
    places.motor_axes,
    _parameters,
    _overlay,
    _trials,
    equation='F = mean (1 + cosine cos kx + sine sin kx) sign(v), k = 2 pi / period',
    repeats_after=_repeats_after,
    tried_at=frictions.STICKS,
    title='Coulomb friction that changes along the way',
)
