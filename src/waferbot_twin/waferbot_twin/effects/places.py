# SPDX-License-Identifier: Apache-2.0
"""Where things are in a machine: what effects need to know to place and to size themselves."""

from __future__ import annotations

from typing import Any

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.timing import Timing
from waferbot_plant import motors, plant
from waferbot_plant.description import Joint
from waferbot_twin.effects.variant import Variant


def motor_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes that have a motor, in the contract's order."""
    return tuple(axis for axis in AXES if axis in variant.description.motors)


def rotary(variant: Variant, axis: str) -> bool:
    """Return whether an axis turns."""
    description = variant.description
    return bool(description.revolute[description.axes[axis]])


def coordinate(variant: Variant, axis: str) -> str:
    """Return the coordinate that an axis is."""
    return variant.description.axes[axis]


def motor_coordinate(variant: Variant, axis: str) -> str:
    """Return the coordinate that an axis' motor drives."""
    return variant.description.motors[axis].coordinate


def motor_ratio(variant: Variant, axis: str) -> float:
    """Return turns (or metres) of the motor per radian (or metre) of the axis; 1 for direct drives."""
    machine = variant.build(Timing())
    return (
        abs(
            machine.assembly.placing[motor_coordinate(variant, axis)][1]
            / machine.assembly.placing[coordinate(variant, axis)][1]
        )
        if _same_row(machine, variant, axis)
        else _ratio_of_transmissions(variant, axis)
    )


def _same_row(machine: plant.Machine, variant: Variant, axis: str) -> bool:
    placing = machine.assembly.placing
    return placing[motor_coordinate(variant, axis)][0] == placing[coordinate(variant, axis)][0]


def _ratio_of_transmissions(variant: Variant, axis: str) -> float:
    driven = coordinate(variant, axis)
    for transmission in variant.description.transmissions.values():
        if (
            transmission.driving == motor_coordinate(variant, axis)
            and transmission.driven == driven
        ):
            return abs(1.0 / transmission.ratio)
    return 1.0


def joint_of(variant: Variant, axis: str) -> Joint | None:
    """Return the joint whose freedom the axis is."""
    wanted = coordinate(variant, axis)
    for joint in variant.description.joints.values():
        if any(freedom.name == wanted for freedom in joint.freedoms):
            return joint
    return None


def force_per_ampere(variant: Variant, axis: str) -> float:
    """Return the force (N) or torque (Nm) at the axis per ampere of the motor's current."""
    return abs(
        motors.force_constant(variant.description.motors[axis]) * motor_ratio(variant, axis)
    )


def moving_inertia(variant: Variant, axis: str) -> float:
    """Return the mass (kg) or inertia (kg m2) that the axis moves at home, all else rigid."""
    machine = variant.build(Timing())
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    size = len(machine.coordinates)
    matrix = np.zeros((size, size))
    plant.mass_matrix(state, parameters, matrix)
    row, ratio = machine.assembly.placing[coordinate(variant, axis)]
    return float(matrix[row, row] / ratio**2)


def rated_force(variant: Variant, axis: str) -> float:
    """Return the force (N) or torque (Nm) at the axis at a tenth of the drive's peak current."""
    return 0.1 * variant.amplifier_setting(axis, 'peak_current') * force_per_ampere(variant, axis)


def rated_speed(variant: Variant, axis: str) -> float:
    """Return a brisk speed of the axis, m/s or rad/s: what rated force reaches in 50 ms."""
    return 0.05 * rated_force(variant, axis) / moving_inertia(variant, axis)


def force_key(variant: Variant, axis: str) -> str:
    """Return how a force on the axis is called in a description, with its unit."""
    return 'torque_nm' if rotary(variant, axis) else 'force_n'


def extra_friction(
    variant: Variant, axis: str, speeds: list[float], resistances: list[float]
) -> dict[str, Any]:
    """Return the part of a description that adds dry friction to an axis, over speed."""
    speed_key = 'speed_rad_s' if rotary(variant, axis) else 'speed_m_s'
    own = coordinate(variant, axis)
    entry = {'coordinate': own, speed_key: speeds, force_key(variant, axis): resistances}
    return {'frictions': {f'{axis}_extra': entry}}


def extra_damper(variant: Variant, axis: str, damping: float) -> dict[str, Any]:
    """Return the part of a description that adds viscous friction to an axis."""
    key = 'damping_nm_s_rad' if rotary(variant, axis) else 'damping_n_s_m'
    return {'dampers': {f'{axis}_extra': {'coordinate': coordinate(variant, axis), key: damping}}}


def disturbance(variant: Variant, axis: str, kind: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a description that adds a force from outside to an axis."""
    entry = {'kind': kind, 'coordinate': coordinate(variant, axis), **values}
    return {'disturbances': {f'{axis}_{kind}': entry}}


def controlled_axes(variant: Variant, name: str) -> tuple[str, ...]:
    """Return the axes whose controller is known and has a value for I-variable `name`."""
    return tuple(
        axis
        for axis in motor_axes(variant)
        if variant.pmac.get(axis) and variant.i_variable(axis, name) != 0.0
    )


def own_inertia(variant: Variant, axis: str) -> float:
    """Return the mass (kg), or inertia about the axis (kg m2), of the body that the axis carries."""
    joint = joint_of(variant, axis)
    assert joint is not None
    body = variant.description.bodies[joint.child]
    if not rotary(variant, axis):
        return body.mass
    direction = next(
        item.axis for item in joint.freedoms if item.name == coordinate(variant, axis)
    )
    return float(direction @ body.inertia @ direction)


def more_inertia(variant: Variant, axis: str, amount: float) -> dict[str, Any]:
    """
    Return the part of a description that adds mass (kg) or inertia (kg m2) to what an axis carries.

    Mass goes to the centre of gravity; inertia scales the whole tensor, so that it stays one that a
    body can have.
    """
    joint = joint_of(variant, axis)
    assert joint is not None
    body = variant.description.bodies[joint.child]
    if not rotary(variant, axis):
        return {'bodies': {joint.child: {'mass_kg': body.mass + amount}}}
    scaled = body.inertia * (1.0 + amount / own_inertia(variant, axis))
    names = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'xz': (0, 2), 'yz': (1, 2)}
    tensor = {name: float(scaled[place]) for name, place in names.items() if scaled[place] != 0.0}
    return {'bodies': {joint.child: {'inertia_kg_m2': tensor}}}
