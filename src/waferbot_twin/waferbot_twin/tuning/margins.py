# SPDX-License-Identifier: Apache-2.0
"""
Margins of a loop from its frequency response.

With L the open loop (the closed one is L / (1 + L)), at the angular frequencies w (rad/s):

    gain margin     1 / |L| where L is real and negative, in dB
    phase margin    180 degrees + the angle of L where |L| = 1
    delay margin    phase margin (rad) / w there: the dead time that takes the loop to its limit
    sensitivity     the largest |1 / (1 + L)|; its inverse is the distance of L from -1

Where there are several crossings, the gain margin is the one nearest to 0 dB, of either sign (a loop
with an integrator or with resonances has a lowest gain, too), the phase margin the smallest in
magnitude, the delay margin the smallest positive one. Margins say how far a loop is from its limit,
not on which side: that is for the eigenvalues to say.

Source: K. J. Astrom, R. M. Murray, Feedback Systems, Princeton 2021, section 10.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Response = Callable[[Array], ComplexArray]
"""A function that gives L (n,) at frequencies (n,), Hz."""


@dataclass(frozen=True)
class Margins:
    """
    Gain margin in dB at `gain_hz`, phase margin in degrees at `phase_hz`, delay margin in s.

    Infinite, with a NaN frequency, where there is no crossing. `crossover_hz` is the highest frequency
    with |L| = 1, `sensitivity` the largest |1 / (1 + L)|, at `sensitivity_hz`.
    """

    gain_db: float
    gain_hz: float
    phase_deg: float
    phase_hz: float
    delay_s: float
    crossover_hz: float
    sensitivity: float
    sensitivity_hz: float


def margins(
    frequency_hz: Array,
    loop: ComplexArray,
    response: Response | None = None,
    nyquist_hz: float = math.inf,
    at_nyquist: float = 0.0,
) -> Margins:
    """
    Return the margins of L (n,) at rising frequencies (n,), Hz.

    A sampled loop is real at half of its rate, `nyquist_hz`: `at_nyquist` there counts for the gain
    margin where it is negative.

    The grid must be fine enough to show every crossing. With `response` they are found to rounding,
    else by interpolation between two points (of log |L| and of the angle).
    """
    magnitude = np.log(np.abs(loop))
    crossings_hz, at_crossing = _crossings(frequency_hz, loop, magnitude, response, _log_magnitude)
    angles = np.angle(at_crossing * np.exp(-1j * math.pi), deg=True)  # 180 + angle, -180 to 180
    phase = _nearest_to_zero(angles)
    ahead = np.mod(np.radians(angles), 2.0 * math.pi) / (2.0 * math.pi * crossings_hz)

    imaginary = loop.imag
    reals_hz, at_real = _crossings(frequency_hz, loop, imaginary, response, np.imag)
    if at_nyquist:
        reals_hz, at_real = np.append(reals_hz, nyquist_hz), np.append(at_real, at_nyquist)
    negative = at_real.real < 0.0
    gains_db = -20.0 * np.log10(np.abs(at_real[negative]))
    gain = _nearest_to_zero(gains_db)

    sensitivity = 1.0 / np.abs(1.0 + loop)
    worst = int(np.argmax(sensitivity))
    return Margins(
        *_picked(gains_db, reals_hz[negative], gain),
        *_picked(angles, crossings_hz, phase),
        float(ahead.min(initial=math.inf)),
        float(crossings_hz.max()) if len(crossings_hz) else math.nan,
        float(sensitivity[worst]),
        float(frequency_hz[worst]),
    )


def _log_magnitude(loop: ComplexArray) -> Array:
    return np.asarray(np.log(np.abs(loop)))


def _nearest_to_zero(values: Array) -> int | None:
    return int(np.argmin(np.abs(values))) if len(values) else None


def _picked(values: Array, at_hz: Array, place: int | None) -> tuple[float, float]:
    return (math.inf, math.nan) if place is None else (float(values[place]), float(at_hz[place]))


def _crossings(
    frequency_hz: Array,
    loop: ComplexArray,
    values: Array,
    response: Response | None,
    of: Callable[[ComplexArray], Array],
) -> tuple[Array, ComplexArray]:
    """Return where `values` (n,), which `of` makes of L, change sign: frequencies, and L there."""
    places = np.flatnonzero(np.signbit(values[1:]) != np.signbit(values[:-1]))
    found_hz, found = np.zeros(len(places)), np.zeros(len(places), complex)
    for row, place in enumerate(places):
        low, high = values[place], values[place + 1]
        share = low / (low - high) if low != high else 0.5
        ends = np.log(frequency_hz[place : place + 2])
        if response is None:
            found_hz[row] = math.exp(ends[0] + share * (ends[1] - ends[0]))
            ratio = loop[place + 1] / loop[place]
            found[row] = loop[place] * np.exp(share * np.log(ratio))
            continue

        def at(log_hz: float) -> float:
            return float(of(response(np.array([math.exp(log_hz)])))[0])

        crosses = at(ends[0]) * at(ends[1]) < 0.0
        found_hz[row] = math.exp(brentq(at, *ends, xtol=1e-14) if crosses else ends[0])
        found[row] = response(found_hz[row : row + 1])[0]
    return found_hz, found
