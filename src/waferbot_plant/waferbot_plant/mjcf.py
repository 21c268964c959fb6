# SPDX-License-Identifier: Apache-2.0
"""
The machine as MJCF, for MuJoCo: the mechanics with every connection rigid, and its motors.

A joint of an axis has what moves with its motor as `armature`, friction and damping as `frictionloss`
and `damping` (`joint_dynamics`); what follows an axis through a transmission is tied to it by an
equality of joints. A motor's control is its current in A, its `gear` the force or torque at the joint
per ampere. Vectors are in the machine's own frame, y up, with gravity to match.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_plant import motors
from waferbot_plant.assembly import Link
from waferbot_plant.description import Description
from waferbot_plant.inverse_dynamics import InverseDynamics

HIGHEST_SPEED = {False: 0.5, True: 3.0}
"""Up to where friction is fitted by default: m/s of an axis that slides, rad/s of one that turns."""

POINTS = 60

STIFF = '0.002 1'
"""Time constant (s) and damping ratio of the equalities."""


@dataclass(frozen=True)
class JointDynamics:
    """
    Friction (N, Nm) and damping (N s/m, Nm s/rad) of an axis that come closest to its friction's law.

    `misfit` is the RMS of what they miss, over the RMS of the law, up to `speed` (m/s, rad/s).
    """

    friction: float
    damping: float
    misfit: float
    speed: float


def joint_dynamics(
    description: Description, speed: Mapping[str, float] | None = None
) -> dict[str, JointDynamics]:
    """
    Return friction + damping |v| of each axis with a motor, by least squares over 0 to its speed.

    All that slides or turns with the axis is in it, referred to it. Raises `UserError`.
    """
    dynamics = InverseDynamics(description)
    rest = np.zeros((1, len(dynamics.axes)))
    found = {}
    for column, axis in enumerate(dynamics.axes):
        highest = (speed or {}).get(axis) or HIGHEST_SPEED[description.turns(axis)]
        at = highest * (np.arange(POINTS) + 0.5) / POINTS
        both = []
        for sign in (1.0, -1.0):
            velocity = np.zeros((POINTS, len(dynamics.axes)))
            velocity[:, column] = sign * at
            still = 0.0 * velocity
            force = dynamics.forces(still, velocity, still) - dynamics.forces(rest, rest, rest)
            both.append(sign * force[:, column] * force_ratio(dynamics, axis))
        law = 0.5 * (both[0] + both[1])
        columns = np.column_stack([np.ones(POINTS), at])
        solution = np.linalg.lstsq(columns, law, rcond=None)[0]
        friction, damping = (max(float(value), 0.0) for value in solution)
        if solution[1] < 0.0:
            friction = float(law.mean())
        left = law - friction - damping * at
        size = float(np.sqrt(np.mean(law**2)))
        misfit = float(np.sqrt(np.mean(left**2))) / size if size else 0.0
        found[axis] = JointDynamics(friction, damping, misfit, highest)
    return found


def force_ratio(dynamics: InverseDynamics, axis: str) -> float:
    """Return the force at an axis per force of its motor."""
    machine = dynamics.machine
    _, to_motor = machine.assembly.placing[machine.description.motors[axis].coordinate]
    _, to_axis = machine.assembly.placing[machine.description.axes[axis]]
    return float(to_motor / to_axis)


def mjcf(description: Description, dynamics: Mapping[str, JointDynamics] | None = None) -> str:
    """
    Return the machine as the text of an MJCF file.

    `dynamics` are friction and damping per axis, those of the description by default. Raises
    `UserError` for a machine that has a moving part without mass.
    """
    rigid = InverseDynamics(description)
    machine = rigid.machine
    assembly = machine.assembly
    loss = joint_dynamics(description) if dynamics is None else dynamics
    axis_of = {coordinate: axis for axis, coordinate in description.axes.items()}
    root = ElementTree.Element('mujoco', model=description.name)
    ElementTree.SubElement(root, 'compiler', angle='radian')
    ElementTree.SubElement(
        root, 'option', gravity=_text(description.gravity), integrator='implicitfast',
        timestep='0.0005',
    )  # fmt: skip
    bodies = [ElementTree.SubElement(root, 'worldbody')]
    equalities = ElementTree.Element('equality')
    leader: dict[int, tuple[str, float]] = {}
    for link in sorted(assembly.links, key=lambda one: one.freedom.name not in axis_of):
        row, ratio = assembly.placing[link.freedom.name]
        leader.setdefault(row, (link.freedom.name, ratio))
    for link in assembly.links:
        name = link.freedom.name
        row, ratio = assembly.placing[name]
        if link.mass <= 0.0:
            raise UserError(f'{description.name}: {name} moves a part without mass; MJCF has none')
        parent = assembly.links[link.parent].point if link.parent >= 0 else np.zeros(3)
        body = ElementTree.SubElement(
            bodies[link.parent + 1], 'body', name=name, pos=_text(link.point - parent)
        )
        bodies.append(body)
        if row in assembly.locked:  # a body without a joint is welded to its parent
            _inertial(body, link)
            continue
        joint = {
            'name': axis_of.get(name, name),
            'type': 'hinge' if link.freedom.revolute else 'slide',
            'axis': _text(link.freedom.axis),
        }
        if leader[row][0] == name:
            joint['armature'] = _number(assembly.rotor_inertia[row] / ratio**2)
            if name in axis_of and axis_of[name] in loss:
                joint['damping'] = _number(loss[axis_of[name]].damping)
                joint['frictionloss'] = _number(loss[axis_of[name]].friction)
        else:
            other, of_other = leader[row]
            ElementTree.SubElement(
                equalities, 'joint', joint1=joint['name'], joint2=axis_of.get(other, other),
                polycoef=f'0 {_number(ratio / of_other)} 0 0 0', solref=STIFF,
            )  # fmt: skip
        ElementTree.SubElement(body, 'joint', joint)
        _inertial(body, link)
    if len(equalities):
        root.append(equalities)
    actuators = ElementTree.SubElement(root, 'actuator')
    for axis in rigid.axes:
        constant = motors.force_constant(description.motors[axis]) * force_ratio(rigid, axis)
        ElementTree.SubElement(
            actuators, 'motor', name=f'{axis}_current', joint=axis, gear=_number(constant)
        )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def _inertial(body: ElementTree.Element, link: Link) -> None:
    centre = link.first_moment / link.mass
    inertia = link.inertia - link.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ElementTree.SubElement(
        body, 'inertial', mass=_number(link.mass), pos=_text(centre), fullinertia=_text(full)
    )


def _number(value: float) -> str:
    return f'{float(value):.12g}'


def _text(values: object) -> str:
    return ' '.join(_number(value) for value in np.asarray(values, dtype=float))
