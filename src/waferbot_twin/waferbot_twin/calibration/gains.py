# SPDX-License-Identifier: Apache-2.0
"""
From tuning values to I-variables.

Tuning values are the loop's natural frequency wn, damping ratio z, feedforward ratio v and integral
rate k as an ideal rigid axis would have them:

    Ixx30 = 2^19 wn^2 M / (K Ixx08 c Ka)    Ixx31 = 128 (2 z / wn) / Ts
    Ixx32 = v Ixx31                          Ixx33 = 2^23 k Ts

with M the moving mass or inertia, K force or torque at the axis per ampere, c counts per unit, Ka
amperes per DAC unit, Ts the servo cycle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant import motors, plant, statics
from waferbot_plant.plant import Machine
from waferbot_twin.calibration.values import Values

GAINS = ('natural_frequency_rad_s', 'damping_ratio', 'feedforward_ratio', 'integral_rate_1_s')
"""Tuning values of an axis; their names begin with that of the axis."""


def i_variables(values: Mapping[str, float], rigid: Machine, base: np.void) -> dict[str, Values]:
    """
    Return the I-variables of each axis for the tuning values of a candidate.

    `base` (a `SERVO_PARAMETERS` record) gives scaling and amplifier range. Ixx29 is the bias that
    holds the weight at home. Rounded to whole numbers, as the controller keeps them.
    """
    parameters = rigid.parameters()
    state = rigid.initial_state(parameters)
    size = len(rigid.coordinates)
    mass = np.zeros((size, size))
    plant.mass_matrix(state, parameters, mass)
    holding = statics.holding_currents(rigid, parameters, {})
    cycle_s = rigid.timing.servo_divider * rigid.timing.tick_s
    found = {}
    for place, axis in enumerate(AXES):
        wn, z, v, k = (values[f'{axis}_{name}'] for name in GAINS)
        motor = rigid.description.motors[axis]
        row, _ = rigid.assembly.placing[rigid.description.axes[axis]]
        ratio = rigid.assembly.placing[motor.coordinate][1]
        force = motors.force_constant(motor) * abs(ratio)
        amperes = base['amplifier_peak_current'][place] / 32768.0
        scale = force * base['Ixx08'][place] * base['counts_per_unit'][place] * amperes
        derivative = 128.0 * (2.0 * z / wn) / cycle_s
        found[axis] = {
            'Ixx30': round(2.0**19 * wn**2 * mass[row, row] / scale),
            'Ixx31': round(derivative),
            'Ixx32': round(v * derivative),
            'Ixx33': round(2.0**23 * k * cycle_s),
            'Ixx29': round(holding[axis] / amperes),
        }
    return found
