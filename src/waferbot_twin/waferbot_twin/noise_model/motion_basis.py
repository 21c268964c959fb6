# SPDX-License-Identifier: Apache-2.0
"""
What a wrong model leaves over goes with the motion; noise does not.

So the noise of a motion residual is what is left of it without what goes with the motion: with the
columns q of position p, speed v, acceleration, jerk, direction s = tanh(v / v_0), v |v|, |v|, s p,
the change of s, s exp(-|v| / v_1), and a constant. With v_0 and v_1 2 % and 10 % of the largest
speed these hold nearly all that inertias, frictions (also rising or falling from rest, by direction or
position) and gravity change; of a friction that is some ms late at reversals they hold less than half.
What the rest has as its spectrum is that of sensors and disturbances, and of little misfit.

The position is smoothed first. What noise of readings is left in the columns is in the residual as well,
of the same readings, and would be taken for motion where the noise is strongest: with averages over
10 ms in place of a spline, nine tenths of what a pendulum's encoder of 3 mrad makes of the
residual at 50 Hz went.

Assumption: the motion takes up a small part of the degrees of freedom, 11 of some hundred samples
at least.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst, idst
from scipy.optimize import minimize_scalar

Array = NDArray[np.float64]

STANDS, NEAR_REST = 0.02, 0.1
"""v_0 and v_1, as shares of the largest speed."""

MOVES = 20.0
"""Range of an axis that moves at least, over the RMS of what smoothing takes away."""

FEWEST = 20
"""Samples for each column at least; with fewer there is no basis."""


def motion_basis(position: Array) -> Array:
    """
    Return orthonormal columns (n, k) that span the motion of an axis at `position` (n,), in any
    unit.

    k is 0 for an axis that stands, as what noise makes of its position is no motion, or with too few
    samples.
    """
    if len(position) < FEWEST * 11 or not np.ptp(position) > 0.0:
        return np.zeros((len(position), 0))
    p = smooth(position - position.mean())
    rough = float(np.std(position - position.mean() - p))
    if np.ptp(p) < MOVES * rough:
        return np.zeros((len(position), 0))
    v = np.gradient(p)
    a = np.gradient(v)
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


def moves(position: Array) -> NDArray[np.bool_]:
    """Return whether an axis at `position` (n,), in any unit, goes faster than v_0, sample by sample."""
    if len(position) < FEWEST:
        return np.zeros(len(position), np.bool_)
    speed = np.abs(np.gradient(smooth(position - position.mean())))
    return np.asarray(speed > STANDS * speed.max())


def smooth(position: Array) -> Array:
    """
    Return the smoothing spline of a position (n,): least sum of squares of what it leaves, and of its
    third difference times a weight w.

    Of the line between the ends, and sines over the samples beside it, so that an axis may move at the
    ends. Sine k, whose third difference has the square a_k, is kept by 1 / (1 + w a_k); w is that of
    generalised cross-validation (P. Craven, G. Wahba, Numerische Mathematik 31, 1979; in the
    frequency domain D. Garcia, Computational Statistics & Data Analysis 54, 2010). Noise of readings is
    white here.
    """
    inside = len(position) - 2
    line = np.linspace(position[0], position[-1], len(position))
    sines = dst((position - line)[1:-1], 1, norm='ortho')
    rough = (2.0 - 2.0 * np.cos(np.pi * np.arange(1, inside + 1) / (inside + 1))) ** 3

    def score(log_weight: float) -> float:
        lost = 1.0 - 1.0 / (1.0 + math.exp(log_weight) * rough)
        return float(np.mean((lost * sines) ** 2) / np.mean(lost) ** 2)

    # From half of the fastest sine to half of the slowest.
    ends = -np.log(rough[[-1, 0]])
    weight = math.exp(minimize_scalar(score, bounds=ends, method='bounded').x)
    line[1:-1] += idst(sines / (1.0 + weight * rough), 1, norm='ortho')
    return np.asarray(line, np.float64)
