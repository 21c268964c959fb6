# SPDX-License-Identifier: Apache-2.0
"""
Least squares with coloured residuals.

Residuals of real machines are correlated: friction, vibration and the controller colour them. Taken as
white, their likelihood is far too sharp and any regressor seems significant. So each channel's residual
is an autoregressive process,

    r[n] = a_1 r[n-1] + ... + a_p r[n-p] + w[n],        w white with variance s^2,

whose coefficients follow by least squares, and is compared after filtering with
1 - a_1 z^-1 - ...: generalised least squares, iterated as by Cochrane and Orcutt. With N samples per
channel the logarithm of the likelihood is, up to a constant,

    ln L = - sum over channels of N/2 (ln s^2 + <w^2> / s^2 - 1),

s^2 = <w^2>, but not less than the resolution of the channel allows (the floor).

Source: J. D. Hamilton, Time Series Analysis, Princeton 1994, chapters 5 and 8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def autoregression(residual: Array, order: int) -> Array:
    """
    Return the prediction-error filter (1, -a_1, ..., -a_p) of a residual.

    Least squares on the lagged samples (the covariance method). A small part of the variance is
    added on the diagonal, so that a residual that is nearly a line spectrum, or zero, has a filter.
    """
    if order == 0:
        return np.ones(1)
    moments = _moments(residual - residual.mean(), order)
    variance = float(moments[0, 0])
    if variance <= 0.0:
        return np.concatenate([[1.0], np.zeros(order)])
    known = moments[:order, :order] + 1e-10 * variance * np.eye(order)
    return np.concatenate([[1.0], -np.linalg.solve(known, moments[:order, order])[::-1]])


def _moments(x: Array, order: int) -> Array:
    """
    Return the sums m_ij = sum over n = p ... N - 1 of x[n - p + i] x[n - p + j], for i, j = 0 ... p.

    Down a diagonal only the first and the last product change:
    m_(i+1)(j+1) = m_ij - x[i] x[j] + x[N - p + i] x[N - p + j].
    """
    rows = len(x) - order
    first, last = x[:order], x[rows:]
    moments = np.zeros((order + 1, order + 1))
    moments[0] = np.correlate(x, x[:rows], 'valid')
    for i in range(order):
        moments[i + 1, i + 1 :] = moments[i, i:-1] - first[i] * first[i:] + last[i] * last[i:]
    return np.triu(moments) + np.triu(moments, 1).T


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
    orders: Sequence[int],
    rounds: int = 4,
) -> Fit:
    """
    Fit the signatures (N, k) of all channels to their residuals (N,).

    `orders` are those of the autoregression, 0 for white noise; `floors` are the smallest standard
    deviations of white noise that each channel can have (that of its resolution): a perfect fit is
    not infinitely likely.
    """
    count = signatures[0].shape[1]
    value = np.zeros(count)
    if not count:
        return _result(residuals, signatures, value, np.zeros((0, 0)), floors, orders)
    for _ in range(rounds):
        left = [r + s @ value for r, s in zip(residuals, signatures, strict=True)]
        filters = [autoregression(r, order) for r, order in zip(left, orders, strict=True)]
        deviations = [
            _deviation(r, taps, floor)
            for r, taps, floor in zip(left, filters, floors, strict=True)
        ]
        matrix, right = whitened(residuals, signatures, filters, deviations)
        scale = np.sqrt(np.sum(matrix**2, axis=0))
        scale[scale == 0.0] = 1.0
        solution, *_ = np.linalg.lstsq(matrix / scale, right, rcond=1e-10)
        value = solution / scale
    inverse = np.linalg.pinv((matrix / scale).T @ (matrix / scale), rcond=1e-12)
    covariance = inverse / np.outer(scale, scale)
    return _result(residuals, signatures, value, covariance, floors, orders)


def whitened(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    filters: Sequence[Array],
    deviations: Sequence[float],
) -> tuple[Array, Array]:
    """
    Return the rows A (N, k) and b (N,) of all channels, white and with a standard deviation of one.

    The value x that explains the residuals best is where |A x - b|^2 is least.
    """
    rows, right = [], []
    for r, s, taps, deviation in zip(residuals, signatures, filters, deviations, strict=True):
        order = len(taps) - 1
        rows.append(lfilter(taps, 1.0, s, axis=0)[order:] / deviation)
        right.append(-lfilter(taps, 1.0, r)[order:] / deviation)
    return np.vstack(rows), np.concatenate(right)


def _deviation(left: Array, taps: Array, floor: float) -> float:
    """Return the standard deviation of what a filter leaves, the first samples aside."""
    white = lfilter(taps, 1.0, left)[len(taps) - 1 :]
    return max(float(np.sqrt(np.mean(white**2))), floor)


def _result(
    residuals: Sequence[Array],
    signatures: Sequence[Array],
    value: Array,
    covariance: Array,
    floors: Sequence[float],
    orders: Sequence[int],
) -> Fit:
    """Judge a value of the parameters: filter, variance and likelihood anew."""
    log_likelihood, samples = 0.0, 0
    whitened, filters, deviations = [], [], []
    for r, s, floor, order in zip(residuals, signatures, floors, orders, strict=True):
        left = r + s @ value
        taps = autoregression(left, order)
        white = lfilter(taps, 1.0, left)[order:]
        square = float(np.mean(white**2))
        deviation = max(math.sqrt(square), floor)
        above = square / deviation**2 - 1.0  # zero unless the floor holds the deviation up
        log_likelihood -= len(white) * (math.log(deviation) + 0.5 * above)
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


def prediction_errors(fit: Fit, channels: Sequence[Array]) -> list[Array]:
    """Return channels (N,), each filtered by what a fit found for it, in its standard deviations."""
    return [
        lfilter(taps, 1.0, channel)[len(taps) - 1 :] / deviation
        for channel, taps, deviation in zip(channels, fit.filters, fit.deviations, strict=True)
    ]
