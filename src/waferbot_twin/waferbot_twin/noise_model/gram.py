# SPDX-License-Identifier: Apache-2.0
"""Which directions columns span, by their products A' A (k, k): no factorisation of the long A."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALLEST = 1e-7
"""Singular value, over the largest, of a direction that columns of unit length still show."""


def spanning(products: Array) -> Array:
    """
    Return W (k, r) with W' A' A W = 1, so that the columns of A W are an orthonormal basis.

    By the eigenvalues of A' A with columns of unit length. Directions that these show `SMALLEST` times
    as much as the plainest one, or less, are not among the r; columns of zeros span nothing.
    """
    scale = np.sqrt(np.diag(products))
    scale = np.where(scale == 0.0, 1.0, scale)
    size, directions = np.linalg.eigh(products / np.outer(scale, scale))
    seen = size > SMALLEST**2 * size.max(initial=0.0)
    return np.asarray(directions[:, seen] / (np.sqrt(size[seen]) * scale[:, None]))
