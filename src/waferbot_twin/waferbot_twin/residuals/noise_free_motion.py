# SPDX-License-Identifier: Apache-2.0
"""What the command makes an axis do, seen in the noise-free log of the model (`closed_loop_record`)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_twin.effects.places import axis_counts, motor_axes, motor_ratio, position_encoder
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array, Record

SMOOTHING_S = 0.005
"""Over which signals are averaged, so that counts do not look like speed."""

STANDS_COUNTS_S = 200.0
"""Speed that is about none."""


@dataclass(frozen=True)
class Motion:
    """
    What the command makes an axis do, without any noise, at every reading of the encoders (n,).

    Position (counts from the first), speed and acceleration, currents of lines 1 and 2 (A), and the
    motor's electrical angle (rad).
    """

    rate_hz: float
    position: Array
    speed: Array
    acceleration: Array
    currents: tuple[Array, Array]
    angle: Array

    @property
    def clock_s(self) -> Array:
        """Times from the log's beginning."""
        return np.asarray(np.arange(len(self.position)) / self.rate_hz)

    @property
    def direction(self) -> Array:
        """The sign of the speed, about zero where the axis stands."""
        return np.tanh(self.speed / STANDS_COUNTS_S)

    @property
    def amplitude(self) -> Array:
        """Amplitude of the currents, A."""
        return amplitude(*self.currents)


def amplitude(first: Array, second: Array) -> Array:
    """Return that of two line currents, A: i^2 = 4/3 (i1^2 + i1 i2 + i2^2) of phases in balance."""
    return np.sqrt(np.maximum(first**2 + first * second + second**2, 0.0) * 4.0 / 3.0)


def _smooth(signal: Array, rate_hz: float) -> Array:
    # An even number of rows would be late by half of one.
    width = 2 * max(1, round(0.5 * SMOOTHING_S * rate_hz)) + 1
    kernel = np.hanning(width + 2)
    ends = np.pad(signal, width, mode='edge')
    return np.asarray(np.convolve(ends, kernel / kernel.sum(), mode='same')[width:-width])


def change(signal: Array, rate_hz: float) -> Array:
    """Return the derivative of a signal (n,) by time, smoothed."""
    return _smooth(np.gradient(signal) * rate_hz, rate_hz)


def motion(nominal: Variant, ideal: Record, axis: str) -> Motion:
    """Return what an axis does in a log without noise (`Problem.ideal`)."""
    timing = ideal.timing
    place, name = ideal.layout.place(axis), position_encoder(nominal, axis)
    rate_hz = timing.encoder_hz
    counts = _without_gaps(ideal.reading[:, ideal.layout.encoder_place(name)])
    position = _smooth(counts - counts[0], rate_hz)
    speed = change(position, rate_hz)
    gain = 0.0
    if axis in motor_axes(nominal):
        gain = nominal.description.motors[axis].electrical_gain * motor_ratio(nominal, axis)
        gain /= axis_counts(nominal, axis)
    angle = gain * (counts[0] + position)
    currents = ideal.line_current[:: timing.encoder_divider, 2 * place : 2 * place + 2]
    currents = currents[: len(position)]  # the last tick may be without a reading
    if ideal.current is not None and not np.isfinite(currents).any():
        driving = ideal.current[:: timing.encoder_divider, place][: len(position)]
        lines = [driving * np.sin(angle - 2.0 * np.pi * line / 3.0) for line in range(2)]
        currents = np.column_stack(lines)
    return Motion(
        rate_hz,
        position,
        speed,
        change(speed, rate_hz),
        (_smooth(currents[:, 0], rate_hz), _smooth(currents[:, 1], rate_hz)),
        angle,
    )


def _without_gaps(counts: Array) -> Array:
    """Return readings (n,) with the rows that an imported log leaves empty taken straight."""
    known = np.flatnonzero(np.isfinite(counts))
    return np.interp(np.arange(len(counts)), known, counts[known])


def motions(
    problem: Problem, noise_free: Sequence[Record], axes: Collection[str]
) -> dict[tuple[int, str], Motion]:
    """Return what axes do in the logs without noise, by the identity of the measured record and axis."""
    return {
        (id(measured), axis): motion(problem.nominal, record, axis)
        for measured, record in zip(problem.records, noise_free, strict=True)
        for axis in sorted(axes)
    }
