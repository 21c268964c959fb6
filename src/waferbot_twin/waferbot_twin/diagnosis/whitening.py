# SPDX-License-Identifier: Apache-2.0
"""
Least squares with coloured residuals.

Residuals of real machines are correlated: friction, vibration and the controller colour them. Taken as
white, their likelihood is far too sharp and any regressor seems significant. So each channel's residual
is an autoregressive process,

    r[n] = a_1 r[n-1] + ... + a_p r[n-p] + w[n],        w white with variance s^2,

whose coefficients follow from its autocorrelation (Yule-Walker), and is compared after filtering with
1 - a_1 z^-1 - ...: generalised least squares, iterated as by Cochrane and Orcutt. With N samples per
channel the logarithm of the likelihood is, up to a constant,

    ln L = - sum over channels of N/2 ln s^2 .

Source: J. D. Hamilton, Time Series Analysis, Princeton 1994, chapters 5 and 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

Array = NDArray[np.float64]

ORDER = 24
"""Order p of the autoregressive model."""


def autoregression(residual: Array, order: int = ORDER) -> Array:
    """
    Return the prediction-error filter (1, -a_1, ..., -a_p) of a residual.

    A small part of the variance is added at lag zero, so that a residual that is nearly a line
    spectrum, or zero, has a filter too.
    """
    centred = residual - residual.mean()
    size = len(centred)
    spectrum = np.fft.rfft(centred, 2 * size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: order + 1] / size
    if correlation[0] <= 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    column = correlation[:order].copy()
    column[0] *= 1.0 + 1e-9
    return np.concatenate([[1.0], -solve_toeplitz(column, correlation[1:])])


@dataclass(frozen=True)
class Fit:
    """
    A fit of residual + signature @ value = noise.

    `value` (k,) and its covariance (k, k); `log_likelihood`; `samples` how many went in; `whitened`
    the white residual of each channel, divided by its standard deviation; `filters` and `deviations`
    those of each channel.
    """

    value: Array
    covariance: Array
    log_likelihood: float
    samples: int
    whitened: tuple[Array, ...]
    filters: tuple[Array, ...]
    deviations: tuple[float, ...]


def fit(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    floors: Sequence[float],
    order: int = ORDER,
    rounds: int = 4,
) -> Fit:
    """
    Fit the signatures (N, k) of all channels to their residuals (N,).

    `floors` are the smallest standard deviations of white noise that each channel can have (that of
    its resolution): a perfect fit is not infinitely likely.
    """
    count = signatures[0].shape[1]
    value = np.zeros(count)
    if not count:
        return _result(residuals, signatures, value, np.zeros((0, 0)), floors, order)
    for _ in range(rounds):
        left = [r + s @ value for r, s in zip(residuals, signatures, strict=True)]
        filters = [autoregression(r, order) for r in left]
        rows, right, deviations = [], [], []
        for r, s, now, taps, floor in zip(
            residuals, signatures, left, filters, floors, strict=True
        ):
            white = lfilter(taps, 1.0, now)[order:]
            deviation = max(float(np.sqrt(np.mean(white**2))), floor)
            deviations.append(deviation)
            rows.append(lfilter(taps, 1.0, s, axis=0)[order:] / deviation)
            right.append(-lfilter(taps, 1.0, r)[order:] / deviation)
        matrix = np.vstack(rows)
        scale = np.sqrt(np.sum(matrix**2, axis=0))
        scale[scale == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(matrix / scale, np.concatenate(right), rcond=1e-10)
        value = solution / scale
    inverse = np.linalg.pinv((matrix / scale).T @ (matrix / scale), rcond=1e-12)
    covariance = inverse / np.outer(scale, scale)
    return _result(residuals, signatures, value, covariance, floors, order)


def _result(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    value: Array,
    covariance: Array,
    floors: Sequence[float],
    order: int,
) -> Fit:
    """Judge a value of the parameters: filter, variance and likelihood anew."""
    log_likelihood, samples = 0.0, 0
    whitened, filters, deviations = [], [], []
    for r, s, floor in zip(residuals, signatures, floors, strict=True):
        left = r + s @ value
        taps = autoregression(left, order)
        white = lfilter(taps, 1.0, left)[order:]
        deviation = max(float(np.sqrt(np.mean(white**2))), floor)
        log_likelihood -= len(white) * np.log(deviation)
        samples += len(white)
        whitened.append(white / deviation)
        filters.append(taps)
        deviations.append(deviation)
    return Fit(
        value,
        covariance,
        log_likelihood,
        samples,
        tuple(whitened),
        tuple(filters),
        tuple(deviations),
    )
