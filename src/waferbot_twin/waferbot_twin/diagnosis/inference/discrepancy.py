# SPDX-License-Identifier: Apache-2.0
"""
Model discrepancy: forces that nothing in the library explains, over speed or position of an axis.

A real machine lacks something that no library has (M. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63,
2001; without a term for it intervals are wrong however many data there are: J. Brynjarsdottir, A.
O'Hagan, Inverse Problems 30, 2014). Here it is a piecewise linear function with a few points, each
with the prior of a force; one candidate among the others, so that it has to explain the logs
better than every physical cause, with all its parameters paid for. It is never given a physical
name: what it describes is reported as unexplained, and while it is in the model what correlates
with it gets wider intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from waferbot_twin.diagnosis.inference.nuisance import is_nuisance
from waferbot_twin.effects import places
from waferbot_twin.effects.effect import Block, Effect, Parameter
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.residuals.record import Record

POINTS = 7

NAMES = {'velocity': 'force_over_velocity', 'position': 'force_over_position'}
WORDS = {'velocity': 'its speed', 'position': 'its position'}

SMOOTHED_S = 0.01
"""Time over which readings are averaged before their speed is taken, s."""

STANDS_COUNTS = 50.0
"""An axis that moves less than this in all logs is taken to stand."""


def tables(variant: Variant, records: Sequence[Record]) -> list[Effect]:
    """Return a table over speed and one over position, with points where the logs' axes were."""
    speeds: dict[str, tuple[float, ...]] = {}
    positions: dict[str, tuple[float, ...]] = {}
    for axis in places.motor_axes(variant):
        encoder = places.position_encoder(variant, axis)
        if encoder not in variant.description.encoders:
            continue
        column = variant.layout.encoder_place(encoder)
        per_unit = places.axis_counts(variant, axis)
        readings = [record.reading[:, column] for record in records]
        known = np.concatenate([reading[np.isfinite(reading)] for reading in readings])
        if len(known) == 0 or np.ptp(known) < STANDS_COUNTS:
            continue
        positions[axis] = _points(known / per_unit)
        rates = [
            np.gradient(_smooth(record.reading[:, column], record.timing.encoder_hz))
            * record.timing.encoder_hz
            for record in records
        ]
        fastest = max(float(np.nanmax(np.abs(rate))) for rate in rates) / abs(per_unit)
        speeds[axis] = tuple(float(x) for x in fastest * np.linspace(-1.0, 1.0, POINTS))
    return [_table('velocity', speeds), _table('position', positions)]


def is_discrepancy(cause: Cause) -> bool:
    """Return whether a cause has no physical name."""
    return cause.effect.name in NAMES.values()


def is_physical(cause: Cause) -> bool:
    """Return whether a cause has a physical name of its own: no discrepancy, no dense effect."""
    return not is_discrepancy(cause) and not is_nuisance(cause)


def goes_with(cause: Cause) -> str:
    """Return what a discrepancy is a function of, in words."""
    return next(WORDS[over] for over, name in NAMES.items() if name == cause.effect.name)


def _smooth(reading: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return readings averaged over `SMOOTHED_S`, so that counts do not look like speed."""
    reach = max(1, round(0.5 * SMOOTHED_S * rate_hz))
    kernel = np.hanning(2 * reach + 3)
    filled = np.interp(
        np.arange(len(reading)),
        np.flatnonzero(np.isfinite(reading)),
        reading[np.isfinite(reading)],
    )
    return np.convolve(filled, kernel / kernel.sum(), mode='same')[len(kernel) : -len(kernel)]


def _points(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(x) for x in np.linspace(values.min(), values.max(), POINTS))


def _table(over: str, points: Mapping[str, tuple[float, ...]]) -> Effect:
    def axes(variant: Variant) -> tuple[str, ...]:
        return tuple(axis for axis in places.motor_axes(variant) if axis in points)

    def parameters(variant: Variant, axis: str) -> tuple[Parameter, ...]:
        rated = places.rated_force(variant, axis)
        unit = 'Nm' if places.rotary(variant, axis) else 'N'
        return tuple(
            Parameter(
                f'force_{number}', unit, 0.0, 0.05 * rated, -10.0 * rated, 10.0 * rated,
                f'at {point:.4g}',
            )
            for number, point in enumerate(points[axis])
        )  # fmt: skip

    def overlay(variant: Variant, axis: str, values: Mapping[str, float]) -> Overlay:
        unit = 'rad' if places.rotary(variant, axis) else 'm'
        entry = {
            'kind': 'table',
            'over': over,
            f'at_{unit}_s' if over == 'velocity' else f'at_{unit}': list(points[axis]),
            places.force_key(variant, axis): [values[name] for name in sorted(values)],
        }
        return Overlay(places.disturbance(variant, axis, f'force_over_{over}', entry))

    return Effect(
        NAMES[over], Block.PLANT, f'a force over {over} without a known cause',
        axes, parameters, overlay,
    )  # fmt: skip
