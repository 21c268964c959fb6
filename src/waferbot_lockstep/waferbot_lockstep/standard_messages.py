# SPDX-License-Identifier: Apache-2.0
"""
The standard messages of the twin as bytes: `JointState`, `Clock`, the robot's description, transforms.

The plant node publishes these bytes and the in-process runner records the same, so that both give
the same file. Transforms are made by whoever records: PyPI has no wheel of tf2_msgs, with which a node
could publish them. CDR as in `waferbot_lockstep.wire`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from waferbot_lockstep.timing import NANOSECONDS_PER_SECOND
from waferbot_lockstep.wire import LITTLE_ENDIAN

CLOCK = ('clock', 'rosgraph_msgs/msg/Clock')
"""Relative, so that a twin in a namespace has its own; tools expect `/clock` and are remapped there."""

ROBOT_DESCRIPTION = ('robot_description', 'std_msgs/msg/String')
"""Latched: said once, kept for whoever comes later."""

JOINT_STATES = ('joint_states', 'sensor_msgs/msg/JointState')

TRANSFORMS = ('tf', 'tf2_msgs/msg/TFMessage')
FIXED_TRANSFORMS = ('tf_static', 'tf2_msgs/msg/TFMessage')
"""Latched. Between frames that do not move in one another."""

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


@dataclass(frozen=True)
class Transform:
    """Where the frame `child` is in the frame `parent`: translation (m), rotation as x, y, z, w."""

    parent: str
    child: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


def transforms_message(stamp_ns: int, transforms: Sequence[Transform]) -> bytes:
    """Return a `TFMessage`."""
    stamp = struct.pack('<iI', *divmod(stamp_ns, NANOSECONDS_PER_SECOND))
    body = bytearray(struct.pack('<I', len(transforms)))
    for one in transforms:
        _align(body, 4)
        body += stamp
        _append_string(body, one.parent)
        _append_string(body, one.child)
        _align(body, 8)
        body += struct.pack('<7d', *one.translation, *one.rotation)
    return LITTLE_ENDIAN + bytes(body)


def stamp_of(message: bytes) -> int:
    """Return the stamp, in nanoseconds, of a `Clock` or `JointState`, which begin with one."""
    sec, nanosec = struct.unpack_from('<iI', message, len(LITTLE_ENDIAN))
    return sec * NANOSECONDS_PER_SECOND + nanosec


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _append_string(body: bytearray, text: str) -> None:
    _align(body, 4)
    data = text.encode() + b'\0'
    body += struct.pack('<I', len(data)) + data
