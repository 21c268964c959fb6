# SPDX-License-Identifier: Apache-2.0
"""
What an autoregression leaves of the colour of noise, by its spectrum.

An autoregression of order p at a sampling rate f_s tells frequencies apart that are f_s / p from one
another. Slow forces, below some Hz, it does not see: they raise the spectrum of its residual at the
lowest frequencies by a factor of ten and more and hardly change its autocorrelation. Parameters that
show there, such as a force constant by the weight that it holds, then seem better known than they are.
So the residual's periodogram is averaged over bands that grow with frequency. What is compared is
divided by its square root, frequency by frequency (`Whitening`), or left as it is, and how far its noise
moves what is fitted to it is found with that spectrum (`covariance`).

Limit: the lowest lines are averaged with one another. Where noise still rises towards zero among them,
what shows in the first two periods of a log only is known less well than this says, by some tenths.

Sources: P. Stoica and R. Moses, Spectral Analysis of Signals, 2005, section 2.7 (averaged periodogram);
H. White, Econometrica 48, 1980 (covariance of least squares where the noise is not as assumed); for
coloured noise by its spectrum, E. J. Hannan, Multiple Time Series, 1970, chapter VII.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.noise_model.prediction_error import Fit, prediction_errors

Array = NDArray[np.float64]

FEWEST = 4
"""Lines that are averaged on either side at the lowest frequencies."""

BAND = 0.25
"""Half of a band, as a share of its middle frequency."""


def spectrum(white: Array) -> Array:
    """
    Return the averaged periodogram of N samples at the N // 2 + 1 frequencies of their transform.

    White noise of unit variance has 1 everywhere. The mean is not noise, so the line at zero has the
    average of the lines above it.
    """
    count = len(white)
    lines = np.abs(np.fft.rfft(white - white.mean())) ** 2 / count
    sums = np.concatenate([[0.0], np.cumsum(lines)])
    place = np.arange(len(lines))
    reach = np.maximum(FEWEST, np.round(BAND * place)).astype(int)
    first = np.maximum(place - reach, 1)
    last = np.minimum(place + reach, len(lines) - 1)
    return np.asarray((sums[last + 1] - sums[first]) / (last - first + 1), np.float64)


def flattened(samples: Array, power: Array) -> Array:
    """Return samples (N,) or (N, k), divided by the square root of a spectrum at every frequency."""
    lines = np.fft.rfft(samples, axis=0)
    root = np.sqrt(power)
    divided = lines / (root if samples.ndim == 1 else root[:, None])
    return np.asarray(np.fft.irfft(divided, len(samples), axis=0), np.float64)


class Whitening:
    """Makes the noise in the residuals of one block white and of unit variance."""

    def __init__(self, fit: Fit, channels: Sequence[Array]) -> None:
        """Take the autoregressions of `fit`, and what they leave of the colour of `channels`."""
        self._fit = fit
        self._powers: list[Array | None] = [None] * len(channels)
        self._powers = [
            spectrum(white) if one.error.order else None
            for white, one in zip(self(channels), fit.colours, strict=True)
        ]

    def __call__(self, channels: Sequence[Array]) -> list[Array]:
        """Return the channels, each whitened."""
        return [
            white if power is None else flattened(white, power)
            for white, power in zip(
                prediction_errors(self._fit, channels), self._powers, strict=True
            )
        ]


def covariance(system: Array, estimate: Fit) -> Array:
    """
    Return the covariance (k, k) of what is fitted to white rows A, `system` (N, k), with a joint fit.

    Least squares with noise that has the spectrum S_c in channel c, and not 1, has the covariance

        (A' A)^-1 (sum over c of A_c' S_c A_c) (A' A)^-1,

    where S_c acts on every frequency of the columns of A_c. Where a band has less noise than 1, 1 is
    taken: the fit has taken noise away where it can, and an average over few lines is too low as often
    as too high.
    """
    scale = np.linalg.norm(system, axis=0)
    scale[scale == 0.0] = 1.0
    rows = system / scale
    inverse = np.linalg.pinv(rows.T @ rows, rcond=1e-12)
    noisy = np.zeros_like(inverse)
    parts = np.split(rows, np.cumsum([len(white) for white in estimate.whitened])[:-1])
    for part, white, one in zip(parts, estimate.whitened, estimate.colours, strict=True):
        noisy += part.T @ (_louder(part, white) if one.error.order else part)
    return np.asarray(inverse @ noisy @ inverse / np.outer(scale, scale), np.float64)


def _louder(part: Array, white: Array) -> Array:
    """Return rows (N, k), each frequency times what the noise there has more than white noise has."""
    power = spectrum(white) / max(float(np.mean(white**2)), 1e-300)
    lines = np.fft.rfft(part, axis=0) * np.maximum(power, 1.0)[:, None]
    return np.asarray(np.fft.irfft(lines, len(part), axis=0), np.float64)
