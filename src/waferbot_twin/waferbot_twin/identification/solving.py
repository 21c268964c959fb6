# SPDX-License-Identifier: Apache-2.0
"""Least squares through a simulation that some values make impossible."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError

Array = NDArray[np.float64]
Function = Callable[[Array], Array]

IMPOSSIBLE = 1e6
"""Residual in place of one of a model that cannot be simulated."""

MARGIN = 1e-4
"""How far inside its bounds a fit begins, as a share of their distance."""


def least_squares(
    residual: Function,
    derivative: Function,
    start: Array,
    bounds: tuple[Array, Array],
    evaluations: int,
    tolerance: float,
) -> tuple[Array, Array]:
    """
    Return the values (k,) with the least squares of `residual`, and its derivatives (N, k) there.

    Trust region reflective (scipy), within `bounds`. A `residual` that raises `UserError` counts as very
    large, but not at the start, where the error goes on; `derivative` must not raise any. It stops after
    so many `evaluations`, or where a step changes values or squares relatively by less than `tolerance`.
    """
    low, high = bounds
    inside = np.clip(start, low + MARGIN * (high - low), high - MARGIN * (high - low))
    length = len(residual(inside))

    def possible(values: Array) -> Array:
        try:
            return residual(values)
        except UserError:
            return np.full(length, IMPOSSIBLE)

    result = scipy.optimize.least_squares(
        possible,
        inside,
        derivative,
        bounds,
        max_nfev=evaluations,
        xtol=tolerance,
        ftol=tolerance,
    )
    return np.asarray(result.x, np.float64), np.asarray(result.jac, np.float64)
