# SPDX-License-Identifier: Apache-2.0
"""
Frequency response from sampled signals, with coherence and a confidence circle.

Every run gives several looks at its spectra: the periods of a periodic reference, or otherwise the
orthogonal sine tapers of the whole run. Looks of all runs are the rows k of a
regression on the reference R at each frequency,

    X_k = Gxr R_k + noise        Y_k = Gyr R_k + noise        G = Gyr / Gxr

with input X and output Y. This is the *indirect* estimate: the reference of a loop knows nothing of
its noise, so noise only scatters G. Without a reference R = X is taken, the *direct* estimate
H1 = Syx / Sxx, which is right in open loop; in closed loop the noise that the controller feeds back is
in X too and pulls H1 towards -1 / controller.

With e_k = (Y_k - Gyr R_k) - G (X_k - Gxr R_k) and K looks,

    var G = sum |e_k|^2 / (K - 1) / (|Gxr|^2 sum |R_k|^2)

and G lies with 95 % confidence within the circle of radius sqrt(var G F(2, 2 K - 2; 0.95)); for the
direct estimate this is the circle of Bendat and Piersol, |G|^2 (1 - c) / c / (K - 1) F, c the coherence.

A swept sine, a random signal and a move are all served by tapers: they leak little, and a resolution
B over T seconds gives B T - 1 looks. Where every look has the same reference (periods), what scatters is
noise; bent by friction or play, the response differs from one *realisation* of a multisine to another,
but not from period to period. With several realisations both are told apart.

Sources: J. S. Bendat, A. G. Piersol, Random Data; K. S. Riedel, A. Sidorenko, Minimum bias multiple
taper spectral estimation, IEEE Trans. Signal Processing 43 (1995); R. Pintelon, J. Schoukens, System
Identification: A Frequency Domain Approach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.signal
import scipy.stats
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LOOKS = 6
"""Looks at each frequency that a run gives if no resolution is asked for."""

SAME = 1e-6
"""Two periods are the same if they differ by less than this share of their energy."""

EXCITED = 1e-6
"""A harmonic is excited if the reference is at least this share of the strongest one there, ..."""

REPEATED = 1000.0
"""... and its mean over the periods has this many times the power that scatters (rounding)."""


@dataclass(frozen=True)
class Run:
    """
    Input and output of one run, evenly sampled every `step_s`; arrays (n,).

    `reference` is what was commanded, free of the loop's noise; None if it is not known.
    """

    step_s: float
    input: Array
    output: Array
    reference: Array | None = None


@dataclass(frozen=True)
class FrequencyResponse:
    """
    A frequency response at n frequencies (Hz, rising).

    value         (n,) output over input
    deviation     (n,) standard deviation of `value`, the root of E |error|^2
    coherence     (n,) 0 to 1: share of output and input (the smaller one) that the reference explains
    noise         (n,) part of `deviation` that differs from period to period, or None: not known apart
    degrees       degrees of freedom of the deviation, complex (looks less one)
    resolution_hz width over which the response is averaged
    method        'direct' or 'indirect'
    looks         'periods', 'realisations' or 'tapers'
    """

    frequency_hz: Array
    value: ComplexArray
    deviation: Array
    coherence: Array
    noise: Array | None
    degrees: int
    resolution_hz: float
    method: str
    looks: str

    def radius(self, confidence: float = 0.95) -> Array:
        """Return the radius of the circle around `value` that holds the truth."""
        return self.deviation * np.sqrt(scipy.stats.f.ppf(confidence, 2, 2 * self.degrees))

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """Where the circle of 95 % is smaller than half of the response."""
        return self.radius() < 0.5 * np.abs(self.value)

    def times(self, factor: ComplexArray) -> FrequencyResponse:
        """Return the response multiplied by a known one, (n,)."""
        size = np.abs(factor)
        return FrequencyResponse(
            self.frequency_hz,
            self.value * factor,
            self.deviation * size,
            self.coherence,
            None if self.noise is None else self.noise * size,
            self.degrees,
            self.resolution_hz,
            self.method,
            self.looks,
        )


def estimate(
    runs: Sequence[Run], resolution_hz: float | None = None, highest_hz: float | None = None
) -> FrequencyResponse:
    """
    Return the frequency response behind one or more runs, up to `highest_hz` (default: 80 % of Nyquist).

    References with a common period are averaged over its repetitions, at the harmonics that they excite;
    the first period is left out, the machine settles in it. Otherwise `resolution_hz` is the width that
    is averaged over, by default so wide that the shortest run has `LOOKS` looks. Where one run has no
    reference, or a constant one, none is used.

    Raises `UserError` if runs are sampled differently, or too short for the resolution.
    """
    if len({round(run.step_s * 1e9) for run in runs}) != 1:
        raise UserError('the logs are sampled at different rates; estimate them one by one')
    indirect = all(run.reference is not None and np.ptp(run.reference) > 0.0 for run in runs)
    top_hz = min(highest_hz or np.inf, 0.4 / runs[0].step_s)
    if indirect and resolution_hz is None:
        periods = _whole_periods(runs)
        if periods:
            return _of_periods(runs[0].step_s, periods, top_hz)
    return _of_tapers(runs, resolution_hz, top_hz, indirect)


def period_of(reference: Array) -> tuple[int, slice] | None:
    """
    Return the period in samples, and the longest stretch that repeats itself with it.

    It is sought in the third quarter of the signal: None if that does not repeat what was before it,
    or has nothing that could be repeated.
    """
    begin, end = len(reference) // 2, 3 * len(reference) // 4
    part = reference[begin:end]
    energy = float(np.sum(part**2))
    if energy == 0.0:
        return None
    squares = np.concatenate([[0.0], np.cumsum(reference[:end] ** 2)])
    before = (squares[len(part) :] - squares[: -len(part)])[::-1]
    products = scipy.signal.correlate(reference[:end], part, 'valid', 'fft')[::-1]
    difference = energy + before - 2.0 * products
    lags, _ = scipy.signal.find_peaks(-difference)
    repeating = [int(lag) for lag in lags if difference[lag] < SAME * energy]
    if not repeating:
        return None
    lag = repeating[0]
    change = np.abs(reference[lag:] - reference[:-lag])
    different = np.flatnonzero(change > np.sqrt(SAME) * np.max(np.abs(part)))
    after = np.searchsorted(different, begin)
    first = int(different[after - 1]) + 1 if after else 0
    last = int(different[after]) if after < len(different) else len(change)
    return lag, slice(first, last + lag)


def _whole_periods(runs: Sequence[Run]) -> list[Array]:
    """
    Return reference, input and output (3, periods, samples) of each run, in a common period.

    The first period of a run is left out; all have as many. Empty without a common period.
    """
    found = [period_of(run.reference) for run in runs if run.reference is not None]
    periods = [one for one in found if one]
    if len(periods) < len(runs) or len({length for length, _ in periods}) > 1:
        return []
    length = periods[0][0]
    count = min((part.stop - part.start) // length - 1 for _, part in periods)
    if count < 2:
        return []
    return [
        np.stack([run.reference, run.input, run.output])[:, part.stop - count * length : part.stop]
        .reshape(3, count, length)
        for run, (_, part) in zip(runs, periods, strict=True)
        if run.reference is not None
    ]  # fmt: skip


def _of_periods(step_s: float, periods: Sequence[Array], top_hz: float) -> FrequencyResponse:
    """Return the response at the harmonics of a common period, from (3, count, samples) of each run."""
    length = periods[0].shape[-1]
    frequency = np.fft.rfftfreq(length, step_s)
    spectra = np.fft.rfft(np.stack(periods, axis=1))
    strength = np.abs(spectra[0].mean(axis=1))
    scatter = spectra[0].std(axis=1, ddof=1) / np.sqrt(spectra.shape[2])
    excited = (strength > EXCITED * strength.max()) & (strength > np.sqrt(REPEATED) * scatter)
    lines = excited.all(axis=0) & (frequency > 0.0) & (frequency <= top_hz)
    spectra = spectra[..., lines]
    realisations = len(periods)
    every = spectra.reshape(3, -1, int(np.count_nonzero(lines)))
    value, deviation, coherence, degrees = _regression(every, realisations)
    noise, looks = deviation, 'periods'
    if realisations > 1:
        value, deviation, coherence, degrees = _regression(spectra.mean(axis=2))
        looks = 'realisations'
    return FrequencyResponse(
        frequency[lines], value, deviation, coherence, noise, degrees, 1.0 / (length * step_s),
        'indirect', looks,
    )  # fmt: skip


def _of_tapers(
    runs: Sequence[Run], resolution_hz: float | None, top_hz: float, indirect: bool
) -> FrequencyResponse:
    """Return the response averaged over a width of frequencies."""
    durations = [len(run.input) * run.step_s for run in runs]
    width = resolution_hz or (LOOKS + 1.0) / min(durations)
    size = scipy.fft.next_fast_len(max(len(run.input) for run in runs), real=True)
    frequency = np.arange(size // 2 + 1) / (size * runs[0].step_s)
    lines = (frequency >= width) & (frequency <= top_hz)
    looks = []
    for run, duration in zip(runs, durations, strict=True):
        count = int(np.floor(width * duration + 1e-9)) - 1
        if count < 2 or not lines.any():
            raise UserError(
                f'a log of {duration:.4g} s cannot resolve {width:.4g} Hz: give a --resolution '
                f'between {3.0 / duration:.2g} and {top_hz:.4g} Hz, or a longer log'
            )
        tapers = _sine_tapers(len(run.input), count)
        signals = [run.reference if indirect else run.input, run.input, run.output]
        rows = [
            np.fft.rfft(tapers * (signal - signal.mean()), size)[:, lines]
            for signal in signals
            if signal is not None
        ]
        looks.append(np.stack(rows))
    value, deviation, coherence, degrees = _regression(np.concatenate(looks, axis=1))
    return FrequencyResponse(
        frequency[lines], value, deviation, coherence, None, degrees, width,
        'indirect' if indirect else 'direct', 'tapers',
    )  # fmt: skip


def _sine_tapers(size: int, count: int) -> Array:
    """Return the first `count` sine tapers (count, size): orthogonal, of energy 1."""
    order, sample = np.arange(1, count + 1)[:, None], np.arange(1, size + 1)
    return np.sqrt(2.0 / (size + 1.0)) * np.sin(np.pi * order * sample / (size + 1.0))


def _regression(
    looks: ComplexArray, realisations: int = 1
) -> tuple[ComplexArray, Array, Array, int]:
    """
    Return response, its deviation, coherence and degrees of freedom.

    `looks` (3, K, n) are reference, input and output of K looks at n frequencies. With several
    `realisations` (of as many looks each) the response may differ from one to the next, and only
    what is left within them counts.
    """
    reference, signal, result = looks
    power = np.sum(np.abs(reference) ** 2, axis=0)
    to_input: ComplexArray = (signal * reference.conj()).sum(axis=0) / power
    to_output: ComplexArray = (result * reference.conj()).sum(axis=0) / power
    value = to_output / to_input
    left = (result - to_output * reference) - value * (signal - to_input * reference)
    degrees = len(reference) - realisations
    if realisations > 1:
        parts = np.split(left, realisations)
        left = np.concatenate([part - part.mean(axis=0) for part in parts])
    variance = np.sum(np.abs(left) ** 2, axis=0) / degrees / power
    deviation: Array = np.sqrt(variance) / np.abs(to_input)
    coherence: Array = np.minimum(
        np.abs(to_output) ** 2 * power / np.sum(np.abs(result) ** 2, axis=0),
        np.abs(to_input) ** 2 * power / np.sum(np.abs(signal) ** 2, axis=0),
    )
    return value, deviation, coherence, degrees
