# SPDX-License-Identifier: Apache-2.0
"""
What is known of parameters from other logs of the same machine, put together with what these logs say.

These logs give estimates m with the covariance V; of some of them, H m, values v are known with the
independent errors S. Together (generalised least squares, as a reading more: H. Theil, A. Goldberger,
International Economic Review 2, 1961)

    K = V H' (H V H' + S)^-1,    m+ = m + K (v - H m),    V+ = V - K H V.                          (1)

What was known has been through a prior as well, with the precision 1/s^2 about m_0. It is taken off, or
it would count twice:

    1/S = 1/e^2 - 1/s^2,         v = S (value / e^2 - m_0 / s^2).                                  (2)

A machine changes, and what is known may be of another temperature. A value that is further from these
logs than chance would have it, |v - m| > 3.29 sqrt(V + S) (probability 0.001), is left out and told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from waferbot_twin.residuals.record import Array

DISAGREES = float(norm.isf(0.5e-3))
"""Standard errors of equation (1) from which on two estimates are of different things."""

LEAST = 1e-3
"""Precision in (2), in that of the value, below which a value says nothing but the prior."""


@dataclass(frozen=True)
class Known:
    """A value that is known with a standard error, in the unit of the parameter; `origin` in words."""

    value: float
    error: float
    origin: str = ''


def without_prior(known: Known, centre: float, precision: float) -> Known | None:
    """Return a value without the prior that it has been through, equation (2); None if that was all."""
    own = known.error**-2.0
    left = own - precision
    if not left > LEAST * own:
        return None
    return Known((known.value * own - centre * precision) / left, left**-0.5, known.origin)


def disagree(known: Known, value: float, variance: float) -> bool:
    """Tell whether a value is further from an estimate with that variance than chance would have it."""
    return abs(known.value - value) > DISAGREES * np.sqrt(variance + known.error**2)


def together(
    values: Array, covariance: Array, places: list[int], known: list[Known]
) -> tuple[Array, Array]:
    """
    Return estimates (k,) and their covariance (k, k) with some of them known, equation (1).

    `places` are those of the known ones among the estimates.
    """
    if not known:
        return values, covariance
    aside = np.array([one.value for one in known]) - values[places]
    inner = covariance[np.ix_(places, places)] + np.diag([one.error**2 for one in known])
    # Scaled: parameters are in units of their own.
    unit = np.sqrt(np.diag(inner))
    scaled = np.linalg.inv(inner / np.outer(unit, unit)) / np.outer(unit, unit)
    weights = covariance[:, places] @ scaled
    better = covariance - weights @ covariance[places]
    return values + weights @ aside, 0.5 * (better + better.T)
