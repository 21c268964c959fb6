# SPDX-License-Identifier: Apache-2.0
"""
Noise of a measured current: what a log has of it and no motor ever made force of.

    i(t) = i_true(t) + n(t),        n white, standard deviation sigma

A plant that is driven by i takes n for torque. Least squares and likelihood alike then find that the
machine answers less than it does: an inertia too large, a force constant too small (errors in variables,
T. Soderstrom, Automatica 43, 2007), and a friction that holds still what only noise moves. With S the
spectrum about a time, averaged over its neighbours, the best guess of i_true without phase is that of
Wiener, window by window,

    I_true(t, f) = H(t, f) I(t, f),     H = max(0, 1 - N / S),     N = sigma^2 r sinc(f h)^(2 p),   (1)

with r the ticks in a sample of the log, h its time and p = 1 for a current that is held between samples
and 2 for one that is straight there. A short window follows a current that comes and goes, a long one
takes out slower noise. The most that white noise can be is the level of the quietest octave of the
log's spectrum, its `white_floor`. Whether it is noise only what the machine did can tell
(`estimation.noise_of_currents`).

Assumption: the noise is the same at any time and for any size of the current. The mean of a window is
none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d
from scipy.signal import istft, stft

from waferbot_twin.noise_model.residual_spectrum import BAND
from waferbot_twin.residuals.drive_path import DrivePath
from waferbot_twin.residuals.record import Record

Array = NDArray[np.float64]

FEWEST = 16
"""Lines of an octave at least, to tell a level."""

WINDOWS = 3
"""Windows over which S is averaged, each over a band of its frequency (`residual_spectrum.BAND`)."""

OVERLAP = 4
"""Windows that a sample is in."""


@dataclass(frozen=True)
class CurrentNoise:
    """
    The standard deviation of the noise of a current, A, and the samples in a window.

    And how many `times` that is taken out: S of a few lines varies by chance, and where it is more than
    N some noise is left.
    """

    ampere: float
    samples: int
    times: float = 1.0


def white_floors(records: Sequence[Record]) -> dict[str, float]:
    """
    Return the largest standard deviation (A) that white noise in the current of each axis can have.

    That of the octave which has least in all logs together. Not of an axis of which no current is
    measured, or of which logs are too short.
    """
    octaves: dict[str, list[Array]] = {}
    for record in records:
        for place, axis in enumerate(record.layout.axes):
            if (current := measured_current(record, place)) is not None:
                between = _between(record, place, current)
                octaves.setdefault(axis, []).append(by_octaves(current, *between))
    floors = {axis: white_floor(parts) for axis, parts in octaves.items()}
    return {axis: floor for axis, floor in floors.items() if floor}


def measured_current(record: Record, place: int) -> Array | None:
    """
    Return the current of an axis at all ticks (n,), A, straight over gaps.

    None where an imported log has not measured one, or none that changes.
    """
    if record.current is None or record.layout.axes[place] in record.told_alone:
        return None
    current = record.current[:, place]
    known = np.flatnonzero(np.isfinite(current))
    if not len(known) or np.ptp(current[known]) == 0.0:
        return None
    return np.asarray(np.interp(np.arange(len(current)), known, current[known]))


def without_noise(record: Record, noise: Mapping[str, CurrentNoise]) -> Record:
    """
    Return a log with the currents of some axes without their noise.

    Nothing is known any more of what such a drive did between two samples.
    """
    if record.current is None:
        return record
    current, path = record.current.copy(), record.path
    for axis, one in noise.items():
        place = record.layout.place(axis)
        if (own := measured_current(record, place)) is None:
            continue
        quiet = quieter(own, one, *_between(record, place, own))
        current[:, place] = np.where(np.isfinite(current[:, place]), quiet, np.nan)
        path = None if path is None else _held(path, place)
    return replace(record, current=current, path=path)


def white_floor(parts: Sequence[Array]) -> float:
    """Return that of an axis from the octaves (`by_octaves`) of its logs; 0 if they are too short."""
    together = np.zeros((max(len(part) for part in parts), 2))
    for part in parts:
        together[: len(part)] += part
    return math.sqrt(float(np.min(together[:, 0] / together[:, 1]))) if len(together) else 0.0


def by_octaves(current: Array, step: float, smooth: int) -> Array:
    """
    Return the power of a current in the octaves below half of its log's rate, the highest first: (k, 2).

    Of a current at ticks (n,) with a sample every `step` of them, held (`smooth` 1) or straight (2)
    between. With it what white noise of 1 A in the samples has there.
    """
    lines = dct(current, norm='ortho')
    below = math.ceil(len(lines) / step)
    of_noise = _of_noise(0.5 * np.arange(below) / len(lines), step, smooth)
    both = np.column_stack([lines[:below] ** 2, of_noise])
    ends = below // 2 ** np.arange(int(math.log2(max(below, 1))) + 1)
    ends = ends[ends >= FEWEST]
    return np.array(
        [both[low:high].sum(axis=0) for high, low in itertools.pairwise(ends)]
    ).reshape(-1, 2)


def quieter(current: Array, noise: CurrentNoise, step: float, smooth: int) -> Array:
    """Return a current (n,) without its noise, equation (1); `step` and `smooth` as in `by_octaves`."""
    window = min(round(noise.samples * step), len(current))
    window -= window % OVERLAP
    if window < OVERLAP:
        return current
    shared = window - window // OVERLAP
    frequency, _, lines = stft(
        current, nperseg=window, noverlap=shared, boundary='even', padded=True
    )
    shape = np.hanning(window + 1)[:-1]
    one = float(np.sum(shape**2) / np.sum(shape) ** 2)
    white = (noise.times * noise.ampere) ** 2 * one * _of_noise(frequency, step, smooth)
    # A window of Hann has the mean in its first two lines.
    mean = np.zeros_like(lines)
    mean[0], mean[1] = lines[0], -0.5 * lines[0]
    rest = lines - mean
    power = np.maximum(_averaged(np.abs(rest) ** 2), np.finfo(float).tiny)
    gain = np.maximum(1.0 - white[:, None] / power, 0.0)
    _, quiet = istft(mean + gain * rest, nperseg=window, noverlap=shared)
    return np.asarray(quiet[: len(current)], np.float64)


def _averaged(power: Array) -> Array:
    """Return a spectrum (lines, windows) averaged over neighbouring windows and a band of lines."""
    line = np.arange(len(power))
    reach = np.maximum(np.round(BAND * line).astype(np.intp), 1)
    first, last = (
        np.maximum(line - reach, np.minimum(line, 1)),
        np.minimum(line + reach, len(power) - 1),
    )
    sums = np.cumsum(np.vstack([np.zeros(power.shape[1]), power]), axis=0)
    of_band = (sums[last + 1] - sums[first]) / (last + 1 - first)[:, None]
    return np.asarray(uniform_filter1d(of_band, WINDOWS, axis=1, mode='nearest'))


def _of_noise(frequency: Array, step: float, smooth: int) -> Array:
    """Return the spectrum at ticks of white noise of 1 A in samples, at frequencies in 1/tick."""
    return np.asarray(step * np.sinc(step * frequency) ** (2 * smooth))


def _between(record: Record, place: int, current: Array) -> tuple[float, int]:
    """Return how many ticks apart the samples of a current are, and 1 if it is held there, 2 if not."""
    step_s = 0.0 if record.path is None else float(record.path.step_s[place])
    if step_s > 0.0:
        return max(step_s / record.timing.tick_s, 1.0), 2
    changes = np.flatnonzero(np.diff(current))
    return (float(np.median(np.diff(changes))) if len(changes) > 1 else 1.0), 1


def _held(path: DrivePath, place: int) -> DrivePath:
    """Return a path on which the drive of an axis is held."""
    columns = [array.copy() for array in (path.rise, path.before, path.share, path.step_s)]
    for array in columns:
        array[..., place] = 0.0
    return DrivePath(*columns)
