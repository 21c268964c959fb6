# SPDX-License-Identifier: Apache-2.0
"""
What an autoregression leaves of the colour of noise, taken out by its spectrum.

An autoregression of order p at a sampling rate f_s tells frequencies apart that are f_s / p from one
another. Slow forces, below some Hz, it does not see: they raise the spectrum of its residual at the
lowest frequencies by a factor of ten and more and hardly change its autocorrelation. Parameters that
show there, such as a force constant by the weight that it holds, then seem better known than they are.
So the residual's periodogram is averaged over bands that grow with frequency, and what is compared is
divided by its square root, frequency by frequency.

Source: P. Stoica and R. Moses, Spectral Analysis of Signals, 2005, section 2.7 (averaged periodogram).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.diagnosis.whitening import Fit, prediction_errors

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
