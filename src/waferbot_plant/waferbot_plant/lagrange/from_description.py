# SPDX-License-Identifier: Apache-2.0
"""The record of the mathematical plant from a description of the three-axis machine."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant.description import BASE, Description, Joint

from .parameters import (
    CableGeometry,
    RigidBody,
    YRotateDrive,
    combine,
    parameters_from_base_frame,
)


def check_lagrange(description: Description, coordinates: Iterable[str]) -> None:
    """
    Raise `UserError` if the mathematical plant leaves out what a description has.

    It is rigid and frictionless, with perfect motors in air that has no wind: `coordinates` (of the
    assembled machine) must be the three axes.
    """
    has = {
        'connections that give': list(coordinates)
        != [description.axes.get(axis) for axis in AXES],
        'frictions': bool(description.frictions),
        'dampers': bool(description.dampers),
        'disturbances': bool(description.disturbances),
        'a floor that shakes': bool(np.any(description.vibration.acceleration)),
        'imperfect motors': any(
            motor.saturation_current > 0.0 or motor.ripple or any(motor.phase_imbalance)
            for motor in description.motors.values()
        ),
        'motors that warm up': any(motor.heating for motor in description.motors.values()),
        'motors in other places': any(
            motor.coordinate not in _motor_places(description, axis)
            for axis, motor in description.motors.items()
        ),
    }
    found = [name for name, there in has.items() if there]
    if found:
        raise UserError(
            f'{description.name}: formulation lagrange is for the rigid, frictionless machine with '
            f'perfect motors; this one has {", ".join(found)}. Take them away, or use formulation '
            'multibody'
        )


def _motor_places(description: Description, axis: str) -> list[str]:
    """Return where the equations have the motor of an axis: at it, that of Y-Rotate before its drive."""
    own = description.axes[axis]
    if axis != AXES[2]:
        return [own]
    return [item.driving for item in description.transmissions.values() if item.driven == own]


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
    if drive.ratio < 0.0:
        raise UserError(
            f'{description.name}: transmission {drive.name} turns the other way round; the mathematical '
            'plant has a drive that keeps the sense of rotation'
        )
    return parameters_from_base_frame(
        carriage=_as_one(description, beyond[0] - beyond[1]),
        x_rotate=_as_one(description, beyond[1] - beyond[2]),
        y_rotate=_as_one(description, beyond[2]),
        counterweight_mass_kg=_as_one(
            description, _bodies_beyond(description, counterweight.child)
        ).mass_kg,
        drive=YRotateDrive(rotor_inertia, 1.0 / abs(drive.ratio), 1.0, 1.0),
        cable=CableGeometry(0.0, 0.0, 0.0, 0.0, 0.0),
        x_rotate_at_m=joints[1].at.tolist(),
        y_rotate_at_m=joints[2].at.tolist(),
        payload_origin_m=None if description.payload is None else description.payload.at.tolist(),
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


def _as_one(description: Description, names: Iterable[str]) -> RigidBody:
    """Return bodies that are fixed to one another as one."""
    bodies = [description.bodies[name] for name in sorted(names)]
    return combine(
        RigidBody(body.mass, body.centre_of_gravity.tolist(), body.inertia.tolist())
        for body in bodies
    )
