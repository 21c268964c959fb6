# SPDX-License-Identifier: Apache-2.0
"""
Resonances and anti-resonances of a frequency response, and which of them a model has too.

A peak is where the magnitude stands out of its surroundings by a prominence (dB), an anti-resonance
where it falls below them by as much. Close to a lightly damped pole p the response is

    G(j w) = (c0 + c1 d) / (d - p)        d = j (w - w0)

with complex c0, c1 for everything else that moves there; fitted by least squares on
G d = c0 + c1 d + p G, weighted again and again by 1 / |d - p| (Sanathanan and Koerner, 1963), it
gives the natural frequency |j w0 + p| and the damping ratio -Re p / |j w0 + p|. For an
anti-resonance 1 / G is fitted. The estimate is averaged over its resolution, which widens and flattens
what is narrow: damping is only an upper bound where 2 damping frequency is below three resolutions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.optimize
import scipy.signal

from waferbot_twin.frequency_response.estimate import Array, ComplexArray, FrequencyResponse

RESONANCE, ANTIRESONANCE = 'resonance', 'anti-resonance'

PROMINENCE_DB = 3.0
"""Smallest prominence of a peak, dB."""

SURE = 3.0
"""A peak stands out by this many times what the level is known to: the circle of 95 %, or twice the
scatter from line to line, which also has what friction and play do to the response."""

KNOWN_SHARE = 0.7
"""Share of the lines around a peak that must be reliable."""

ROUGHNESS_LINES = 20
"""Resolutions over which the scatter from line to line is taken."""

WIDE = 3.0
"""Resolutions that a peak must be wide for its damping to be known."""

SAME_SHARE = 0.15
"""Peaks of measurement and model can be the same if they are no farther apart than this share."""

MATCHED, MISSING, EXTRA, NOT_JUDGED = 'matched', 'missing in model', 'extra in model', 'not judged'


@dataclass(frozen=True)
class Peak:
    """
    A resonance or an anti-resonance.

    frequency_hz  natural frequency
    damping       ratio to critical damping
    bounded       whether `damping` is only an upper bound: the peak is hardly wider than the resolution
    magnitude     of the response at the peak, its unit
    prominence_db by how much it stands out of its surroundings
    coherence     there, 0 to 1
    """

    kind: str
    frequency_hz: float
    damping: float
    bounded: bool
    magnitude: float
    prominence_db: float
    coherence: float


@dataclass(frozen=True)
class Pair:
    """A peak of the measurement and of the model, either of which may lack, with the verdict."""

    measured: Peak | None
    model: Peak | None
    verdict: str

    @property
    def kind(self) -> str:
        """Resonance or anti-resonance."""
        return (self.measured or self.model).kind  # type: ignore[union-attr]

    @property
    def frequency_hz(self) -> float:
        """Frequency of the measured peak, or of the model's if there is none."""
        return (self.measured or self.model).frequency_hz  # type: ignore[union-attr]

    @property
    def shift_percent(self) -> float | None:
        """How far the model's frequency is above the measured one; None without a partner."""
        if self.measured is None or self.model is None:
            return None
        return 100.0 * (self.model.frequency_hz / self.measured.frequency_hz - 1.0)


def find_peaks(
    response: FrequencyResponse, prominence_db: float = PROMINENCE_DB
) -> tuple[Peak, ...]:
    """
    Return the resonances and anti-resonances of the reliable part of a response, rising.

    A hump that no single pole makes, as friction does at low frequencies, is none.
    """
    lines = np.flatnonzero(response.reliable)
    if len(lines) < 5:
        return ()
    frequency, value = response.frequency_hz[lines], response.value[lines]
    level_db = 20.0 * np.log10(np.abs(value))
    apart = max(1, round(response.resolution_hz / np.median(np.diff(frequency))))
    circle_db = 20.0 * np.log10(1.0 + response.radius()[lines] / np.abs(value))
    band_db = np.maximum(circle_db, 2.0 * _roughness(level_db, apart))
    found = []
    for kind, sign in ((RESONANCE, 1.0), (ANTIRESONANCE, -1.0)):
        tops, properties = scipy.signal.find_peaks(
            sign * level_db, distance=apart, prominence=prominence_db, width=2.0 * apart
        )
        for top, prominence, width in zip(
            tops, properties['prominences'], properties['widths'], strict=True
        ):
            around = max(width, 2.0 * apart, 4.0)
            near = np.abs(np.arange(len(response.frequency_hz)) - lines[top]) <= around
            if prominence < SURE * band_db[top] or response.reliable[near].mean() < KNOWN_SHARE:
                continue
            part = slice(max(0, round(top - around)), round(top + around) + 1)
            fitted = _pole(
                frequency[part], value[part] ** sign, frequency[top], response.resolution_hz
            )
            if fitted is None:
                continue
            natural_hz, damping = fitted
            bounded = 2.0 * damping * natural_hz < WIDE * response.resolution_hz
            if bounded:
                damping = max(damping, 0.5 * response.resolution_hz / natural_hz)
            found.append(
                Peak(
                    kind,
                    natural_hz,
                    damping,
                    bounded,
                    float(np.abs(value[top])),
                    float(prominence),
                    float(response.coherence[lines[top]]),
                )
            )
    return tuple(sorted(found, key=lambda peak: peak.frequency_hz))


