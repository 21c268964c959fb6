# SPDX-License-Identifier: Apache-2.0
"""The settings that every node of the twin has."""

from __future__ import annotations

from waferbot_lockstep.parameters import Parameter

LOCKSTEP = 'lockstep'
REALTIME = 'realtime'

MACHINE_AXES, MACHINE_ENCODERS = 'machine_axes', 'machine_encoders'
"""Parameters that name the axes and encoders of the machine (`waferbot_lockstep.layout`)."""

NODE_SETTINGS = (
    Parameter('current_loop_hz', 18000, 'Hz', 1, 1_000_000, 'rate of the tick', True, True),
    Parameter(
        'encoder_divider', 2, 'ticks', 1, 1000, 'ticks between encoder messages', True, True
    ),
    Parameter('servo_divider', 8, 'ticks', 1, 1000, 'ticks between servo cycles', True, True),
    Parameter(
        'end_tick', 0, 'ticks', 0, 2**53, 'the node ends before this tick; 0: never', True, True
    ),
    Parameter(
        'peer_timeout_s', 2.0, 's', 0.2, 3600.0, 'wall time of silence after which a peer is gone'
    ),
    Parameter(
        'startup_timeout_s', 0.0, 's', 0.0, 3600.0, 'wall time to wait for peers; 0: for ever'
    ),
    Parameter(
        'patience_s',
        0.1,
        's',
        0.0,
        10.0,
        'in real time, wall time to wait for an input of a tick before going on with the newest; '
        '0: never wait',
        fixed=True,
    ),
)

NODE_PARAMETERS = (
    *(parameter.name for parameter in NODE_SETTINGS),
    'timekeeping',
    MACHINE_AXES,
    MACHINE_ENCODERS,
    'channel',
    'from_topics',
    'use_sim_time',
)
"""Names of all parameters that every node has."""
