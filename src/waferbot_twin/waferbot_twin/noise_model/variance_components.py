# SPDX-License-Identifier: Apache-2.0
"""
The noise of a motion residual as a sum of what sensors and disturbances can be.

A filter that is free to take any shape (an autoregression of what is left over) takes for noise
whatever the model gets wrong, and moves all weight to the frequencies at which it is right: high
ones, and reversals. The bias of a prediction-error estimate is where its noise model leaves weight
(L. Ljung, System Identification, 2nd ed., section 8.5). So the spectrum of the noise is not free
here. It is

    S(f) = sum over k of s_k B_k(f),      s_k >= 0,                                              (1)

with shapes B_k that follow from where noise comes from. An innovation e of an observer of
frequency f_o and damping z (`residuals.plant_block`) shows a force through 1 / D(f) and noise of
the reading through (f / f_o)^2 / D(f), D(f) = |1 - (f / f_o)^2 + 2 i z f / f_o|:

    noise of the reading, white         B = (f / f_o)^4 / D^2
    noise of the innovation itself      B = 1
    force, white up to a corner f_c     B = 1 / (D^2 (1 + (f / f_c)^2)),    f_c = 1, 3, 10, 30 Hz, none

And the spectrum is that of the residual without what goes with the motion (`motion_basis`). Values
are estimated with white forces alone, so that every force weighs the same, as in inverse dynamics;
colour is only allowed where models are compared, as it tells small causes from noise.
On the EMPS axis the Coulomb friction is 20.1 N in one record and 20.4 N in the other with white forces,
20.5 N in both by least squares; with coloured ones 18.1 N and, with 65 kg of mass too much, 4.2 N.

The variances s_k are those of maximum likelihood in the averaged periodogram
(Whittle), by multiplicative steps that raise it every time (D. R. Hunter and K. Lange 2004; C.
Fevotte, N. Bertin, J.-L. Durrieu, Neural Computation 21, 2009, for the Itakura-Saito divergence).

What the spectrum does not catch is no part of the weighting. It counts where two models are
compared and in intervals (`residual_spectrum.power_along`, `information`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from waferbot_lockstep.compiled import compiled
from waferbot_twin.noise_model.gram import spanning

Array = NDArray[np.float64]

WHITE_HZ = (np.inf,)
COLOURED_HZ = (1.0, 3.0, 10.0, 30.0, np.inf)
"""Corners of forces: for values, and for evidence."""

ROUNDS, STEPS = 4, 75
"""
Fits of the motion, and multiplicative steps after each; far below the observer the spectrum may still be
some tenths low after them.
"""

BANDS_PER_OCTAVE = 6
GRID = 8192
"""Frequencies from 0 to half the sampling rate on which a spectrum becomes a filter."""

LEAST_LINES = 0.01
"""Of a band, so that rounding is no power where the motion takes it all."""

RIDGE = 1e-9
"""Share of the variance that is added as white noise, so that every spectrum has a filter."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """
    The possible colours of a motion residual's noise.

    `rate_hz` is the residual's sampling rate, `observer_hz` and `damping` those of its observer;
    `motion` are orthonormal columns (n, k) that span what the axis does, `moves` (n,) says when
    (`motion_basis`).
    """

    rate_hz: float
    observer_hz: float
    damping: float
    motion: Array
    corners_hz: tuple[float, ...] = WHITE_HZ
    moves: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    def at(self, frequency_hz: Array) -> Array:
        """Return (k, n): every B_k at n frequencies, each with a mean of one over the whole band."""
        return self.as_they_are(frequency_hz, self.corners_hz) / self._means

    def as_they_are(self, frequency_hz: Array, corners_hz: tuple[float, ...]) -> Array:
        """Return (k, n): every B_k of equation (1) with forces of these corners."""
        x = frequency_hz / self.observer_hz
        force = 1.0 / ((1.0 - x**2) ** 2 + (2.0 * self.damping * x) ** 2)
        forces = [force / (1.0 + (frequency_hz / corner) ** 2) for corner in corners_hz]
        return np.stack([x**4 * force, np.ones_like(x), *forces])

    @cached_property
    def on_grid(self) -> Array:
        """Every B_k on `GRID` + 1 frequencies up to half the sampling rate."""
        return self.at(np.linspace(0.0, 0.5 * self.rate_hz, GRID + 1))

    @cached_property
    def _means(self) -> Array:
        grid_hz = np.linspace(0.0, 0.5 * self.rate_hz, GRID + 1)
        each = self.as_they_are(grid_hz, self.corners_hz)
        return np.asarray(each.mean(axis=1, keepdims=True))

    def on_lines(self, count: int) -> Array:
        """Every B_k on the lines, but that at zero, of the transform of `count` samples."""
        if count not in self._on_lines:
            frequency_hz = np.asarray(np.fft.rfftfreq(count, 1.0 / self.rate_hz), np.float64)
            self._on_lines[count] = self.at(frequency_hz[1:])
        return self._on_lines[count]

    @cached_property
    def _on_lines(self) -> dict[int, Array]:
        return {}

    def motion_lines(self, count: int) -> Array:
        """The motion on those lines, (2L, m); m is 0 if a residual has other samples than the motion."""
        if count != len(self.motion):
            return np.zeros((2 * (count // 2), 0))
        return self._motion_lines

    @cached_property
    def _motion_lines(self) -> Array:
        return lines_of(self.motion)


def lines_of(rows: Array) -> Array:
    """Return the transform of rows (N,) or (N, k) but for zero: real parts, then imaginary ones."""
    lines = np.fft.rfft(rows - rows.mean(axis=0), axis=0)[1:] / math.sqrt(len(rows))
    return np.concatenate([lines.real, lines.imag])


def variances(residual: Array, shapes: Shapes) -> Array:
    """
    Return s (k,) of equation (1) of a residual (N,), by restricted maximum likelihood.

    What goes with the motion is taken out by least squares that weigh every frequency by the noise
    found so far, `ROUNDS` times in turn. Unweighted, columns of the motion would follow the
    noise of readings, a thousand times as strong at high frequencies as at those at which an axis moves,
    and leave more there than they take.
    """
    count = len(residual)
    lines, on_lines = lines_of(residual), shapes.on_lines(count)
    total = 2.0 * float(np.mean(lines**2))
    found = np.full(len(on_lines), total / len(on_lines))
    if not total > 0.0:
        return found
    band = bands(on_lines.shape[1])
    sums = np.bincount(band, np.fft.rfftfreq(count, 1.0 / shapes.rate_hz)[1:])
    base = shapes.at(np.asarray(sums / np.bincount(band), np.float64))
    motion = shapes.motion_lines(count)
    # What the motion can explain where readings are nearly free of noise is no noise, to begin with:
    # begun with the misfit as noise, the fit follows high frequencies and never takes it out.
    spectrum = total * (on_lines[0] + RIDGE)
    for _ in range(ROUNDS):
        power, share = powers_left(lines, motion, spectrum)
        kept = np.maximum(np.bincount(band, share), LEAST_LINES)
        found = likeliest(base, np.bincount(band, power) / kept, kept, total, found)
        spectrum = found @ on_lines
    return np.asarray(found, np.float64)


@compiled
def likeliest(base: Array, power: Array, lines: Array, total: float, start: Array) -> Array:
    """Return the variances (k,) after `STEPS` steps from `start`, of noise with the power `total`."""
    count, bands = base.shape
    found = start.copy()
    for _ in range(STEPS):
        gained, paid = np.zeros(count), np.zeros(count)
        for band in range(bands):
            model = 1e-12 * total
            for shape in range(count):
                model += found[shape] * base[shape, band]
            for shape in range(count):
                weight = lines[band] * base[shape, band] / model
                gained[shape] += weight * power[band] / model
                paid[shape] += weight
        for shape in range(count):
            found[shape] *= math.sqrt(gained[shape] / max(paid[shape], 1e-300))
    return found


@functools.lru_cache(maxsize=64)
def bands(count: int) -> NDArray[np.intp]:
    """Return the band of each of so many lines of a periodogram; bands grow with frequency."""
    place = np.arange(1, count + 1)
    band = np.floor(BANDS_PER_OCTAVE * np.log2(place)).astype(int)
    return np.unique(band, return_inverse=True)[1]


def powers_left(lines: Array, motion: Array, spectrum: Array) -> tuple[Array, Array]:
    """
    Return the power of lines (L,) without what goes with the motion, and the share of each kept.

    `lines` (2L,) and `motion` (2L, m) are real parts and then imaginary ones (`lines_of`). By least
    squares in noise of a spectrum (L,), x' S^-1 x as metric. Of noise of that spectrum a line
    keeps the share 1 - h of its power, h what the fit follows of it (the leverage): in a log of a
    second the motion takes most of what is below 10 Hz. So it counts as 1 - h of a line, as restricted
    maximum likelihood counts degrees of freedom (H. D. Patterson, R. Thompson, Biometrika 58, 1971).
    """
    if not motion.shape[1]:
        return _of_both_parts(lines**2), np.ones(len(spectrum))
    root = np.sqrt(np.concatenate([spectrum, spectrum]))
    columns, wanted = motion / root[:, None], lines / root
    spanned = columns @ spanning(columns.T @ columns)
    left = wanted - spanned @ (spanned.T @ wanted)
    followed = 0.5 * _of_both_parts(np.einsum('lm,lm->l', spanned, spanned))
    return _of_both_parts(left**2) * spectrum, np.maximum(1.0 - followed, 0.0)


def _of_both_parts(squares: Array) -> Array:
    """Return the sums (L,) of what there is of real and of imaginary parts (2L,)."""
    real, imaginary = np.split(squares, 2)
    return np.asarray(real + imaginary)


def prediction_filter(residual: Array, order: int, shapes: Shapes) -> Array:
    """
    Return the prediction-error filter (1, -a_1, ..., -a_p) of noise with the spectrum of equation
    (1).

    By the Yule-Walker equations of its autocovariance. What goes with the motion is no noise.
    """
    spectrum = variances(residual, shapes) @ shapes.on_grid
    autocovariance = np.fft.irfft(spectrum)[: order + 1]
    if not autocovariance[0] > 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    autocovariance[0] *= 1.0 + RIDGE
    taps = solve_toeplitz(autocovariance[:-1], autocovariance[1:])
    return np.concatenate([[1.0], -np.asarray(taps, np.float64)])
