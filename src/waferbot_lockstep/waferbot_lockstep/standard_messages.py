# SPDX-License-Identifier: Apache-2.0
"""
The standard messages of the twin as bytes: `JointState`, `Clock`, and the robot's description.

The plant node publishes these bytes and the in-process runner records the same, so that both give
the same file. CDR as in `waferbot_lockstep.wire`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND
from waferbot_lockstep.wire import LITTLE_ENDIAN

CLOCK = ('clock', 'rosgraph_msgs/msg/Clock')
"""Relative, so that a twin in a namespace has its own; tools expect `/clock` and are remapped there."""

ROBOT_DESCRIPTION = ('robot_description', 'std_msgs/msg/String')
"""Latched: said once, kept for whoever comes later."""

JOINT_STATES = ('joint_states', 'sensor_msgs/msg/JointState')

FLOAT64 = 'std_msgs/msg/Float64'
"""Of the topics of an overlay, measured beside simulated."""


def clock_message(stamp_ns: int) -> bytes:
    """Return a `Clock` message."""
    return LITTLE_ENDIAN + struct.pack('<iI', *divmod(stamp_ns, NANOSECONDS_PER_SECOND))


def string_message(text: str) -> bytes:
    """Return a `String` message."""
    body = bytearray()
    _append_string(body, text)
    return LITTLE_ENDIAN + bytes(body)


def joint_state_message(
    stamp_ns: int,
    names: Sequence[str],
    position: Sequence[float],
    velocity: Sequence[float],
) -> bytes:
    """Return a `JointState` message without effort; m or rad, and their rates, as in REP 103."""
    body = bytearray(struct.pack('<iI', *divmod(stamp_ns, NANOSECONDS_PER_SECOND)))
    _append_string(body, '')
    _align(body, 4)
    body += struct.pack('<I', len(names))
    for name in names:
        _append_string(body, name)
    for values in (position, velocity):
        _align(body, 4)
        body += struct.pack('<I', len(values))
        _align(body, 8)
        body += struct.pack(f'<{len(values)}d', *values)
    body += struct.pack('<I', 0)
    return LITTLE_ENDIAN + bytes(body)


def stamp_of(message: bytes) -> int:
    """Return the stamp, in nanoseconds, of a message that begins with one (both of the above do)."""
    sec, nanosec = struct.unpack_from('<iI', message, len(LITTLE_ENDIAN))
    return sec * NANOSECONDS_PER_SECOND + nanosec


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _append_string(body: bytearray, text: str) -> None:
    _align(body, 4)
    data = text.encode() + b'\0'
    body += struct.pack('<I', len(data)) + data
