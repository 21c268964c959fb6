# SPDX-License-Identifier: Apache-2.0
"""
What a fit takes of the noise: the more is fitted, the less is left over, of slow noise most of all.

Least squares of N white samples with a prior of precision P leave of noise, and of what the values are
beside that prior, e with the covariance

    cov e = 1 - U U',        U = A (A' A + P)^-1/2,                                               (1)

A (N, k) the white signatures of all that is fitted. So a power that is found in e is one relative to
what white noise would leave there, not to one. In a log of a second an axis moves for half of it, and
noise that is slower than 10 Hz has ten degrees of freedom in that time; five parameters take up to half
of them.

Sources: H. D. Patterson, R. Thompson, Biometrika 58, 1971 (restricted maximum likelihood); for
covariances that are found of what is left over R. M. Bell, D. F. McCaffrey, Survey Methodology 28, 2002
(bias-reduced linearisation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from waferbot_twin.noise_model.gram import spanning

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Leverage:
    """
    The columns U (N, k) of equation (1) in a channel, as `sums` (n, k) over a `block` of samples.

    And their products (m, k) with the functions of the state of its axis (`misfit`), none without; and
    the spectrum (n // 2 + 1,) of the noise while that moves (`noise_beside_fit`), empty if not known.
    """

    sums: Array
    block: int
    of_state: Array = field(default_factory=lambda: np.zeros((0, 0)))
    while_moving: Array = field(default_factory=lambda: np.zeros(0))

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to another process without the transform: it is found there sooner than sent."""
        return Leverage, (self.sums, self.block, self.of_state, self.while_moving)

    def along(self, change: Array) -> Array:
        """Return products (n, k) of U with sums (n,) over the same blocks, block by block."""
        return change[:, None] * self.sums / self.block

    @property
    def lines(self) -> Array:
        """The share of every line of white noise that U takes: sum over j of |F U_j|^2 / n."""
        return self._squares / len(self.sums)

    def lines_within(self, window: Array) -> Array:
        """Return what `lines` are of noise within a window (n,) of mean square one."""
        columns = window[:, None] * self.sums / math.sqrt(self.block)
        return np.asarray(np.sum(np.abs(rfft(columns, axis=0)) ** 2, axis=1) / len(window))

    def lines_without(self, direction: Array) -> Array:
        """
        Return what `lines` are of U without its part along a direction d of length one.

        sum over j of |F (U_j - d d' U_j)|^2 / n, d (n,) in sums over blocks over the root of their
        length.
        """
        count = len(direction)
        along = direction @ self.sums / math.sqrt(self.block)
        both = rfft(direction)
        cross = (both.conj() * (self._lines @ along)).real
        total = self._squares - 2.0 * cross + np.abs(both) ** 2 * float(along @ along)
        return np.asarray(total / count, np.float64)

    @cached_property
    def _lines(self) -> NDArray[np.complex128]:
        return np.asarray(rfft(self.sums, axis=0) / math.sqrt(self.block), np.complex128)

    @cached_property
    def _squares(self) -> Array:
        return np.asarray(np.sum(np.abs(self._lines) ** 2, axis=1), np.float64)


def directions_of(rows: Sequence[Array], prior: Array) -> Array:
    """
    Return (A' A + P)^-1/2 of equation (1), (k, r).

    `rows` (N, k) are the white signatures in all channels, `prior` (k,) is the precision of every
    parameter.
    """
    return spanning(np.sum([part.T @ part for part in rows], axis=0) + np.diag(prior))


def sums_of(samples: Array, block: int) -> Array:
    """Return the sums of samples (N,) or (N, k) over blocks; the last one may be shorter."""
    if block == 1:
        return samples
    return np.asarray(np.add.reduceat(samples, np.arange(0, len(samples), block), axis=0))
