# SPDX-License-Identifier: Apache-2.0
"""The settings of the plant's node."""

from __future__ import annotations

from waferbot_lockstep.parameters import Parameter

PLANT_SETTINGS = (
    Parameter(
        'realtime_factor', 1.0, '', 1e-3, 100.0, 'sim seconds per wall second in real time', fixed=True
    ),
    Parameter(
        'recorder_window', 0, 'ticks', 0, 1_000_000,
        'in lock-step, how far the plant may be ahead of a recorder; 0: it waits for none',
        integer=True, fixed=True,
    ),
)  # fmt: skip

PLANT_PARAMETERS = (
    'description',
    'damping',
    'start_paused',
    *(parameter.name for parameter in PLANT_SETTINGS),
)
"""Names of the parameters that only the plant has."""
