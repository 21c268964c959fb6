# SPDX-License-Identifier: Apache-2.0
"""
The rigid multibody plant against the mathematical one, as in chapter 3 of the thesis.

Both get the same bodies; one works them out by Euler-Lagrange, the other by recursion over the
tree. The test of the thesis: 1 A on each axis in turn, no controller, and the accelerations
compared. Its two programs differed by 1.4e-5 %, 4.3e-4 % and 2.7e-3 %.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant import lagrange, motors, plant
from waferbot_plant.description import BASE, Description, Joint
from waferbot_plant.plant import Machine

THESIS_DIFFERENCE_PERCENT = dict(zip(AXES, (1.4e-5, 4.3e-4, 2.7e-3), strict=True))
"""Difference of the thesis' two programs in acceleration under 1 A on the axis."""


def mathematical_parameters(description: Description) -> NDArray[np.void]:
    """
    Return the record of the mathematical plant for a description of the three-axis machine.

    Takes every connection as rigid. Raises `UserError` for a description that is not that machine:
    a vertical slide with a counterweight, a rotation about x on it, one about y on that.
    """
    try:
        coordinates = [description.axes[axis] for axis in AXES]
        joints = [_joint_of(description, name) for name in coordinates]
        cable = next(
            item
            for item in description.transmissions.values()
            if item.pulls_only and item.driving == coordinates[0]
        )
        drive = next(
            item for item in description.transmissions.values() if item.driven == coordinates[2]
        )
        counterweight = _joint_of(description, cable.driven)
        axes = [
            next(freedom.axis for freedom in joint.freedoms if freedom.name == name)
            for joint, name in zip(joints, coordinates, strict=True)
        ]
    except (KeyError, StopIteration):
        axes = []
    expected = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    if not axes or not np.array_equal(axes, expected):
        raise UserError(
            f'{description.name}: the mathematical plant is that of the three-axis machine of the '
            'thesis only'
        )
    beyond = [_bodies_beyond(description, joint.child) for joint in joints]
    rotor_inertia = sum(
        rotor.inertia for rotor in description.rotors.values() if rotor.coordinate == drive.driving
    )
    return lagrange.parameters_from_base_frame(
        carriage=_as_one(description, beyond[0] - beyond[1]),
        x_rotate=_as_one(description, beyond[1] - beyond[2]),
        y_rotate=_as_one(description, beyond[2]),
        counterweight_mass_kg=_as_one(
            description, _bodies_beyond(description, counterweight.child)
        ).mass_kg,
        drive=lagrange.YRotateDrive(rotor_inertia, 1.0 / abs(drive.ratio), 1.0, 1.0),
        cable=lagrange.CableGeometry(0.0, 0.0, 0.0, 0.0, 0.0),
        x_rotate_at_m=joints[1].at.tolist(),
        y_rotate_at_m=joints[2].at.tolist(),
        gravity_m_s2=-float(description.gravity[1]),
    )


def _joint_of(description: Description, coordinate: str) -> Joint:
    """Return the joint that a coordinate is a freedom of."""
    return next(
        joint
        for joint in description.joints.values()
        if any(freedom.name == coordinate for freedom in joint.freedoms)
    )


def _bodies_beyond(description: Description, first: str) -> set[str]:
    """Return a body and all that hang on it."""
    beyond = {first}
    for _ in description.joints:
        beyond |= {
            joint.child
            for joint in description.joints.values()
            if joint.parent in beyond and joint.parent != BASE
        }
    return beyond


def _as_one(description: Description, names: Iterable[str]) -> lagrange.RigidBody:
    """Return bodies that are fixed to one another as one."""
    bodies = [description.bodies[name] for name in sorted(names)]
    return lagrange.combine(
        lagrange.RigidBody(body.mass, body.centre_of_gravity.tolist(), body.inertia.tolist())
        for body in bodies
    )


def open_loop_differences(machine: Machine, current: float = 1.0) -> dict[str, float]:
    """
    Return, for each axis, how far the two plants' accelerations are apart, in percent.

    `current` in A, peak of sine, on that axis alone; from rest at home, without friction, damping
    and gravity, as in the thesis. The machine must be rigid.
    """
    if machine.coordinates != tuple(machine.description.axes[axis] for axis in AXES):
        raise UserError(f'{machine.description.name}: the comparison needs the rigid model')
    record = mathematical_parameters(machine.description)
    record[0]['gravity'] = 0.0
    parameters = machine.parameters()
    parameters[0]['gravity'] = 0.0
    state = machine.initial_state(parameters)
    differences = {}
    home, expected, found = np.zeros(3), np.zeros(3), np.zeros(3)
    for row, axis in enumerate(AXES):
        motor = machine.description.motors[axis]
        force = np.zeros(3)
        force[row] = current * motors.force_constant(motor)
        force[row] *= machine.assembly.placing[motor.coordinate][1]
        lagrange.forward_dynamics(home, home, force, record, expected)
        plant.acceleration(state, parameters, force, found)
        differences[axis] = (
            100.0 * math.fabs(found[row] - expected[row]) / math.fabs(expected[row])
        )
    return differences
