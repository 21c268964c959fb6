# SPDX-License-Identifier: Apache-2.0
"""
Current sensors: what the amplifier gets to know of the line currents.

Lines 1 and 2 of each motor have a sensor; the third current is taken as minus the sum of the two.
Perfect unless the description names their errors:

    measured_k = (1 + gain_k) i_k + offset_k + noise_k        k = 1, 2, in A

`gain_k` is a relative error, `noise` the rms of white noise, a new value for each line at each tick.
An amplifier closes its loop on what is measured, so errors turn into errors of the true currents of
the opposite sign. For a current vector of amplitude I at the electrical angle theta: an offset makes
a force ripple of one period per electrical cycle; unequal gains one of two periods, relative
amplitude (gain_1 - gain_2) / sqrt(3), and a loss of mean force of (gain_1 + gain_2) / 2.

Source of the two ripples: S.-H. Song, J.-W. Choi, S.-K. Sul, Current measurements in digitally
controlled AC drives, IEEE Industry Applications Magazine 6(4), 2000.
"""

from __future__ import annotations

from typing import Any

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.noise import normal
from waferbot_plant.description import CurrentSensors
from waferbot_plant.motors import measure_line_currents

LINES = 2
"""Lines of a motor that have a sensor."""

NOISE_CHANNEL = 2000
"""Channel of the noise of line 1 of the first motor; the others follow, line by line."""


def parameter_fields(motors: int) -> list[tuple]:
    """
    Return the parameters of the current sensors of so many motors.

    Whether the sensors of a motor have errors at all; relative gain errors; offsets and rms noise in A.
    """
    return [
        ('current_imperfect', 'i8', (motors,)),
        ('current_gain_error', 'f8', (motors, LINES)),
        ('current_offset', 'f8', (motors, LINES)),
        ('current_noise', 'f8', (motors,)),
        ('current_noise_seed', 'i8', (motors,)),
    ]


def sensor_data(sensors: CurrentSensors) -> dict[str, Any]:
    """Return the parameters of a motor's current sensors by their names."""
    return {
        'current_imperfect': any((*sensors.gains, *sensors.offsets, sensors.noise)),
        'current_gain_error': sensors.gains,
        'current_offset': sensors.offsets,
        'current_noise': sensors.noise,
        'current_noise_seed': sensors.noise_seed,
    }


@compiled
def measure_currents(s, p, tick, line_currents):
    """Fill `line_currents` (2 axes,) with lines 1 and 2 of each motor as measured at `tick`, A."""
    measure_line_currents(s, p, line_currents)
    for motor in range(len(p['winding'])):
        if not p['current_imperfect'][motor]:
            continue
        noise = p['current_noise'][motor]
        for line in range(LINES):
            place = LINES * motor + line
            measured = (1.0 + p['current_gain_error'][motor, line]) * line_currents[place]
            measured += p['current_offset'][motor, line]
            if noise > 0.0:
                seed = p['current_noise_seed'][motor]
                measured += noise * normal(seed, NOISE_CHANNEL + place, tick)
            line_currents[place] = measured


@compiled
def true_current(p, motor, line, measured):
    """Return the current (A) of line 0 or 1 of a motor that was measured, without the noise."""
    return (measured - p['current_offset'][motor, line]) / (
        1.0 + p['current_gain_error'][motor, line]
    )
