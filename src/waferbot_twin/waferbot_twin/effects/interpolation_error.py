# SPDX-License-Identifier: Apache-2.0
"""
The interpolation between the lines of the encoder is off: an error of one period per line.

    n_shown = n + cosine cos(2 pi n / period) + sine sin(2 pi n / period)

in counts, `period` counts of one signal period. From offsets of the sine and cosine signals;
unequal amplitudes make it two per line (a trial).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from waferbot_twin.effects import places, sensors
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    period = _periods(variant, axis)[0]
    most = 0.2 * period
    return (
        Parameter('cosine', 'counts', 0.0, 0.02 * period, -most, most, 'amplitude of the cosine'),
        Parameter('sine', 'counts', 0.0, 0.015 * period, -most, most, 'amplitude of the sine'),
        Parameter(
            'period',
            'counts',
            period,
            period,
            2.0,
            100.0 * period,
            'of one line',
            shape=True,
            fixed=True,
        ),
    )


def _periods(variant: Variant, axis: str) -> tuple[float, ...]:
    """Return counts per line of 20 um, or of 2048 lines a turn, and half; the model's own first."""
    encoder = sensors.of_axis(variant, axis)
    line = 2.0 * math.pi / 2048.0 if sensors.turns(variant, encoder) else 2e-5
    counts = max(4.0, abs(line * encoder.counts_per_unit))
    own = encoder.errors.interpolation
    return (own.period, counts) if own.amplitude else (counts, 0.5 * counts)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['cosine'] == 0.0 and values['sine'] == 0.0:
        return Overlay()
    encoder = sensors.of_axis(variant, axis)
    amplitude, phase = sensors.added(
        encoder.errors.interpolation, values['cosine'], values['sine']
    )
    entry = {
        'amplitude_counts': amplitude,
        'period_counts': values['period'],
        'phase_rad': phase,
    }
    return sensors.overlay(encoder, {'interpolation': entry})


def _trials(variant: Variant, axis: str) -> tuple[Values, ...]:
    return tuple({'period': period} for period in _periods(variant, axis))


def _repeats_after(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
    return values['period'] / abs(places.axis_counts(variant, axis))


EFFECT = Effect(
    'interpolation_error',
    Block.SENSOR,
    'cyclic error between the lines of the encoder',
    sensors.measured_axes,
    _parameters,
    _overlay,
    _trials,
    repeats_after=_repeats_after,
    cycle='period',
    equation='n_shown = n + cosine cos kn + sine sin kn, k = 2 pi / period',
    title='encoder interpolation error',
)