def _roughness(level_db: Array, apart: int) -> Array:
    """
    Return the standard deviation of a level from line to line around each line, dB.

    What a line misses the mean of its neighbours by is noise and distortion, but for the few lines of a
    peak; the median over a window does not see those.
    """
    padded = np.pad(level_db, apart, mode='reflect', reflect_type='odd')
    missed = np.abs(level_db - 0.5 * (padded[: -2 * apart] + padded[2 * apart :]))
    window = 2 * min(len(missed), ROUGHNESS_LINES * apart) // 2 + 1
    median = scipy.ndimage.median_filter(missed, window, mode='reflect')
    return median / (0.6745 * np.sqrt(1.5))


def _pole(
    frequency_hz: Array, value: ComplexArray, top_hz: float, resolution_hz: float
) -> tuple[float, float] | None:
    """
    Return natural frequency (Hz) and damping ratio of the pole close to a peak, None if none is.

    What is far narrower than the resolution may come out with a damping slightly below zero; that is 0.
    """
    offset = 2j * np.pi * (frequency_hz - top_hz)
    scale = float(np.max(np.abs(offset)))
    offset = offset / scale
    value = value / np.max(np.abs(value))
    columns = np.column_stack([np.ones_like(offset), offset, value])
    weight = np.ones(len(offset))
    pole = 0j
    for _ in range(20):
        solution, *_ = np.linalg.lstsq(
            weight[:, None] * columns, weight * value * offset, rcond=None
        )
        pole = complex(solution[2])
        weight = 1.0 / np.maximum(np.abs(offset - pole), 1e-3)
    absolute = 2j * np.pi * top_hz + pole * scale
    grows_hz = pole.real * scale / (2.0 * np.pi)
    if grows_hz > 0.5 * resolution_hz or abs(pole.imag) > 0.5 or absolute.imag <= 0.0:
        return None
    return float(abs(absolute) / (2.0 * np.pi)), float(max(0.0, -absolute.real / abs(absolute)))


def match(
    measured: FrequencyResponse,
    model: FrequencyResponse | None,
    prominence_db: float = PROMINENCE_DB,
) -> list[Pair]:
    """
    Return the peaks of both, paired where they can be the same, by rising frequency.

    Peaks of one kind are paired so that the sum of their distances (of log frequency) is smallest, none
    farther than 15 % or the resolution. One without a partner is `missing in model` or `extra in
    model`; `not judged` where the other side is not reliable, or there is no model.
    """
    if model is None:
        return [Pair(peak, None, NOT_JUDGED) for peak in find_peaks(measured, prominence_db)]
    pairs = []
    sides = find_peaks(measured, prominence_db), find_peaks(model, prominence_db)
    for kind in (RESONANCE, ANTIRESONANCE):
        ours, theirs = ([peak for peak in side if peak.kind == kind] for side in sides)
        width_hz = max(measured.resolution_hz, model.resolution_hz)
        partners = _assigned(ours, theirs, width_hz)
        pairs += [Pair(ours[row], theirs[column], MATCHED) for row, column in partners.items()]
        pairs += [
            Pair(peak, None, MISSING if _judged(model, peak) else NOT_JUDGED)
            for row, peak in enumerate(ours)
            if row not in partners
        ]
        pairs += [
            Pair(None, peak, EXTRA if _judged(measured, peak) else NOT_JUDGED)
            for column, peak in enumerate(theirs)
            if column not in partners.values()
        ]
    return sorted(pairs, key=lambda pair: pair.frequency_hz)


def _assigned(ours: Sequence[Peak], theirs: Sequence[Peak], width_hz: float) -> dict[int, int]:
    """Return which peak of one side belongs to which of the other."""
    if not ours or not theirs:
        return {}
    one = np.array([peak.frequency_hz for peak in ours])[:, None]
    other = np.array([peak.frequency_hz for peak in theirs])[None, :]
    distance = np.abs(np.log(other / one))
    allowed = np.abs(other - one) <= np.maximum(width_hz, SAME_SHARE * one)
    far = 1e3  # dearer than any sum of allowed distances, so that as many as can be are paired
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(allowed, distance, far))
    return {
        int(row): int(column)
        for row, column in zip(rows, columns, strict=True)
        if allowed[row, column]
    }


def _judged(response: FrequencyResponse, peak: Peak) -> bool:
    """Return whether a response is known well enough where the other has a peak."""
    near = np.argmin(np.abs(response.frequency_hz - peak.frequency_hz))
    close = abs(response.frequency_hz[near] - peak.frequency_hz) <= response.resolution_hz
    return bool(close and response.reliable[near])
