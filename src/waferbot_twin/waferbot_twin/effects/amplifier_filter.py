# SPDX-License-Identifier: Apache-2.0
"""
The amplifier filters its command by a first-order low-pass that the model does not have.

    y(n) = y(n-1) + (x(n) - y(n-1)) T / (T + tau)

at the rate 1/T of the current loop, as a custom filter (backward differences): a small tau acts in
proportion to its size.
"""

from __future__ import annotations

from collections.abc import Mapping

from waferbot_copley.filters import CUSTOM, DISABLED
from waferbot_copley.settings import FILTER_COEFFICIENTS, FILTERS
from waferbot_lockstep.timing import Timing
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant


def free_filter(variant: Variant, axis: str) -> int | None:
    """Return the number of a command filter that the model leaves off, None if it uses both."""
    for number in FILTERS:
        if variant.amplifier_setting(axis, f'filter_{number}_kind') == DISABLED:
            return number
    return None


def filtered_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose amplifier has a command filter left."""
    return tuple(axis for axis in places.amplified_axes(variant) if free_filter(variant, axis))


def custom_filter(number: int, coefficients: tuple[float, ...]) -> dict[str, float]:
    """Return the settings of a custom filter with b0, b1, b2, a1, a2."""
    names = (f'filter_{number}_{name}' for name in FILTER_COEFFICIENTS)
    return {f'filter_{number}_kind': CUSTOM, **dict(zip(names, coefficients, strict=True))}


def _parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
    return (Parameter('time_constant', 's', 0.0, 5e-4, 0.0, 0.02, 'of the low-pass'),)


def _overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
    number = free_filter(variant, axis)
    if values['time_constant'] == 0.0 or number is None:
        return Overlay()
    kept = values['time_constant'] / (Timing().tick_s + values['time_constant'])
    return Overlay(copley={axis: custom_filter(number, (1.0 - kept, 0.0, 0.0, kept, 0.0))})


EFFECT = Effect(
    'amplifier_filter',
    Block.AMPLIFIER,
    'low-pass filter of the command in the amplifier',
    filtered_axes,
    _parameters,
    _overlay,
    equation='y / x = 1 / (1 + time_constant s)',
    title='low-pass filter of the amplifier',
)
