# SPDX-License-Identifier: Apache-2.0
"""
What an autoregression leaves of the colour of noise, by its spectrum.

An autoregression of order p at a sampling rate f_s tells frequencies apart that are f_s / p from
one another. Slow forces, below some Hz, it does not see: they raise the spectrum of its residual
at the lowest frequencies by a factor of ten and more and hardly change its autocorrelation.
Parameters that show there, such as a force constant by the weight that it holds, then seem better
known than they are. So the residual's periodogram is averaged over bands that grow with frequency.
What is compared is divided by its square root, frequency by frequency (`Whitening`), or left as it
is, and how far its noise moves what is fitted to it is found with that spectrum (`covariance`).

Limit: the lowest lines are averaged with one another. Where noise still rises towards zero among
them, what shows in the first two periods of a log only is known less well than this says, by some
tenths.

Sources: P. Stoica and R. Moses, Spectral Analysis of Signals, 2005, section 2.7 (averaged
periodogram); H. White, Econometrica 48, 1980 (covariance of least squares where the noise is not
as assumed); for coloured noise by its spectrum, E. J. Hannan, Multiple Time Series, 1970, chapter
VII.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from waferbot_twin.noise_model import misfit
from waferbot_twin.noise_model.gram import spanning
from waferbot_twin.noise_model.power import Power
from waferbot_twin.noise_model.prediction_error import Colour, Fit, prediction_errors

Array = NDArray[np.float64]

FEWEST = 4
"""Lines that are averaged on either side at the lowest frequencies."""

KEPT = 4_000_000
"""Values of cosines that are kept for logs of one length: more are summed by a transform."""

BAND = 0.25
"""Half of a band, as a share of its middle frequency."""


def spectrum(white: Array) -> Array:
    """
    Return the averaged periodogram of N samples at the N // 2 + 1 frequencies of their transform.

    White noise of unit variance has 1 everywhere. The mean is not noise, so the line at zero has
    the average of the lines above it.
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


def on_cosines(samples: Array, count: int) -> Array:
    """Return the sums of samples (N,) or (N, k) with the first K cosines, each of mean square 1."""
    count = min(count, len(samples) - 1)
    if count * len(samples) <= KEPT:
        return np.asarray(_cosines(len(samples), count) @ samples)
    return np.asarray(dct(samples, axis=0)[1 : count + 1] / math.sqrt(2.0), np.float64)


@functools.lru_cache(8)
def _cosines(samples: int, count: int) -> Array:
    """Return the first K cosines over N samples, (K, N): for few a third of the time of a transform."""
    middles = (np.arange(samples) + 0.5) * (math.pi / samples)
    return math.sqrt(2.0) * np.cos(np.outer(np.arange(1, count + 1), middles))


def powers_along(
    left: Sequence[Array], changes: Sequence[Array], colours: Sequence[Colour]
) -> list[Power]:
    """
    Return the power of the noise in a direction d, channel by channel, white noise having 1:

        lambda = J / |d|^2,      J = 1/K sum over k of (sum over n of q_k d e)^2.               (1)

    `left` and `changes` are what a model leaves over, e, and d, in every channel, filtered as
    `colours` say; q_k are the first K cosines over the samples. J is the long-run variance of d e
    (E. Lazarus, D. Lewis, J. Stock, M. Watson, J. Business and Economic Statistics 36, 2018:
    equal-weighted cosines), right whatever the colour of e, and where e is larger while the axis
    moves. It has K degrees of freedom. Of a channel that follows to the last bit, where no noise is,
    lambda is 1 and exact. lambda is not less than 1: of many directions that are tried a fit takes one
    in which noise happened to be weak.
    """
    found = []
    for white, change, colour in zip(left, changes, colours, strict=True):
        square = float(change @ change)
        if square == 0.0 or not colour.error.order:
            found.append(Power(1.0, math.inf))
            continue
        own = float(np.mean((on_cosines(change * white, colour.freedom)) ** 2))
        found.append(Power(max(own / square, 1.0), float(colour.freedom)))
    return found


def log_likelihood_ratios_in(powers: Sequence[Power], squares: Sequence[float]) -> list[float]:
    """
    Return ln of the likelihood ratio of a change that lowers each channel's sum of squares by so much.

    What lacks on one axis, or in one log, says nothing of the power in another one.
    """
    return [
        power.log_likelihood_ratio(square) for power, square in zip(powers, squares, strict=True)
    ]


def power_along(
    left: Sequence[Array], changes: Sequence[Array], colours: Sequence[Colour]
) -> Power:
    """
    Return equation (1) of all channels together: lambda = sum of J_c / sum of |d_c|^2.

    With nu = (sum J_c)^2 / sum(J_c^2 / K) degrees of freedom (Satterthwaite): of a size that is the same
    in all channels.
    """
    total = noisy = uncertain = 0.0
    for change, power in zip(changes, powers_along(left, changes, colours), strict=True):
        square = float(change @ change)
        own = power.value * square
        total += square
        noisy += own
        uncertain += own**2 / power.freedom
    if noisy <= 0.0:
        return Power(1.0, math.inf)
    return Power(noisy / total, noisy**2 / uncertain if uncertain > 0.0 else math.inf)


def information(systems: Sequence[Array], estimate: Fit) -> Array:
    """
    Return what white rows A_c (N, k) of all channels say of what is fitted to them jointly: (k, k).

    Least squares with noise that is not as assumed have the sandwich covariance

        (A' A)^-1 (sum over c of J_c) (A' A)^-1,

    J_c (k, k) the long-run covariance of the products A_c e_c as in equation (1); of an exact
    channel A_c' A_c. What misfit adds is in the sum (`misfit`, equation 3). This is the inverse, zero
    along what A does not show (`gram.spanning`). As in equation (1) no direction has less noise than the
    noise model says: some of k have next to none by chance, or none where k is large, and what was
    fitted would be known there to the last digit.
    """
    products = np.sum([part.T @ part for part in systems], axis=0)
    noisy = np.zeros_like(products)
    for part, white, one in zip(systems, estimate.whitened, estimate.colours, strict=True):
        if one.error.order:
            projected = on_cosines(part * white[:, None], one.freedom)
            noisy += projected.T @ projected / one.freedom
        else:
            noisy += part.T @ part
    for places, logs in misfit.of_axes([noise.state for noise in estimate.noises]):
        rows, left = ([some[place] for place in places] for some in (systems, estimate.whitened))
        noisy += misfit.covariance_of(rows, left, logs)
    basis = spanning(products)
    powers, directions = np.linalg.eigh(basis.T @ noisy @ basis)
    shown = products @ basis @ directions
    return np.asarray(shown / np.maximum(powers, 1.0) @ shown.T, np.float64)
