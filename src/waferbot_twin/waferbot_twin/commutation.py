# SPDX-License-Identifier: Apache-2.0
"""
What makes force in three phases, and what does not: projections on the commutation's sine.

A command I stands for line quantities I sin(theta - 2 pi (k - 1) / 3), k = 1, 2, 3, with theta the
electrical angle that the amplifier uses: newest counts, held between messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np


def electrical_angle(
    ticks: np.ndarray, axis: int, amplifier: np.void, encoders: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return theta in rad at ticks, from (ticks, counts) of the encoders' messages."""
    encoder = amplifier['commutation_encoder'][axis]
    rows = np.searchsorted(encoders[0], ticks, side='right') - 1
    counts = encoders[1][np.maximum(rows, 0), encoder]
    cycle = amplifier['counts_per_electrical_cycle'][axis]
    turn = counts / cycle + amplifier['commutation_offset_turn'][axis]
    return 2.0 * np.pi * (turn % 1.0)


def driving_part(phases: Sequence[np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return 2/3 sum_k x_k sin(theta - 2 pi (k - 1) / 3): I of the three lines of a command I."""
    return _projection(phases, theta, np.sin)


def direct_part(phases: Sequence[np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return 2/3 sum_k x_k cos(theta - 2 pi (k - 1) / 3): what stands across it, without force."""
    return _projection(phases, theta, np.cos)


def _projection(
    phases: Sequence[np.ndarray], theta: np.ndarray, shape: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    projected = sum(
        value * shape(theta - 2.0 * np.pi * phase / 3.0) for phase, value in enumerate(phases)
    )
    return np.asarray(2.0 / 3.0 * projected)


def three_lines(two_lines: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the line currents of an axis from the two that are measured of each (Kirchhoff)."""
    one, two = two_lines[:, 2 * axis], two_lines[:, 2 * axis + 1]
    return one, two, -(one + two)
