# SPDX-License-Identifier: Apache-2.0
"""
The machine as URDF, for RViz, Foxglove and robot_state_publisher.

Made from the description, so it cannot disagree with what is simulated. Links are the bodies; joints
are the axes, and the coordinates that follow an axis through a transmission (the counterweight) as
mimic joints. Flexible connections move by micrometres and are drawn rigid. Every body is shown as
the box that has its mass and principal moments of inertia.

The thesis' base frame has y up, ROS has z up (REP 103). The one transform between them is the fixed
joint `machine_to_ros` from `base_link` to `base`: a turn by +90 degrees about x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from waferbot_plant.description import Body, Description, Joint

WORLD, BASE = 'base_link', 'base'
LIMITS = {'prismatic': (-0.5, 0.5), 'revolute': (-math.pi, math.pi)}
"""What a joint goes, m and rad; a description does not say."""

COLOURS = ('0.55 0.57 0.60 1', '0.30 0.45 0.65 1', '0.70 0.45 0.25 1', '0.35 0.55 0.40 1')


def urdf(
    description: Description, dynamics: Mapping[str, tuple[float, float]] | None = None
) -> str:
    """
    Return the robot's URDF as text.

    `dynamics` are damping (N s/m, Nm s/rad) and friction (N, Nm) per axis, for `<dynamics>`.
    """
    robot = ElementTree.Element('robot', name='waferbot')
    ElementTree.SubElement(robot, 'link', name=WORLD)
    ElementTree.SubElement(robot, 'link', name=BASE)
    _joint(robot, 'machine_to_ros', 'fixed', WORLD, BASE, (0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0))
    place: dict[str, np.ndarray] = {BASE: np.zeros(3)}
    pending = list(description.joints.values())
    while pending:
        joint = next(joint for joint in pending if joint.parent in place)
        pending.remove(joint)
        place[joint.child] = np.array(joint.at)
        colour = COLOURS[len(place) % len(COLOURS)]
        _link(robot, description.bodies[joint.child], place[joint.child], colour)
        _moving_joint(robot, description, joint, place[joint.child] - place[joint.parent])
    for axis, (damping, friction) in (dynamics or {}).items():
        element = robot.find(f"joint[@name='{axis}']")
        if element is not None:
            ElementTree.SubElement(
                element, 'dynamics', damping=f'{damping:.9g}', friction=f'{friction:.9g}'
            )
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding='unicode') + '\n'


def _moving_joint(
    robot: ElementTree.Element, description: Description, joint: Joint, offset: np.ndarray
) -> None:
    axis_of = {coordinate: axis for axis, coordinate in description.axes.items()}
    followers = {
        transmission.driven: transmission.driving
        for transmission in description.transmissions.values()
        if transmission.driven not in axis_of and transmission.driving in axis_of
    }
    for freedom in joint.freedoms:
        if freedom.locked or freedom.name not in (*axis_of, *followers):
            continue
        kind = 'revolute' if freedom.revolute else 'prismatic'
        name = axis_of.get(freedom.name, freedom.name)
        element = _joint(robot, name, kind, joint.parent, joint.child, tuple(offset))
        ElementTree.SubElement(element, 'axis', xyz=_text(freedom.axis))
        low, high = LIMITS[kind]
        ElementTree.SubElement(
            element, 'limit', lower=f'{low:g}', upper=f'{high:g}', effort='1000', velocity='10'
        )
        if freedom.name in followers:
            leader = axis_of[followers[freedom.name]]
            ElementTree.SubElement(element, 'mimic', joint=leader, multiplier='-1', offset='0')
        return
    _joint(robot, joint.name, 'fixed', joint.parent, joint.child, tuple(offset))


def _joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    offset: tuple[float, ...],
    turn: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, 'joint', name=name, type=kind)
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)
    ElementTree.SubElement(joint, 'origin', xyz=_text(offset), rpy=_text(turn))
    return joint


def _link(robot: ElementTree.Element, body: Body, at: np.ndarray, colour: str) -> None:
    link = ElementTree.SubElement(robot, 'link', name=body.name)
    tensor = np.asarray(body.inertia, dtype=float)
    centre = np.asarray(body.centre_of_gravity, dtype=float) - at
    inertial = ElementTree.SubElement(link, 'inertial')
    ElementTree.SubElement(inertial, 'origin', xyz=_text(centre), rpy='0 0 0')
    ElementTree.SubElement(inertial, 'mass', value=f'{body.mass:g}')
    names = {
        'ixx': (0, 0),
        'iyy': (1, 1),
        'izz': (2, 2),
        'ixy': (0, 1),
        'ixz': (0, 2),
        'iyz': (1, 2),
    }
    ElementTree.SubElement(
        inertial, 'inertia', {name: f'{tensor[cell]:.9g}' for name, cell in names.items()}
    )
    sides, axes = body.equivalent_box()
    visual = ElementTree.SubElement(link, 'visual')
    ElementTree.SubElement(visual, 'origin', xyz=_text(centre), rpy=_text(_roll_pitch_yaw(axes)))
    geometry = ElementTree.SubElement(visual, 'geometry')
    ElementTree.SubElement(geometry, 'box', size=_text(sides))
    material = ElementTree.SubElement(visual, 'material', name=f'{body.name}_colour')
    ElementTree.SubElement(material, 'color', rgba=colour)


def _roll_pitch_yaw(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return the fixed-axis angles of a rotation matrix, as URDF writes them."""
    pitch = math.asin(max(-1.0, min(1.0, -rotation[2, 0])))
    if abs(rotation[2, 0]) > 1.0 - 1e-12:
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


def _text(values: object) -> str:
    return ' '.join(f'{value:.9g}' for value in np.asarray(values, dtype=float))
