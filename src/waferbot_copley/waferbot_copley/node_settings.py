# SPDX-License-Identifier: Apache-2.0
"""The settings of the Copley node that are none of an amplifier: axes, a device that is the clock."""

from __future__ import annotations

from waferbot_lockstep.parameters import Parameter

TWIN = 'twin'
HOLD, RAMP, FAULT = 'hold', 'ramp', 'fault'
POLICIES = (HOLD, RAMP, FAULT)
"""What becomes of a silent device that is the clock: time stands, current goes to zero, an error."""

DEVICE_SETTINGS = (
    Parameter(
        'device_timeout_s', 1.0, 's', 0.05, 3600.0, 'wall time to wait for the device', fixed=True
    ),
    Parameter(
        'device_ramp_s', 0.1, 's', 0.0, 10.0, 'sim time in which current goes to zero', fixed=True
    ),
)

COPLEY_PARAMETERS = (
    'axes',
    'device_clock',
    *(parameter.name for parameter in DEVICE_SETTINGS),
)
"""Names of the parameters that only a Copley has."""
