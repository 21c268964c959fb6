# SPDX-License-Identifier: Apache-2.0
"""From the tuning values of a candidate to its I-variables; what they mean: `tuning.gains`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_plant import statics
from waferbot_plant.plant import Machine
from waferbot_twin.calibration.values import Values
from waferbot_twin.tuning.gains import AxisScale, Tuning, loop_gains

GAINS = ('natural_frequency_rad_s', 'damping_ratio', 'feedforward_ratio', 'integral_rate_1_s')
"""Tuning values of an axis; their names begin with that of the axis."""


def i_variables(values: Mapping[str, float], rigid: Machine, base: np.void) -> dict[str, Values]:
    """
    Return the I-variables of each axis for the tuning values of a candidate.

    `base` (a `SERVO_PARAMETERS` record) gives scaling and amplifier range. Ixx29 is the bias that
    holds the weight at home. Rounded to whole numbers, as the controller keeps them.
    """
    holding = statics.holding_currents(rigid, rigid.parameters(), {})
    found = {}
    for place, axis in enumerate(AXES):
        tuning = Tuning(*(values[f'{axis}_{name}'] for name in GAINS))
        amperes = base['amplifier_peak_current'][place] / 32768.0
        found[axis] = {
            **loop_gains(tuning, AxisScale.of(rigid, axis), base),
            'Ixx29': round(holding[axis] / amperes),
        }
    return found
