# SPDX-License-Identifier: Apache-2.0
"""The power of noise or misfit in a direction, and what a gain is worth beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Power:
    """The power of noise in a direction, and how many degrees of freedom it was estimated with."""

    value: float
    freedom: float

    @property
    def as_if_known(self) -> Power:
        """The same power, taken for the true one."""
        return Power(self.value, math.inf)

    def log_likelihood_ratio(self, squares: float, count: int = 1) -> float:
        """
        Return ln of the likelihood ratio of a change that lowers the sum of squares by so much.

        (nu + k) / 2 ln(1 + squares / (lambda nu)), that of Student's t in k dimensions, the number
        (`count`) of parameters that make the change: squares / (2 lambda) if nu is large. Antisymmetric.
        """
        size = abs(squares) / self.value
        if math.isinf(self.freedom):
            return 0.5 * math.copysign(size, squares)
        own = 0.5 * (self.freedom + count) * math.log1p(size / self.freedom)
        return math.copysign(own, squares)


class WholePower(Power):
    """
    The power of a few samples, of all of which it is found: nobody knows it any better.

    lambda = s / nu with s the sum of squares of the N that are left over, and nu = N - 1.
    """

    @classmethod
    def of(cls, left: NDArray[np.float64]) -> WholePower:
        """Take the samples (N,) that are left over."""
        freedom = len(left) - 1
        return cls(float(left @ left) / freedom, float(freedom))

    @property
    def as_if_known(self) -> Power:
        """The same power."""
        return self

    def log_likelihood_ratio(self, squares: float, count: int = 1) -> float:
        """Return N / 2 ln((s + squares) / s), the ratio of samples that each have their own variance."""
        return 0.5 * (self.freedom + 1.0) * math.log1p(squares / (self.value * self.freedom))
