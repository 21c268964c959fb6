# SPDX-License-Identifier: Apache-2.0
"""
Features of a curve that a text about a figure speaks of: swings, crossings, lines, growth, lead.

Pure functions on times (s, ascending, evenly spaced) and values (n,) of any unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, find_peaks, sosfiltfilt

LINE_WINDOW_S = 0.25
"""Length of the stretch behind a step whose spectrum is looked at: lines 4 Hz apart are told apart."""


@dataclass(frozen=True)
class Line:
    """A line of a spectrum: where it is, and the amplitude of a steady sine that would make it."""

    frequency_hz: float
    amplitude: float


def turning_points(
    time: np.ndarray, values: np.ndarray, least: float
) -> list[tuple[float, float]]:
    """
    Return (time, value) where a curve turns, alternating high and low, from its first turn on.

    A turn counts once the curve has gone back from it by `least`; smaller wiggles are passed over.
    """
    found: list[tuple[float, float]] = []
    high = low = values[0]
    high_at = low_at = time[0]
    direction = 0
    for moment, value in zip(time.tolist(), values.tolist(), strict=True):
        if value > high:
            high, high_at = value, moment
        if value < low:
            low, low_at = value, moment
        if direction >= 0 and high - value >= least:
            if direction > 0:
                found.append((high_at, high))
            direction, low, low_at = -1, value, moment
            high, high_at = value, moment
        elif direction <= 0 and value - low >= least:
            if direction < 0:
                found.append((low_at, low))
            direction, high, high_at = 1, value, moment
            low, low_at = value, moment
    return found


def crossings(values: np.ndarray, level: float) -> int:
    """Return how often a curve passes a level, up or down."""
    above = values > level
    return int(np.count_nonzero(above[1:] != above[:-1]))


def strongest_line(
    time: np.ndarray, values: np.ndarray, band_hz: tuple[float, float], end: float | None = None
) -> Line:
    """
    Return the highest local maximum of a curve's spectrum within a band; amplitude 0 without one.

    The curve less `end` (its last value if None), under a Hann window over its first
    `LINE_WINDOW_S`, so that a step's slow part does not leak. A vibration that dies within them was
    larger than the amplitude says. A flank without a maximum is no line.
    """
    frequency, spectrum = amplitude_spectrum(time, values, end)
    peaks, _ = find_peaks(spectrum)
    peaks = peaks[(frequency[peaks] >= band_hz[0]) & (frequency[peaks] <= band_hz[1])]
    if len(peaks) == 0:
        return Line(float('nan'), 0.0)
    highest = peaks[np.argmax(spectrum[peaks])]
    return Line(float(frequency[highest]), float(spectrum[highest]))


def amplitude_spectrum(
    time: np.ndarray, values: np.ndarray, end: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (Hz) and amplitudes of the first `LINE_WINDOW_S` of a curve, Hann window."""
    part = values[time - time[0] < LINE_WINDOW_S]
    window = np.hanning(len(part))
    settled = part[-1] if end is None else end
    spectrum = np.abs(np.fft.rfft((part - settled) * window, 4 * len(part)))
    return np.fft.rfftfreq(4 * len(part), time[1] - time[0]), 2.0 * spectrum / window.sum()


def time_of_final_amplitude(time: np.ndarray, values: np.ndarray, share: float = 0.9) -> float:
    """
    Return from when on an oscillation has `share` of the amplitude that it ends with, s.

    Behind the last swing between two turning points that is smaller than that share of the mean of the
    last quarter of swings. NaN of a curve that turns fewer than eight times.
    """
    turns = np.array(turning_points(time, values, 0.02 * np.ptp(values)))
    if len(turns) < 8:
        return float('nan')
    swing = np.abs(np.diff(turns[:, 1]))
    last = swing[-(len(swing) // 4) :].mean()
    smaller = np.flatnonzero(swing < share * last)
    return float(turns[smaller[-1] + 1, 0]) if len(smaller) else float(turns[0, 0])


def low_passed(time: np.ndarray, values: np.ndarray, corner_hz: float) -> np.ndarray:
    """Return a curve without what is faster than a corner: Butterworth, fourth order, both ways."""
    sections = butter(4, corner_hz, fs=1.0 / (time[1] - time[0]), output='sos')
    return sosfiltfilt(sections, values)


def lead(
    time: np.ndarray, first: np.ndarray, second: np.ndarray, longest_s: float = 0.02
) -> float:
    """
    Return by how much `first` leads `second`, s: the shift at which they correlate best.

    Both at the times `time`; the coefficient of correlation of what overlaps, shifts of whole samples,
    at most `longest_s`: half a period of what oscillates, 24 Hz, or another period may fit better.
    """
    interval = time[1] - time[0]
    farthest = round(longest_s / interval)
    size = len(first)
    shifts = np.arange(-farthest, farthest + 1)
    coefficients = [
        np.corrcoef(
            first[max(0, -shift) : size - max(0, shift)],
            second[max(0, shift) : size + min(0, shift)],
        )[0, 1]
        for shift in shifts.tolist()
    ]
    return float(shifts[int(np.argmax(coefficients))] * interval)


def time_above(time: np.ndarray, values: np.ndarray, level: float) -> float:
    """Return for how long the magnitude of a curve is above a level, s."""
    return float(np.count_nonzero(np.abs(values) > level) * (time[1] - time[0]))
