# SPDX-License-Identifier: Apache-2.0
"""
What an autoregression leaves of the colour of noise, by its spectrum.

An autoregression of order p at a sampling rate f_s tells frequencies apart that are f_s / p from
one another. Slow forces, below some Hz, it does not see: they raise the spectrum of its residual
at the lowest frequencies by a factor of ten and more and hardly change its autocorrelation.
Parameters that show there, such as a force constant by the weight that it holds, then seem better
known than they are. So the residual's periodogram is averaged over bands that grow with frequency.
What is compared is divided by its square root, frequency by frequency (`Whitening`), or left as it
is, and how far its noise moves what is fitted to it is found with that spectrum (`information`).

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
from scipy.fft import dct, rfft

from waferbot_twin.noise_model import misfit
from waferbot_twin.noise_model.gram import SMALLEST, spanning
from waferbot_twin.noise_model.leverage import Leverage, sums_of
from waferbot_twin.noise_model.power import Power
from waferbot_twin.noise_model.prediction_error import (
    FEWEST_FREEDOM,
    Colour,
    Fit,
    prediction_errors,
)

Array = NDArray[np.float64]

FEWEST = 4
"""Lines that are averaged on either side at the lowest frequencies."""

KEPT = 4_000_000
"""Values of cosines that are kept for logs of one length: more are summed by a transform."""

BAND = 0.25
"""Half of a band, as a share of its middle frequency."""


@functools.lru_cache(64)
def _bands(lines: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the last line of the band over which each of some lines is averaged."""
    place = np.arange(lines)
    reach = np.maximum(FEWEST, np.round(BAND * place)).astype(np.intp)
    return np.maximum(place - reach, 1), np.minimum(place + reach, lines - 1)


def spectrum(white: Array) -> Array:
    """
    Return the averaged periodogram of N samples at the N // 2 + 1 frequencies of their transform.

    White noise of unit variance has 1 everywhere. The mean is not noise, so the line at zero has
    the average of the lines above it.
    """
    return _averaged(np.abs(rfft(white - white.mean())) ** 2 / len(white))


def _averaged(lines: Array) -> Array:
    """Return the average of lines over the band of each."""
    sums = np.concatenate([[0.0], np.cumsum(lines)])
    first, last = _bands(len(lines))
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
    left: Sequence[Array],
    changes: Sequence[Array],
    colours: Sequence[Colour],
    leverages: Sequence[Leverage | None] = (),
) -> list[Power]:
    """
    Return the power of the noise in a direction d, channel by channel, white noise having 1.

    `left` and `changes` are what a model leaves over, e, and d, in every channel, filtered as `colours`
    say. The power is found in two ways, each relative to what white noise would have of it without what
    lies along d, and without what the fit has taken of it otherwise: by its columns U (`leverages`,
    `leverage.Leverage`), or nothing where these are not known. Where the axis moves, d is:

        lambda = sum over k of (sum over n of q_k d e)^2 / tr A,                                   (1)
        A = C - v v' / |d|^2 - G G',   C_kl = sum over n of q_k q_l d^2,   v_k = sum over n of q_k d^2,
        G_kj = sum over n of q_k d U_j - v_k (U_j' d) / |d|^2,

    q_k the first K cosines over the samples: the long-run variance of d e (E. Lazarus, D. Lewis,
    J. Stock, M. Watson, J. Business and Economic Statistics 36, 2018: equal-weighted cosines), right
    whatever the colour of e, and where e is larger while the axis moves. It has (tr A)^2 / |A|^2 degrees
    of freedom (Satterthwaite): K where d is all over the log, two or three where the axis moves once and
    shortly. And in all of the log, by the averaged periodogram S of e and the transform D of d,

        lambda = sum over f of S |D|^2 / sum over f of |D|^2.                                      (2)

    That knows nothing of when noise is large, but slow noise, of which a short motion alone shows next
    to nothing; so S is the likeliest spectrum while the axis moves (`noise_beside_fit`) where that makes
    more of it. Each misses what the other one sees, so it is the larger of the two, with the degrees of
    freedom of the one that has more, K at most. Of a channel that follows to the last bit, where no
    noise is, lambda is 1 and exact. lambda is not less than 1: of many directions that are tried a fit
    takes one in which noise happened to be weak.

    What an autoregression can see is white already. So both are found of sums over half as many samples
    as it has coefficients (`Colour.block`), which takes less time.
    """
    found = []
    known = leverages or [None] * len(colours)
    for white, change, colour, own in zip(left, changes, colours, known, strict=True):
        square = float(change @ change)
        if not colour.error.order or square == 0.0:
            found.append(Power(1.0, math.inf))
            continue
        rest = white - float(change @ white) / square * change
        both = (
            _where_it_moves(rest, change, colour, own),
            _by_spectrum(rest, change, colour, own),
        )
        freedom = max(one.freedom for one in both)
        value = max(1.0, *(one.value for one in both))
        found.append(Power(value, min(freedom, float(colour.freedom))))
    return found


