# SPDX-License-Identifier: Apache-2.0
"""
Where the motors were at every tick, from the counts of their encoders.

Windings feel the speed: their back-EMF is a flux that changes, so an error dx of the position, which
counts have, is an error k dx / L of the current. Positions are smoothed by a polynomial over some rows
(Savitzky and Golay; it does not delay), brought from when they were published to when they were read,
and joined by a cubic spline. The last readings of a log are published behind its end: there a motor goes
on as fast as it last did.

**Over how many rows** follows from what predicts each reading best from the others (leave-one-out
cross-validation, P. Craven, G. Wahba, Numerische Mathematik 31, 1979): with the weight s_0 that a
reading has in its own smoothed value, the least mean over the readings of

    ((x - x_smoothed) / (1 - s_0))^2.                                                             (1)

There a twelfth of the mean square error is motion that is lost, and that goes with the current which
makes it: a sensor's gain seems wrong. Over half as many rows, which are taken, noise is double, and the
square of what is lost, of the order 2 (degree + 1), 4096 times less.

An axis that moves fast needs the fewest rows, which lose nothing that is slower than a millisecond. Of
one that stands and whose encoder goes to and fro between two counts these would leave a motion that is
none; its windings then seem to have less back-EMF, as that makes less of it: 9 % less and more
(attenuation by errors in the variables).

Source: A. Savitzky, M. J. E. Golay, Smoothing and differentiation of data by simplified least squares
procedures, Analytical Chemistry 36(8), 1964.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_coeffs, savgol_filter

from waferbot_plant import encoders
from waferbot_plant.windings import motor_positions
from waferbot_twin.residuals.record import Array, Record, common_step

FEWEST, DEGREE = 15, 5
"""
Encoder rows that a reading is smoothed over at least, 1.7 ms, and the degree of the polynomial.

A cubic over 1.2 ms (as noisy as a quintic over 2.1 ms) loses so much of a fast motor's motion that
the currents seem 0.03 % wrong, which in a quiet log is a cause; this one leaves half of that. Over
less there is little to win, and the counts show.
"""


DELAYS = ('encoder_delay', 'delay_fraction')
"""Parameters of encoders that move no reading."""

KEPT = 4
"""Motions that are kept, 24 bytes for each reading."""


class MotorMotion:
    """The motion of the motors in a log."""

    def __init__(self, record: Record) -> None:
        """Take the counts of encoders without a gap; the others are taken as 0."""
        self._timing = record.timing
        self._ticks = record.ticks
        counts = record.reading.copy()
        if record.whole_counts:  # rounded down to a whole step
            counts += [0.5 * max(1, common_step(column)) for column in counts.T]
        counts[:, ~np.isfinite(counts).all(axis=0)] = 0.0
        self._counts = counts
        self._rows = [rows_to_smooth(column) for column in counts.T]
        self._smoothed: dict[bytes, Array] = {}

    def positions(self, parameters: np.ndarray) -> Array:
        """
        Return the positions (ticks + 1, 3) of the motors, m or rad, at every tick and behind the last.

        As the encoders of `parameters` (`windings`) see them.
        """
        p = parameters[0]
        read = self._at_readings(parameters)
        rows = np.arange(self._ticks + 1) / self._timing.encoder_divider
        position = np.zeros((self._ticks + 1, read.shape[1]))
        for encoder in range(len(p['encoder_delay'])):
            if p['counts_per_unit'][encoder] == 0.0:
                continue
            motor = p['encoder_coordinate'][encoder]
            late = p['encoder_delay'][encoder] + p['delay_fraction'][encoder]
            last = len(read) - 1
            behind = np.maximum(rows + late - last, 0.0)
            speed = (read[last, motor] - read[last - FEWEST + 1, motor]) / (FEWEST - 1)
            spline = CubicSpline(np.arange(len(read)), read[:, motor])
            position[:, motor] = spline(rows + late - behind) + speed * behind
        return position

    def _at_readings(self, parameters: np.ndarray) -> Array:
        """Return the smoothed positions (readings, axes): the last are kept, fits ask for few."""
        fields = (name for name, *_ in encoders.parameter_fields(1) if name not in DELAYS)
        key = b''.join(parameters[0][name].tobytes() for name in fields)
        if key not in self._smoothed:
            while len(self._smoothed) >= KEPT:
                self._smoothed.pop(next(iter(self._smoothed)))
            read = motor_positions(parameters, self._counts)
            for encoder, rows in enumerate(self._rows):
                if parameters[0]['counts_per_unit'][encoder] != 0.0:
                    motor = parameters[0]['encoder_coordinate'][encoder]
                    read[:, motor] = savgol_filter(read[:, motor], rows, DEGREE)
            self._smoothed[key] = read
        return self._smoothed[key]


def rows_to_smooth(readings: Array) -> int:
    """Return half of the rows, but not less than the fewest, that make equation (1) least."""
    rows, found, least = FEWEST, FEWEST, np.inf
    while rows <= len(readings):
        own = savgol_coeffs(rows, DEGREE)[rows // 2]
        missed = (readings - savgol_filter(readings, rows, DEGREE)) / (1.0 - own)
        square = float(missed @ missed)
        if square >= least:
            break
        found, least, rows = rows, square, 2 * rows + 1
    return max(FEWEST, found // 2)
