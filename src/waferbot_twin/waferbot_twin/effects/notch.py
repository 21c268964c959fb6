# SPDX-License-Identifier: Apache-2.0
"""
The controller has a notch filter (Ixx36 to Ixx39) that the model does not have.

    H = 1 - depth + depth H_notch,    H_notch = (1 - 2 cos(w T) / z + 1 / z^2) / (1 + beta) / (...)

with H_notch zero at the frequency f, one far from it, and as wide as f between its -3 dB points.
At depth 0 it is not there, in between it is continuous. The controller's form of it begins with 1,
so what it lacks in gain is in Ixx30, rounded to whole numbers.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_copley.filters import notch
from waferbot_lockstep.timing import Timing
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, several_trials
from waferbot_twin.effects.variant import Overlay, Variant

NAMES = ('Ixx36', 'Ixx37', 'Ixx38', 'Ixx39')


def _axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose notch is not in use."""
    return tuple(
        axis
        for axis in places.controlled_axes(variant)
        if all(variant.i_variable(axis, name) == 0.0 for name in NAMES)
        and variant.i_variable(axis, 'Ixx30') != 0.0
    )


def _rate(variant: Variant, axis: str) -> float:
    """Return the rate of the servo, Hz."""
    return Timing().servo_hz / (1.0 + variant.i_variable(axis, 'Ixx60'))


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    highest = 0.24 * _rate(variant, axis)
    return (
        Parameter('depth', '', 0.0, 0.7, 0.0, 1.0, 'share of the signal that it takes away'),
        Parameter('frequency', 'Hz', 100.0, 100.0, 5.0, highest, 'of its middle', shape=True),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    depth = values['depth']
    if depth == 0.0:
        return Overlay()
    rate = _rate(variant, axis)
    b0, b1, b2, a1, a2 = notch(values['frequency'], values['frequency'], rate)
    rest = 1.0 - depth
    first, second, third = rest + depth * b0, depth * b1 - rest * a1, depth * b2 - rest * a2
    own = variant.i_variable(axis, 'Ixx30')
    settings = {
        'Ixx30': round(own * first),
        'Ixx36': second / first,
        'Ixx37': third / first,
        'Ixx38': -a1,
        'Ixx39': -a2,
    }
    return Overlay(pmac={axis: settings})


EFFECT = Effect(
    'notch',
    Block.CONTROLLER,
    'notch filter of the controller that the model does not have',
    _axes,
    _parameters,
    _overlay,
    several_trials('frequency', 50.0, 100.0, 200.0),
    equation='H = 1 - depth + depth H_notch(frequency)',
    title='notch filter of the controller',
)
