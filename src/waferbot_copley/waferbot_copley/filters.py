# SPDX-License-Identifier: Apache-2.0
"""
The two configurable filters on the current command.

Each is one second-order section, written with the signs of the drive's manual (plus on the a's):

    y(n) = b0 x(n) + b1 x(n-1) + b2 x(n-2) + a1 y(n-1) + a2 y(n-2)

Low-pass and high-pass are Butterworth with one or two poles; notch and band-pass are given by
centre and width. All are designed from the analogue filter by the bilinear transform with the
named frequencies prewarped, s -> (1 / K) (z - 1) / (z + 1) with K = tan(pi f / f_sample), so the
response is exact at those frequencies. A custom section takes its five coefficients as the drive
stores them.

The drive also designs Chebyshev and elliptic sections; give those as custom coefficients.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled

CUSTOM, LOW_PASS, HIGH_PASS, NOTCH, BAND_PASS, DISABLED = 0, 1, 2, 3, 4, 7
"""Kinds of filter, numbered as in the drive."""

Coefficients = tuple[float, float, float, float, float]
"""b0, b1, b2, a1, a2."""

PASS_THROUGH: Coefficients = (1.0, 0.0, 0.0, 0.0, 0.0)


def low_pass(cutoff_hz: float, sample_hz: float, poles: int) -> Coefficients:
    """Return a Butterworth low-pass of one or two poles: gain 1 at rest, -3 dB at the cutoff."""
    k = math.tan(math.pi * cutoff_hz / sample_hz)
    if poles == 1:
        b0 = k / (1.0 + k)
        return b0, b0, 0.0, (1.0 - k) / (1.0 + k), 0.0
    a0 = 1.0 + math.sqrt(2.0) * k + k * k
    b0 = k * k / a0
    return b0, 2.0 * b0, b0, *_two_butterworth_poles(k, a0)


def high_pass(cutoff_hz: float, sample_hz: float, poles: int) -> Coefficients:
    """Return a Butterworth high-pass of one or two poles: gain 0 at rest, -3 dB at the cutoff."""
    k = math.tan(math.pi * cutoff_hz / sample_hz)
    if poles == 1:
        b0 = 1.0 / (1.0 + k)
        return b0, -b0, 0.0, (1.0 - k) / (1.0 + k), 0.0
    a0 = 1.0 + math.sqrt(2.0) * k + k * k
    b0 = 1.0 / a0
    return b0, -2.0 * b0, b0, *_two_butterworth_poles(k, a0)


def _two_butterworth_poles(k: float, a0: float) -> tuple[float, float]:
    return 2.0 * (1.0 - k * k) / a0, -(1.0 - math.sqrt(2.0) * k + k * k) / a0


def notch(centre_hz: float, width_hz: float, sample_hz: float) -> Coefficients:
    """Return a notch: gain 0 at the centre, 1 far from it, `width_hz` between its -3 dB points."""
    beta = math.tan(math.pi * width_hz / sample_hz)
    b0 = 1.0 / (1.0 + beta)
    a1 = 2.0 * math.cos(2.0 * math.pi * centre_hz / sample_hz) / (1.0 + beta)
    return b0, -a1, b0, a1, -(1.0 - beta) / (1.0 + beta)


def band_pass(centre_hz: float, width_hz: float, sample_hz: float) -> Coefficients:
    """Return a band-pass: gain 1 at the centre, `width_hz` between its -3 dB points."""
    beta = math.tan(math.pi * width_hz / sample_hz)
    b0 = beta / (1.0 + beta)
    a1 = 2.0 * math.cos(2.0 * math.pi * centre_hz / sample_hz) / (1.0 + beta)
    return b0, 0.0, -b0, a1, -(1.0 - beta) / (1.0 + beta)


def is_stable(coefficients: Coefficients) -> bool:
    """Tell whether both poles, the roots of z^2 - a1 z - a2, lie inside the unit circle (Jury)."""
    a1, a2 = coefficients[3:]
    return abs(a2) < 1.0 and abs(a1) < 1.0 - a2


@compiled
def filter_sample(coefficients, memory, x):
    """
    Put one sample through one section (transposed direct form II); return its output.

    `coefficients` (5,) are b0, b1, b2, a1, a2; `memory` (2,) is read and updated, zero at rest.
    """
    y = coefficients[0] * x + memory[0]
    memory[0] = coefficients[1] * x + coefficients[3] * y + memory[1]
    memory[1] = coefficients[2] * x + coefficients[4] * y
    return y
