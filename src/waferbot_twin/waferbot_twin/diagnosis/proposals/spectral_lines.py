# SPDX-License-Identifier: Apache-2.0
"""
Lines in the spectrum of what the plant leaves over: something rings that the model holds still.

The spectra of pieces of a log are averaged, each at its own level, as noise is louder while an axis
moves. What stands out of the median about it, more than noise would, is a line. A ring that the loop
damps in a tenth of a second is lost in that mean; it stands out of one piece, a brief line. Below the
frequency that the observer holds there are none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import spectrogram
from scipy.stats import chi2

from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.plant_block import OBSERVER_HZ
from waferbot_twin.residuals.problem import PLANT, Problem
from waferbot_twin.residuals.record import Array

SEGMENT, BRIEF = 1024, 256
"""
Samples of the pieces whose spectra are averaged, and of those that are looked at one by one: a ring that
the loop damps in a tenth of a second is lost in the mean over a log.
"""

BACKGROUND = 41
"""Lines of a spectrum whose median is its background; fewer with brief pieces, as wide in hertz."""

OVERLAPPING = 0.9
"""Independent pieces that each of the pieces, which overlap by half, is worth."""

CHANCE = 0.01
"""Probability that white noise alone has a line."""

ABOUT = 1.15
"""Margin for the background of a single piece, which is known to a tenth or so."""

MOST_LINES = 3
"""How many lines are tried: each costs up to some twenty simulations for every compliance."""

NEAR = 0.06
"""Share of a frequency that the observer, and what other parts give, may move a line."""

SAME_RATE = 1e-6
"""Share by which rates of samples may differ that are the same."""


@dataclass(frozen=True)
class Line:
    """
    A line in the spectrum of a channel: frequency, power over background, rate of samples, Hz.

    `excess` is the prominence over the least that counts. A `brief` one is that of a single piece.
    """

    channel: str
    frequency_hz: float
    excess: float
    rate_hz: float
    brief: bool = False


@dataclass(frozen=True)
class Spectrum:
    """
    Rate of the samples, frequencies, power density with its `prominence`, and of how many pieces.

    It is the mean of the pieces, or, `brief`, the largest of any; the prominence is over the background,
    with pieces as loud as one another.
    """

    rate_hz: float
    frequency_hz: Array
    power: Array
    prominence: Array
    pieces: float
    brief: bool


def lines(problem: Problem, base: Hypothesis, brief: bool = True) -> list[Line]:
    """
    Return the most prominent lines of what the plant leaves over, above what the observer holds.

    Those of single pieces only if they are asked for, `brief`.
    """
    found: list[Line] = []
    channels = list(dict.fromkeys(problem.channel_names(PLANT)))
    for channel, piece in itertools.product(channels, (False, True) if brief else (False,)):
        spectrum = spectrum_of(problem, base.residuals[PLANT], channel, piece)
        if spectrum is None:
            continue
        excess = spectrum.prominence / _least_prominence(spectrum, len(channels))
        # A line may be at half the rate of the samples, where the spectrum ends.
        above = np.append(excess[2:], 0.0)
        peaks = 1 + np.flatnonzero(
            (excess[1:] > np.maximum(excess[:-1], np.maximum(above, 1.0)))
            & (spectrum.frequency_hz[1:] > OBSERVER_HZ)
        )
        found += [
            Line(
                channel,
                float(spectrum.frequency_hz[peak]),
                float(excess[peak]),
                spectrum.rate_hz,
                piece,
            )
            for peak in peaks
        ]
    chosen: list[Line] = []
    for line in sorted(found, key=lambda line: (line.brief, -line.excess)):
        apart = all(abs(line.frequency_hz / other.frequency_hz - 1.0) > NEAR for other in chosen)
        if apart and len(chosen) < MOST_LINES:
            chosen.append(line)
    return chosen


def _least_prominence(spectrum: Spectrum, channels: int) -> float:
    """
    Return the power over the median that one of the lines of noise exceeds with `CHANCE`.

    The mean power of K independent pieces has a chi-squared distribution with 2 K degrees of freedom,
    that of each of K pieces one with 2.
    """
    lines = len(spectrum.power) * channels
    if spectrum.brief:
        one = chi2(2.0)
        return float(ABOUT * one.isf(CHANCE / (lines * spectrum.pieces)) / one.median())
    distribution = chi2(2.0 * spectrum.pieces)
    return float(distribution.isf(CHANCE / lines) / distribution.median())


def spectrum_of(
    problem: Problem, channels: Sequence[Array], name: str, brief: bool
) -> Spectrum | None:
    """Return the spectrum of a channel in all logs with its rate; None if all are too short."""
    length = BRIEF if brief else SEGMENT
    rate_hz, frequency_hz = 0.0, np.zeros(0)
    pieces: list[Array] = []
    every = zip(problem.channel_names(PLANT), problem.plant_rates_hz, channels, strict=True)
    for own, rate, channel in every:
        if own != name or len(channel) < length:
            continue
        if rate_hz and abs(rate / rate_hz - 1.0) > SAME_RATE:
            continue
        rate_hz = rate
        frequency_hz, _, power = spectrogram(
            channel, rate, 'hann', length, length // 2, detrend='constant'
        )
        pieces.append(power.T)
    if not pieces:
        return None
    powers = np.vstack(pieces)
    count = OVERLAPPING * len(powers)
    # Noise is louder while an axis moves over counts: each piece has a level of its own.
    shape = _background(np.median(powers, axis=0), length)
    level = np.maximum(np.median(powers / shape, axis=1), 1e-300)
    levelled = powers / level[:, None]
    if brief:
        prominence = (levelled / shape).max(axis=0)
        return Spectrum(rate_hz, frequency_hz, powers.max(axis=0), prominence, count, brief)
    mean = levelled.mean(axis=0)
    prominence = mean / _background(mean, length)
    return Spectrum(rate_hz, frequency_hz, powers.mean(axis=0), prominence, count, brief)


def _background(power: Array, length: int) -> Array:
    """Return the median about each line of a spectrum of pieces of a length."""
    lines = BACKGROUND * length // SEGMENT + 1 - BACKGROUND * length // SEGMENT % 2
    return np.maximum(median_filter(power, lines), 1e-300)


def line_at(
    problem: Problem, channels: Sequence[Array], line: Line, within_hz: float
) -> tuple[float, float]:
    """Return the frequency of the strongest line near another, Hz, and its RMS value, counts."""
    spectrum = spectrum_of(problem, channels, line.channel, line.brief)
    assert spectrum is not None  # it has a line
    return strongest(spectrum, line, within_hz)


def strongest(spectrum: Spectrum, line: Line, within_hz: float) -> tuple[float, float]:
    """Return the frequency of the strongest line of a spectrum near a line, Hz, and its RMS value."""
    near = np.flatnonzero(np.abs(spectrum.frequency_hz - line.frequency_hz) < within_hz)
    highest = int(near[np.argmax(spectrum.power[near])])
    about = slice(max(highest - 2, 0), highest + 3)
    power, frequency_hz = spectrum.power[about], spectrum.frequency_hz[about]
    total = float(power.sum())
    middle_hz = float(power @ frequency_hz) / total if total > 0.0 else line.frequency_hz
    spacing_hz = float(spectrum.frequency_hz[1])
    return middle_hz, math.sqrt(total * spacing_hz)
