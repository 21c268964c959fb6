# SPDX-License-Identifier: Apache-2.0
"""
Is what a model leaves over noise, or is something of the input still in it?

Autocorrelations of N white samples are uncorrelated and normal with variance 1/N. Of m of them Ljung and
Box made one number,

    Q = N (N + 2) sum_k r_k^2 / (N - k),

which is chi-squared with m less the number of fitted coefficients degrees of freedom. The correlation of
the residual with *earlier* white input has the same variance. In a loop the input must be one that does
not come back from the residual: the commanded position, not the current.

Sources: G. M. Ljung and G. E. P. Box, Biometrika 65 (1978) 297; L. Ljung, System Identification,
2nd ed., section 16.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import correlate

Array = NDArray[np.float64]

LAGS = 48
"""Lags that are looked at: twice the order of the autoregression that whitens."""


@dataclass(frozen=True)
class Whiteness:
    """
    Of one channel: its autocorrelations of lags 1 to `LAGS` and the probability of a Q as large.

    `input_correlation` has those with the input, of lags 0 to `LAGS`, or is None where no input is
    known; `bound` is what 95 % of the correlations of white noise stay within.
    """

    autocorrelation: Array
    probability: float
    input_correlation: Array | None
    bound: float

    @property
    def input_probability(self) -> float | None:
        """Probability that the largest correlation with the input is as large, if there is none."""
        if self.input_correlation is None:
            return None
        largest = float(np.max(np.abs(self.input_correlation)))
        alone = 2.0 * stats.norm.sf(largest * 1.959964 / self.bound)
        return float(-np.expm1(len(self.input_correlation) * np.log1p(-alone)))


def whiteness(white: Array, fitted: int, white_input: Array | None = None) -> Whiteness:
    """
    Judge a whitened residual (N,), N > `LAGS`.

    `fitted` is how many coefficients the whitening took, `white_input` (N,) the input, whitened by a
    filter of its own.
    """
    own = _correlations(white, white)
    count = len(white)
    lags = np.arange(1, LAGS + 1)
    portmanteau = count * (count + 2.0) * float(np.sum(own[1:] ** 2 / (count - lags)))
    return Whiteness(
        own[1:],
        float(stats.chi2.sf(portmanteau, LAGS - fitted)),
        None if white_input is None else _correlations(white, white_input),
        1.959964 / math.sqrt(count),
    )


def _correlations(later: Array, earlier: Array) -> Array:
    """Return the correlation of `later` with `earlier` 0 to `LAGS` samples before, (LAGS + 1,)."""
    one, other = later - later.mean(), earlier - earlier.mean()
    scale = math.sqrt(float(one @ one) * float(other @ other))
    if scale == 0.0:
        return np.zeros(LAGS + 1)
    middle = len(one) - 1
    found = correlate(one, other, method='fft')[middle : middle + LAGS + 1]
    return np.asarray(found / scale, np.float64)
