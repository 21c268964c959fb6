# SPDX-License-Identifier: Apache-2.0
"""
Where the frames of a robot are in one another, by its URDF: what robot_state_publisher says on /tf.

The frame of a joint's child is in that of its parent by the joint's origin, then its motion q along or
about its axis. A joint that mimics another moves by multiplier q + offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from waferbot_lockstep.standard_messages import Transform, transforms_message

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

ALONG_X = '1 0 0'
"""The axis of a joint that names none."""


@dataclass(frozen=True)
class _Joint:
    """A joint that slides or `turns`, with `leader`: itself, or the one that it mimics."""

    parent: str
    child: str
    at: Vector
    turned: Quaternion
    axis: Vector
    turns: bool
    leader: str
    multiplier: float
    offset: float

    def transform(self, position: float) -> Transform:
        """Return where the child is when the leader is at `position` (m or rad)."""
        q = self.multiplier * position + self.offset
        if self.turns:
            half = math.sin(0.5 * q)
            x, y, z = self.axis
            own = (half * x, half * y, half * z, math.cos(0.5 * q))
            return Transform(self.parent, self.child, self.at, product(self.turned, own))
        moved = rotated(self.turned, (q * self.axis[0], q * self.axis[1], q * self.axis[2]))
        at = (self.at[0] + moved[0], self.at[1] + moved[1], self.at[2] + moved[2])
        return Transform(self.parent, self.child, at, self.turned)


class Frames:
    """The frames of a robot."""

    def __init__(self, fixed: Sequence[Transform], joints: Sequence[_Joint]) -> None:
        """Take those that do not move, and the joints that do."""
        self._fixed, self._joints = fixed, joints

    @classmethod
    def of(cls, urdf: str) -> Frames:
        """Return the frames of a URDF; raises ValueError or `ParseError` if it is none."""
        fixed, joints = [], []
        for joint in ElementTree.fromstring(urdf).findall('joint'):
            kind, name = joint.get('type'), joint.get('name', '')
            parent, child = (_of(joint, end, 'link') for end in ('parent', 'child'))
            at = _vector(_of(joint, 'origin', 'xyz'))
            turned = of_roll_pitch_yaw(*_vector(_of(joint, 'origin', 'rpy')))
            if kind == 'fixed':
                fixed.append(Transform(parent, child, at, turned))
            elif kind in ('revolute', 'continuous', 'prismatic'):
                axis = _vector(_of(joint, 'axis', 'xyz') or ALONG_X)
                length = math.sqrt(sum(part * part for part in axis)) or 1.0
                joints.append(
                    _Joint(
                        parent,
                        child,
                        at,
                        turned,
                        (axis[0] / length, axis[1] / length, axis[2] / length),
                        kind != 'prismatic',
                        _of(joint, 'mimic', 'joint') or name,
                        float(_of(joint, 'mimic', 'multiplier') or 1.0),
                        float(_of(joint, 'mimic', 'offset') or 0.0),
                    )
                )
        return cls(fixed, joints)

    def fixed_message(self) -> bytes:
        """Return the message of the frames that do not move."""
        return transforms_message(0, self._fixed)

    def message(self, stamp_ns: int, positions: Mapping[str, float]) -> bytes:
        """Return the message of the others, of the joints whose positions (m or rad) are given."""
        known = [joint for joint in self._joints if joint.leader in positions]
        return transforms_message(
            stamp_ns, [joint.transform(positions[joint.leader]) for joint in known]
        )


def product(one: Quaternion, other: Quaternion) -> Quaternion:
    """Return the rotation `other` followed by `one`."""
    x1, y1, z1, w1 = one
    x2, y2, z2, w2 = other
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def rotated(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a rotation."""
    x, y, z, w = rotation
    turned = product(product(rotation, (*vector, 0.0)), (-x, -y, -z, w))
    return turned[0], turned[1], turned[2]


def of_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation about the fixed axes x, then y, then z, as URDF means it."""
    about_x = (math.sin(0.5 * roll), 0.0, 0.0, math.cos(0.5 * roll))
    about_y = (0.0, math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch))
    about_z = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    return product(about_z, product(about_y, about_x))


def _of(joint: ElementTree.Element, element: str, attribute: str) -> str:
    found = joint.find(element)
    return '' if found is None else found.get(attribute, '')


def _vector(text: str) -> Vector:
    x, y, z = (float(word) for word in (text or '0 0 0').split())
    return x, y, z