def _where_it_moves(
    left: Array, change: Array, colour: Colour, leverage: Leverage | None
) -> Power:
    """Return equation (1) of a channel, in sums over blocks of samples."""
    block = colour.block
    moves, square = sums_of(change * left, block), sums_of(change**2, block)
    count = min(colour.freedom, (len(square) - 1) // 2)
    sums = on_cosines(moves, count)
    lags = np.concatenate([[square.sum()], on_cosines(square, 2 * count) / math.sqrt(2.0)])
    places = np.arange(1, count + 1)
    products = lags[np.abs(places[:, None] - places)] + lags[places[:, None] + places]
    products -= np.outer(lags[places], lags[places]) * (2.0 / lags[0])
    if leverage is not None:
        slow = leverage.along(sums_of(change, block))
        along = math.sqrt(2.0) * np.outer(lags[places], slow.sum(axis=0) / lags[0])
        taken = on_cosines(slow, count) - along
        products -= taken @ taken.T
    white = float(np.trace(products))
    if white <= SMALLEST * count * lags[0]:  # all of it is in one block, and lies along d
        return Power(0.0, 0.0)
    return Power(float(sums @ sums) / white, white**2 / float(np.sum(products**2)))


def _by_spectrum(left: Array, change: Array, colour: Colour, leverage: Leverage | None) -> Power:
    """Return equation (2) of a channel; noise is white above what sums over blocks of samples show."""
    block, square = colour.block, float(change @ change)
    slow = sums_of(left, block) / math.sqrt(block)
    along = sums_of(change, block) / math.sqrt(block * square)
    lines = np.abs(rfft(along)) ** 2
    weights = _twice(len(slow)) * lines / len(slow)
    fast = max(1.0 - float(weights.sum()), 0.0)
    first, last = _bands(len(lines))
    # How much each line of the periodogram counts: in every band that it is in.
    shares, size = weights / (last - first + 1), len(lines) + 1
    counts = np.cumsum(np.bincount(first, shares, size) - np.bincount(last + 1, shares, size))[:-1]
    taken = lines / len(slow)
    if leverage is not None:
        taken = np.minimum(taken + leverage.lines_without(along), 1.0)
    white = float(counts @ (1.0 - taken)) + fast
    uncertain = float(counts @ counts)
    freedom = 2.0 * (float(counts.sum()) + fast) ** 2 / uncertain if uncertain else math.inf
    value = (float(weights @ spectrum(slow)) + fast) / white
    if leverage is not None and len(leverage.while_moving):
        value = max(value, float(weights @ leverage.while_moving) + fast)
    return Power(value, freedom)


def _twice(count: int) -> Array:
    """Return how often each line of the transform of so many real samples is one of the whole of it."""
    twice = np.full(count // 2 + 1, 2.0)
    twice[0] = 1.0
    if count % 2 == 0:
        twice[-1] = 1.0
    return twice


def log_likelihood_ratios_in(powers: Sequence[Power], squares: Sequence[float]) -> list[float]:
    """
    Return ln of the likelihood ratio of a change that lowers each channel's sum of squares by so much.

    What lacks on one axis, or in one log, says nothing of the power in another one.
    """
    return [
        power.log_likelihood_ratio(square) for power, square in zip(powers, squares, strict=True)
    ]


def power_along(
    left: Sequence[Array],
    changes: Sequence[Array],
    colours: Sequence[Colour],
    leverages: Sequence[Leverage | None] = (),
) -> Power:
    """Return the power of all channels together (`together`)."""
    return together(powers_along(left, changes, colours, leverages), changes)


def together(powers: Sequence[Power], changes: Sequence[Array]) -> Power:
    """
    Return the power of all channels together: lambda = sum of lambda_c |d_c|^2 / sum of |d_c|^2.

    With nu = (sum J_c)^2 / sum(J_c^2 / nu_c) degrees of freedom, J_c = lambda_c |d_c|^2 (Satterthwaite):
    of a size that is the same in all channels.
    """
    total = noisy = uncertain = 0.0
    for change, power in zip(changes, powers, strict=True):
        square = float(change @ change)
        own = power.value * square
        total += square
        noisy += own
        uncertain += own**2 / power.freedom
    if noisy <= 0.0:
        return Power(1.0, math.inf)
    return Power(noisy / total, noisy**2 / uncertain if uncertain > 0.0 else math.inf)


def information(systems: Sequence[Array], estimate: Fit, leverages: Sequence[Leverage]) -> Array:
    """
    Return what white rows A_c (N, k) of all channels say of what is fitted to them jointly: (k, k).

    Least squares with noise that is not as assumed have the sandwich covariance

        (A' A)^-1 (sum over c of J_c) (A' A)^-1,                                                    (3)

    J_c (k, k) the covariance of A_c' e_c: of an exact channel A_c' A_c, else along any direction the
    larger one of the two that `powers_along` has, of the products A_c e_c by cosines and by the averaged
    periodogram of e_c, each over what white noise would have of it beside the fit (`leverage`). What
    misfit adds is in the sum (`misfit`, equation 3). This is the inverse, zero
    along what A does not show (`gram.spanning`). No direction has less noise than the noise model says:
    some of k have next to none by chance, or none where k is large, and what was fitted would be known
    there to the last digit.
    """
    products = np.sum([part.T @ part for part in systems], axis=0)
    moving, white, slow, more = (np.zeros_like(products) for _ in range(4))
    for part, left, colour, own in zip(
        systems, estimate.whitened, estimate.colours, leverages, strict=True
    ):
        if colour.error.order:
            projected = on_cosines(part * left[:, None], colour.freedom)
            moving += projected.T @ projected / len(projected)
            white += _of_white_noise(part, own, len(projected))
            slow += _covariance_by_spectrum(part, left, own)
        else:
            more += part.T @ part
    for places, logs in misfit.of_axes([noise.state for noise in estimate.noises]):
        taken = misfit.taken_by([leverages[place].of_state for place in places])
        more += misfit.covariance_of(
            [systems[place] for place in places],
            [estimate.whitened[place] for place in places],
            logs,
            taken,
        )
    basis = spanning(products)
    moving, white, slow, more = (basis.T @ one @ basis for one in (moving, white, slow, more))
    least = np.eye(len(more))
    moving = _relative(moving, white, FEWEST_FREEDOM)
    noisy = _larger(_larger(moving, slow) + more, least)
    shown = products @ basis
    return np.asarray(shown @ np.linalg.solve(noisy, shown.T), np.float64)


def _of_white_noise(rows: Array, leverage: Leverage, count: int) -> Array:
    """Return the covariance (k, k) of A' e by K = `count` cosines where noise is white, beside a fit."""
    angles = (np.arange(len(rows)) + 0.5) * (math.pi / len(rows))
    waves = np.sin(count * angles) * np.cos((count + 1) * angles) / np.sin(angles)
    found = (rows * (1.0 + waves / count)[:, None]).T @ rows
    taken = [on_cosines(leverage.along(part), count) for part in sums_of(rows, leverage.block).T]
    products = np.reshape(taken, (len(found), -1))
    return np.asarray(found - products @ products.T / count)


def _relative(found: Array, white: Array, count: int) -> Array:
    """
    Return a covariance over what white noise would have of it, in directions in which that had one.

    C found C' with C white C' = 1; of a direction in which less than one of `count` degrees of freedom
    is left of white noise, no more than one.
    """
    size, directions = np.linalg.eigh(white)
    root = directions / np.sqrt(np.maximum(size, 1.0 / count))
    both = root @ directions.T
    return np.asarray(both @ found @ both)


def _covariance_by_spectrum(rows: Array, left: Array, leverage: Leverage) -> Array:
    """Return the covariance (k, k) of A' e for e with the averaged periodogram of what is left over."""
    block = leverage.block
    slow, own = (sums_of(some, block) / math.sqrt(block) for some in (left, rows))
    power = spectrum(slow) / np.maximum(1.0 - _averaged(leverage.lines), 1.0 / len(slow))
    if len(leverage.while_moving):
        power = np.maximum(power, leverage.while_moving)
    lines = rfft(own, axis=0)
    weights = _twice(len(slow)) * (power - 1.0) / len(slow)
    more = (lines.conj() * weights[:, None]).T @ lines
    return np.asarray(rows.T @ rows + more.real)


def _larger(one: Array, other: Array) -> Array:
    """
    Return the covariance that is the larger of two along every direction in which they are apart.

    With R R' the sum of both, the eigenvalues of R^-1 (one) R^-T are shares m, those of the other 1 - m,
    with the same directions: each has the larger of the two.
    """
    total = one + other
    size, directions = np.linalg.eigh(total)
    root = directions * np.sqrt(np.maximum(size, 0.0))
    back = np.linalg.pinv(root)
    shares, common = np.linalg.eigh(back @ one @ back.T)
    both = root @ common
    return np.asarray((both * np.maximum(shares, 1.0 - shares)) @ both.T)
