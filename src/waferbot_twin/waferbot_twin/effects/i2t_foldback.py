# SPDX-License-Identifier: Apache-2.0
"""
The amplifier limits its current to less than the model's continuous current, after a time.

Its integral of I^2 - I_c^2 may reach (I_p^2 - I_c^2) `time`, and from there on the current ends at
I_c, `continuous`; the peak current I_p is twice that, as of most drives. Nothing happens while the
axis needs less: at the model's value there is no effect, but neither is there just below it.
`with_folds` gives the effect on some axes, tried with a level and a time alone that a log shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter, Values, several_trials
from waferbot_twin.effects.variant import Overlay, Variant

NAME = 'i2t_foldback'
PEAK_OVER_CONTINUOUS = 2.0


def with_folds(folds: Mapping[str, Values]) -> Effect:
    """Return the effect on the axes of `folds` alone, each tried with these values."""

    def trials(variant: Variant, axis: str) -> tuple[Values, ...]:
        return (folds[axis],)

    return replace(EFFECT, axes=lambda variant: tuple(folds), trials=trials)


def _own(variant: Variant, axis: str) -> float:
    """Return the continuous current of the model, A."""
    drive = variant.amplifier_setting(axis, 'continuous_current')
    return variant.amplifier_setting(axis, 'user_continuous_current') or drive


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    own, tight = _own(variant, axis), places.tight_current(variant, axis)
    return (
        Parameter('continuous', 'A', own, min(tight, 0.9 * own), 0.01 * own, own, 'current left'),
        Parameter('time', 's', 0.005, 0.005, 1e-3, 10.0, 'at peak current', shape=True),
    )


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    if values['continuous'] == _own(variant.base, axis):
        return Overlay()
    peak = PEAK_OVER_CONTINUOUS * values['continuous']
    settings = {
        'user_peak_current': min(peak, places.peak_current(variant, axis)),
        'user_continuous_current': values['continuous'],
        'user_i2t_time': values['time'],
    }
    return Overlay(copley={axis: settings})


EFFECT = Effect(
    NAME,
    Block.AMPLIFIER,
    'the amplifier folds back to its continuous current',
    places.amplified_axes,
    _parameters,
    _overlay,
    several_trials('time', 0.005, 0.1),
    equation='|I| <= continuous once the integral of I^2 - continuous^2 is used up',
    threshold=True,
    title='I2T fold-back of the amplifier',
)
