# SPDX-License-Identifier: Apache-2.0
"""
What a wrong model leaves over goes with the motion; noise does not.

So the noise of a motion residual is what is left of it without its projection on the motion: on the
columns q of position p, speed v, acceleration, jerk, direction s = tanh(v / v_0), v |v|, |v|, s p,
the change of s, s exp(-|v| / v_1), and a constant. With v_0 and v_1 2 % and 10 % of the largest
speed these hold nearly all that inertias, frictions (also rising or falling from rest, by direction or
position) and gravity change; of a delay they hold less than half. What the rest has as its spectrum is
that of sensors and disturbances, and of little misfit (`variance_components` has a measurement).

Assumption: the motion takes up a small part of the degrees of freedom, 11 of some hundred samples
at least.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMOOTHING_S = 0.01
"""Over which readings are averaged, so that counts do not look like speed."""

STANDS, NEAR_REST = 0.02, 0.1
"""v_0 and v_1, as shares of the largest speed."""

MOVES = 20.0
"""Range of an axis that moves at least, over the RMS of what smoothing takes away."""

FEWEST = 20
"""Samples for each column at least; with fewer there is no basis."""


def motion_basis(position: Array, rate_hz: float) -> Array:
    """
    Return orthonormal columns (n, k) that span the motion of an axis at `position` (n,), in any
    unit.

    k is 0 for an axis that stands, as what noise makes of its position is no motion, or with too few
    samples.
    """
    width = max(3, round(SMOOTHING_S * rate_hz))
    if len(position) < FEWEST * 11 or not np.ptp(position) > 0.0:
        return np.zeros((len(position), 0))
    p = _smooth(position - position.mean(), width)
    rough = float(np.std(position - position.mean() - p))
    if np.ptp(p) < MOVES * rough:
        return np.zeros((len(position), 0))
    v = _smooth(np.gradient(p), width)
    a = _smooth(np.gradient(v), width)
    fastest = float(np.abs(v).max())
    if not fastest > 0.0:
        return np.zeros((len(position), 0))
    speed = np.abs(v) / fastest
    s = np.tanh(v / (STANDS * fastest))
    columns = np.column_stack(
        [np.ones_like(p), p, v, a, np.gradient(a), s, v * speed, speed, s * p, np.gradient(s)]
        + [s * np.exp(-speed / NEAR_REST)]
    )
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, size > 1e-6 * size[0]])


def without_motion(residual: Array, basis: Array) -> Array:
    """Return a residual (n,) without its projection on orthonormal columns (n, k)."""
    return np.asarray(residual - basis @ (basis.T @ residual))


def _smooth(signal: Array, width: int) -> Array:
    kernel = np.hanning(width + 2)
    ends = np.pad(signal, width, mode='edge')
    return np.asarray(np.convolve(ends, kernel / kernel.sum(), mode='same')[width:-width])
