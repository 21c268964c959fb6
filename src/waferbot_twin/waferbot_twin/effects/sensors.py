# SPDX-License-Identifier: Apache-2.0
"""Which encoder measures an axis, and how effects change it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from waferbot_lockstep.timing import Timing
from waferbot_plant.description import LONGEST_DELAY, LONGEST_DELAY_S, CyclicError, Encoder
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values
from waferbot_twin.effects.variant import Overlay, Variant

EncoderOf = Callable[[Variant, str], Encoder]
"""Which encoder of an axis."""

_TYPICAL_MS = 4e3 / Timing().encoder_hz
"""Four phase cycles."""


def _on(variant: Variant, name: str) -> Encoder | None:
    """Return the encoder on a coordinate."""
    encoders = variant.description.encoders.values()
    return next((encoder for encoder in encoders if encoder.coordinate == name), None)


def of_axis(variant: Variant, axis: str) -> Encoder:
    """Return the encoder of an axis itself."""
    encoder = _on(variant, places.coordinate(variant, axis))
    assert encoder is not None
    return encoder


def of_motor(variant: Variant, axis: str) -> Encoder:
    """Return the encoder of an axis' motor."""
    encoder = _on(variant, places.motor_coordinate(variant, axis))
    assert encoder is not None
    return encoder


def measured_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes that have an encoder of their own."""
    return tuple(
        axis
        for axis in places.motor_axes(variant)
        if _on(variant, places.coordinate(variant, axis)) is not None
    )


def motor_measured_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose motor has an encoder beside that of the axis."""
    return tuple(
        axis
        for axis in places.geared_axes(variant)
        if _on(variant, places.motor_coordinate(variant, axis)) is not None
    )


def turns(variant: Variant, encoder: Encoder) -> bool:
    """Return whether an encoder measures an angle."""
    return bool(variant.description.revolute[encoder.coordinate])


def unit(variant: Variant, encoder: Encoder) -> str:
    """Return the unit of what an encoder measures."""
    return 'rad' if turns(variant, encoder) else 'm'


def overlay(encoder: Encoder, values: dict[str, Any]) -> Overlay:
    """Return the overlay that gives an encoder other errors."""
    return Overlay({'encoders': {encoder.place: values}})


def added(own: CyclicError, cosine: float, sine: float) -> tuple[float, float]:
    """Return amplitude and phase of a periodic error with another of the same period added."""
    cosine += own.amplitude * math.cos(own.phase)
    sine += own.amplitude * math.sin(own.phase)
    return math.hypot(cosine, sine), math.atan2(sine, cosine)


def longest_delay(variant: Variant, encoder: Encoder) -> float:
    """
    Return how much later the readings can become, s.

    Where controllers or amplifiers are known, readings come by a fast ring: what its counters hold, in
    phase cycles. Of a machine alone, whatever lies between an encoder and a log.
    """
    errors = encoder.errors
    if variant.is_machine_alone:
        return LONGEST_DELAY_S - errors.delay
    cycles = (
        LONGEST_DELAY
        - variant.description.encoder_delay
        - errors.extra_delay
        - errors.delay_fraction
    )
    return cycles / Timing().encoder_hz - errors.delay


def eccentricity_effect(
    name: str,
    summary: str,
    axes: Callable[[Variant], tuple[str, ...]],
    encoder_of: EncoderOf,
    cycle: str = '',
) -> Effect:
    """Return the effect of a periodic error of an encoder along the way; `cycle` as in `Effect`."""

    def repeats_after(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
        at_motor = encoder_of(variant, axis).coordinate == places.motor_coordinate(variant, axis)
        ratio = places.motor_ratio(variant, axis) if at_motor else 1.0
        return values['period'] / ratio

    def known(variant: Variant, encoder: Encoder) -> bool:
        return turns(variant, encoder) or bool(encoder.errors.eccentricity.amplitude)

    def periods(variant: Variant, axis: str) -> tuple[float, ...]:
        """Return a turn and half of it; of a scale, 0.1 m and 20 mm; the model's before others."""
        encoder = encoder_of(variant, axis)
        usual = (2.0 * math.pi, math.pi) if turns(variant, encoder) else (0.1, 0.02)
        own = encoder.errors.eccentricity
        return (own.period, *usual) if own.amplitude else usual

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        encoder = encoder_of(variant, axis)
        length = unit(variant, encoder)
        period = periods(variant, axis)[0]
        typical = 30.0 / abs(encoder.counts_per_unit)
        most = max(0.02 * period, 10.0 * typical)
        low, high = 0.01 * period, 10.0 * period
        return (
            Parameter('cosine', length, 0.0, typical, -most, most, 'amplitude of the cosine'),
            Parameter('sine', length, 0.0, 0.6 * typical, -most, most, 'amplitude of the sine'),
            Parameter(
                'period', length, period, period, low, high, 'of the error', shape=True,
                fixed=True, guessed=not known(variant, encoder),
            ),
        )  # fmt: skip

    def changes(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        if values['cosine'] == 0.0 and values['sine'] == 0.0:
            return Overlay()
        encoder = encoder_of(variant, axis)
        length = unit(variant, encoder)
        own = encoder.errors.eccentricity
        amplitude, phase = added(own, values['cosine'], values['sine'])
        entry = {
            f'amplitude_{length}': amplitude,
            f'period_{length}': values['period'],
            'phase_rad': phase,
        }
        return overlay(encoder, {'eccentricity': entry})

    def trials(variant: Variant, axis: str) -> tuple[Values, ...]:
        return tuple({'period': period} for period in periods(variant, axis))

    return Effect(
        name,
        Block.SENSOR,
        summary,
        axes,
        parameters,
        changes,
        trials,
        equation='x_shown = x + cosine cos kx + sine sin kx, k = 2 pi / period',
        repeats_after=repeats_after,
        cycle=cycle,
    )


def delay_effect(
    name: str, summary: str, axes: Callable[[Variant], tuple[str, ...]], encoder_of: EncoderOf
) -> Effect:
    """
    Return the effect of readings of an encoder that are older than in the model, by a time.

    Continuous: whole phase cycles, and a straight line between two readings for what is left of one.
    Of a log that was brought in, only how much later the position is than the drive shows: a drive that
    acts late is the same.
    """

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        most = 1e3 * longest_delay(variant, encoder_of(variant, axis))
        typical = min(_TYPICAL_MS, most)
        return (Parameter('delay', 'ms', 0.0, typical, 0.0, most, 'more than in the model'),)

    def changes(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        encoder = encoder_of(variant, axis)
        total = encoder.errors.delay + 1e-3 * values['delay']
        return overlay(encoder, {'delay_s': min(total, LONGEST_DELAY_S)})

    return Effect(
        name,
        Block.SENSOR,
        summary,
        axes,
        parameters,
        changes,
        equation='n_shown(t) = n(t - delay)',
        usual=True,
    )
