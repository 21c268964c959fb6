# SPDX-License-Identifier: Apache-2.0
"""
The test of a gearbox on a bench: what it loses at constant speed and constant load.

With n the speed of the input, T_in the torque into it and T_out that out of it, both positive the way
the input turns at n > 0, and i the ratio (turns of the input per turn of the output, negative if it
turns round), the loss referred to the input is

    T_loss = (T_in - T_out / i) sign(n),

the same whether the motor drives (T_in n > 0) or the load does (T_in n < 0). A point of the test is the
mean over whole turns of the output, so that what repeats with a turn is not in it. Its standard error
is from the means of up to `BLOCKS` stretches of the point, which see what is slower than a sample.

Limits: an error of the torque sensors' zero is in every point, forward and backward with opposite
signs; the mean of both directions is free of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.text import read_text

Array = NDArray[np.float64]

BLOCKS = 10

COLUMNS = ('speed_rad_s', 'input_torque_nm', 'output_torque_nm')
POINT = 'point'


@dataclass(frozen=True)
class Points:
    """
    Operating points, each array (points,): means of `speed` in rad/s, `torque` in and `loss` in Nm.

    `error` is the standard error of the loss, Nm, NaN where a point is a single row.
    """

    speed: Array
    torque: Array
    loss: Array
    error: Array

    @property
    def load(self) -> Array:
        """Magnitude of the torque into the gearbox, Nm."""
        return np.abs(self.torque)

    @property
    def driving(self) -> NDArray[np.bool_]:
        """Whether the motor drives the load, not the load the motor."""
        return self.torque * self.speed > 0.0


def read_points(path: Path, ratio: float) -> Points:
    """
    Read a test from a text file with the `COLUMNS`, rad/s and Nm, and perhaps a column `point`.

    Rows with the same `point` are samples of one, in the order of time; without that column each row is
    a point. Raises `UserError` if the file cannot be read, lacks a column or has a gap in one.
    """
    if not np.isfinite(ratio) or ratio == 0.0:
        raise UserError(f'the ratio is {ratio}; it must be a number other than zero')
    table = read_text(path)
    values = np.column_stack([table.column(name).value for name in COLUMNS])
    rows = np.arange(len(values), dtype=float)
    labels = table.column(POINT).value if POINT in table.names else rows
    gap = ~np.isfinite(np.column_stack([values, labels])).all(axis=1)
    if gap.any():
        raise UserError(f'{table.place_of()(int(np.argmax(gap)))}: a value is missing')
    return points_of(labels, values[:, 0], values[:, 1], values[:, 2], ratio)


def points_of(
    labels: Array, speed: Array, torque_in: Array, torque_out: Array, ratio: float
) -> Points:
    """
    Return the points of samples (n,), in rad/s and Nm, that have the labels (n,) of their points.

    Raises `UserError` if a point stands still.
    """
    rows = []
    for label in dict.fromkeys(labels.tolist()):
        own = labels == label
        mean_speed = float(speed[own].mean())
        if mean_speed == 0.0:
            raise UserError(f'point {label:g} stands still; a loss is measured while it turns')
        loss = (torque_in[own] - torque_out[own] / ratio) * np.sign(mean_speed)
        rows.append(
            (mean_speed, float(torque_in[own].mean()), float(loss.mean()), standard_error(loss))
        )
    return Points(*np.array(rows, float).T)


def standard_error(samples: Array) -> float:
    """Return the standard error of the mean of samples (n,), from those of blocks; NaN of one sample."""
    blocks = min(BLOCKS, len(samples))
    if blocks < 2:
        return float('nan')
    means = [block.mean() for block in np.array_split(samples, blocks)]
    return float(np.std(means, ddof=1) / np.sqrt(blocks))
