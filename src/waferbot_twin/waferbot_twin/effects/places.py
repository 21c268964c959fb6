# SPDX-License-Identifier: Apache-2.0
"""
Where things are in a machine: what effects need to know to place and to size themselves.

Which parts there are and what they are tied to, and sizes (forces, inertias, currents), are those of the
model before any effect was laid over it; what an effect adds to (a mass, a friction) is as the effects
before it have left it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_plant import motors
from waferbot_plant.assembly import Assembly, home_mass_matrix_and_weight
from waferbot_plant.description import Body, Joint
from waferbot_twin.effects.variant import Variant

RATED_SHARE = 0.1
"""Share of the drive's peak current that an axis works with; the scale of forces in effects."""

DAC_BITS = 32768.0
"""Output of the controller that asks for the amplifier's peak current."""


def motor_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes that have a motor, in the contract's order."""
    return tuple(
        axis for axis in variant.base.layout.axes if axis in variant.base.description.motors
    )


def wound_axes(variant: Variant) -> tuple[str, ...]:
    """
    Return the axes whose motor's windings are known, and whose current was logged.

    Not those known by their force per ampere alone, nor those of which a log has a force instead.
    """
    known = variant.base.description.motors
    return tuple(axis for axis in current_axes(variant) if not known[axis].by_force)


def current_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes with a motor of which no log has a force in place of a current."""
    return tuple(axis for axis in motor_axes(variant) if axis not in variant.base.force_driven)


def drive_lags(variant: Variant) -> NDArray[np.float64]:
    """Return how force follows what the drive of each axis is told (3,), time constants in s."""
    known = variant.description.motors
    return np.array(
        [known[axis].lag if axis in known else 0.0 for axis in variant.base.layout.axes]
    )


def lagging_axes(variant: Variant) -> tuple[str, ...]:
    """
    Return the axes whose drive may lag behind what it is told.

    Those in logs that have no measured current, of a model without the amplifier.
    """
    base = variant.base
    return tuple(
        axis
        for axis in motor_axes(variant)
        if axis in base.told_alone and not base.copley.get(axis)
    )


def skewed_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose drive may stand in the logs at another time than their position."""
    return tuple(axis for axis in motor_axes(variant) if axis in variant.base.brought_in)


def controlled_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose controller is known."""
    return tuple(axis for axis in motor_axes(variant) if variant.pmac.get(axis))


def amplified_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose amplifier is known."""
    return tuple(axis for axis in motor_axes(variant) if variant.copley.get(axis))


def rotary(variant: Variant, axis: str) -> bool:
    """Return whether an axis turns."""
    return variant.base.description.turns(axis)


def coordinate(variant: Variant, axis: str) -> str:
    """Return the coordinate that an axis is."""
    return variant.base.description.axes[axis]


def motor_coordinate(variant: Variant, axis: str) -> str:
    """Return the coordinate that an axis' motor drives."""
    return variant.base.description.motors[axis].coordinate


def motor_rotary(variant: Variant, axis: str) -> bool:
    """Return whether an axis' motor turns."""
    return variant.base.description.motor_turns(axis)


def geared_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes with a transmission between motor and axis."""
    return tuple(
        axis
        for axis in motor_axes(variant)
        if motor_coordinate(variant, axis) != coordinate(variant, axis)
    )


def counterweight_coordinate(variant: Variant, axis: str) -> str:
    """Return the coordinate of the counterweight that a cable from an axis drives; '' without one."""
    own = coordinate(variant, axis)
    driven = (
        transmission.driven
        for transmission in variant.base.description.transmissions.values()
        if transmission.pulls_only and transmission.driving == own
    )
    return next(driven, '')


def counterweight_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes with a counterweight on a cable."""
    return tuple(axis for axis in motor_axes(variant) if counterweight_coordinate(variant, axis))


def drive_gives(variant: Variant, axis: str) -> bool:
    """Return whether anything gives between the motor and the axis."""
    return any(
        stage.connection is not None and variant.description.connections[stage.connection].flexible
        for transmission in variant.description.transmissions.values()
        if moves_with(variant, axis, transmission.driven)
        for stage in transmission.stages
    )


def moves_with(variant: Variant, axis: str, name: str) -> bool:
    """Return whether coordinate `name` is tied to the axis if nothing gives."""
    placing = variant.base.rigid.placing
    return name in placing and placing[name][0] == placing[coordinate(variant, axis)][0]


def motor_ratio(variant: Variant, axis: str) -> float:
    """Return turns (or metres) of the motor per radian (or metre) of the axis; 1 for direct drives."""
    placing = variant.base.rigid.placing
    driving, driven = motor_coordinate(variant, axis), coordinate(variant, axis)
    if placing[driving][0] != placing[driven][0]:
        return 1.0
    return abs(placing[driving][1] / placing[driven][1])


def has_poles(variant: Variant, axis: str) -> bool:
    """Return whether the description has the poles of an axis' motor."""
    return variant.description.motors[axis].poles_known


def electrical_cycle(variant: Variant, axis: str) -> float:
    """Return the length of an electrical cycle at an axis' motor, m or rad of the motor."""
    return 2.0 * math.pi / abs(variant.description.motors[axis].electrical_gain)


def cycle_of_axis(variant: Variant, axis: str) -> float:
    """Return how far an axis goes in an electrical cycle, m or rad; inf if its poles are unknown."""
    if axis not in motor_axes(variant) or not variant.description.motors[axis].poles_known:
        return math.inf
    return electrical_cycle(variant, axis) / motor_ratio(variant, axis)


def period_of_order(variant: Variant, axis: str, values: Mapping[str, float]) -> float:
    """Return how far an axis goes, m or rad, in a period of `order` per electrical cycle."""
    return electrical_cycle(variant, axis) / motor_ratio(variant, axis) / values['order']


def joint_of(variant: Variant, axis: str) -> Joint | None:
    """Return the joint whose freedom the axis is."""
    wanted = coordinate(variant, axis)
    for joint in variant.base.description.joints.values():
        if any(freedom.name == wanted for freedom in joint.freedoms):
            return joint
    return None


def jointed_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes with a motor that carry a body, not only a rotor."""
    return tuple(axis for axis in motor_axes(variant) if joint_of(variant, axis) is not None)


def swings(variant: Variant, axis: str) -> bool:
    """Return whether gravity has a torque on an axis that changes with its angle."""
    if axis not in jointed_axes(variant) or not rotary(variant, axis):
        return False
    joint, direction = joint_of(variant, axis), direction_of(variant, axis)
    assert joint is not None
    bodies = [variant.description.bodies[name] for name in carried_bodies(variant, axis)]
    moment = sum(body.mass * (body.centre_of_gravity - joint.at) for body in bodies)
    gravity = variant.description.gravity
    return bool(
        np.linalg.norm(np.cross(direction, moment)) * np.linalg.norm(np.cross(direction, gravity))
        > 0.0
    )


def carried_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes with a body that another axis carries: it feels weight and reaction of it."""
    joints = variant.base.description.joints.values()
    above = {joint.child: joint for joint in joints}
    axes = jointed_axes(variant)
    own = {axis: joint_of(variant, axis) for axis in axes}

    def carried(axis: str) -> bool:
        others = [id(joint) for name, joint in own.items() if name != axis]
        joint = own[axis]
        while joint is not None:
            joint = above.get(joint.parent)
            if id(joint) in others:
                return True
        return False

    return tuple(axis for axis in axes if carried(axis))


def direction_of(variant: Variant, axis: str) -> np.ndarray:
    """Return the unit vector along or about which an axis moves, base frame at home."""
    joint = joint_of(variant, axis)
    assert joint is not None
    wanted = coordinate(variant, axis)
    return next(freedom.axis for freedom in joint.freedoms if freedom.name == wanted)


def carried_bodies(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return the bodies that the axis carries up to the next axis, in the description's order."""
    joint = joint_of(variant, axis)
    assert joint is not None
    found = {joint.child}
    description = variant.base.description
    joints = description.joints.values()
    for _ in joints:
        for other in joints:
            moves = any(not freedom.connections for freedom in other.freedoms)
            if other.parent in found and not moves:
                found.add(other.child)
    return tuple(name for name in description.bodies if name in found)


def carried_body(variant: Variant, axis: str) -> Body:
    """Return the heaviest of the bodies that an axis carries up to the next axis."""
    bodies = variant.description.bodies
    return max((bodies[name] for name in carried_bodies(variant, axis)), key=lambda one: one.mass)


def radius_of_gyration(variant: Variant, axis: str, body: Body) -> float:
    """Return (J / m)^(1/2) of a body about a rotary axis that carries it, m, at home."""
    joint, direction = joint_of(variant, axis), direction_of(variant, axis)
    assert joint is not None
    arm = np.cross(direction, body.centre_of_gravity - joint.at)
    return math.sqrt(direction @ body.inertia @ direction / body.mass + arm @ arm)


def force_per_ampere(variant: Variant, axis: str) -> float:
    """Return the force (N) or torque (Nm) at the axis per ampere of the motor's current."""
    variant = variant.base
    return abs(
        motors.force_constant(variant.description.motors[axis]) * motor_ratio(variant, axis)
    )


def amperes_per_output(variant: Variant, axis: str) -> float:
    """Return the motor's current (A) per unit of what an axis' described controller puts out."""
    controller = variant.base.description.controllers[axis]
    per_ampere = 1.0
    if controller.drive_unit != 'A':
        per_ampere = force_per_ampere(variant, axis)
    return controller.drive_gain / per_ampere


def described_limit(variant: Variant, axis: str) -> float:
    """
    Return the largest current (A) by a description; infinite where it does not say.

    That at the limit of a described controller, or the motor's peak current if that is less.
    """
    description = variant.base.description
    controller, peak = description.controllers.get(axis), description.motors[axis].peak_current
    if controller is None or not math.isfinite(controller.output_limit):
        return peak
    return min(controller.output_limit * amperes_per_output(variant, axis), peak)


def position_encoder(variant: Variant, axis: str) -> str:
    """Return the place of the encoder that positions an axis."""
    return variant.base.description.position_encoder(axis)


def axis_counts(variant: Variant, axis: str) -> float:
    """Return the counts of an axis' position encoder per m or rad of the axis; 1 without one."""
    part = variant.base.description.encoders.get(position_encoder(variant, axis))
    if part is None or axis not in variant.base.description.axes:
        return 1.0
    placing = variant.base.rigid.placing
    ratio = placing[part.coordinate][1] / placing[coordinate(variant, axis)][1]
    return float(part.counts_per_unit * ratio)


def counts_per_unit(variant: Variant) -> np.ndarray:
    """Return the counts of each axis' position encoder per m or rad of it, (axes,); 1 without one."""
    return np.array([axis_counts(variant, axis) for axis in variant.base.layout.axes])


def encoder_places(variant: Variant) -> list[int]:
    """Return the place of each axis' position encoder."""
    layout = variant.base.layout
    return [layout.encoder_place(position_encoder(variant, axis)) for axis in layout.axes]


def described_axes(variant: Variant) -> tuple[str, ...]:
    """Return the axes whose controller the description has, and no PMAC's settings stand for it."""
    controllers = variant.base.description.controllers
    return tuple(a for a in motor_axes(variant) if a in controllers and not variant.pmac.get(a))


def moving_inertia(variant: Variant, axis: str) -> float:
    """Return the mass (kg) or inertia (kg m2) that the axis moves at home, all else rigid."""
    return _inertia_in(variant.base.rigid, coordinate(variant, axis))


def joined_inertia(variant: Variant, axis: str) -> float:
    """
    Return the mass (kg) or inertia (kg m2) that is one with the axis at home.

    What lies behind a connection that gives in the model is not: of a motor whose gear gives and whose
    output is bolted to a table, the table would be all of it.
    """
    return _inertia_in(variant.base.as_connected, coordinate(variant, axis))


def joined_motor_inertia(variant: Variant, axis: str) -> float:
    """Return `joined_inertia` of what the motor of an axis drives, at the motor."""
    return _inertia_in(variant.base.as_connected, motor_coordinate(variant, axis))


def _inertia_in(assembly: Assembly, name: str) -> float:
    matrix, _ = home_mass_matrix_and_weight(
        list(assembly.links),
        assembly.placing,
        len(assembly.coordinates),
        assembly.description.gravity,
    )
    row, ratio = assembly.placing[name]
    return float((matrix[row, row] + assembly.rotor_inertia[row]) / ratio**2)


def peak_current(variant: Variant, axis: str) -> float:
    """
    Return the peak current of an axis' drive, A.

    Without a known amplifier that by the description (`described_limit`). Of a drive of which nothing
    is known, that with which the logs' current would be the rated one.
    """
    variant = variant.base
    if not variant.copley.get(axis):
        limit = described_limit(variant, axis)
        if math.isfinite(limit):
            return limit
        if axis in variant.usual_current:
            return variant.usual_current[axis] / RATED_SHARE
    return variant.amplifier_setting(axis, 'peak_current')


def rated_force(variant: Variant, axis: str) -> float:
    """Return the force (N) or torque (Nm) at the axis at a tenth of the drive's peak current."""
    return RATED_SHARE * peak_current(variant, axis) * force_per_ampere(variant, axis)


def rated_motor_force(variant: Variant, axis: str) -> float:
    """Return the rated force, N or Nm, as the motor makes it, before any gear."""
    return rated_force(variant, axis) / motor_ratio(variant, axis)


def rated_speed(variant: Variant, axis: str) -> float:
    """
    Return a brisk speed of the axis, m/s or rad/s: what rated force reaches in 50 ms.

    In logs that were brought in, the largest that it has there.
    """
    if axis in variant.base.usual_speed:
        return variant.base.usual_speed[axis]
    return 0.05 * rated_force(variant, axis) / joined_inertia(variant, axis)


def current_per_bit(variant: Variant, axis: str) -> float:
    """Return the current that one step of the controller's output commands, A."""
    return variant.i_variable(axis, 'amplifier_peak_current') / DAC_BITS


def usual_currents(variant: Variant, axis: str) -> tuple[float, float]:
    """
    Return the motor currents that hold the axis and that also speed it up as programmed, A.

    From the controller's bias Ixx29 and the acceleration Ixx19 of jogging; without a controller,
    nothing to hold and the rated force.
    """
    variant = variant.base
    rated = RATED_SHARE * peak_current(variant, axis)
    if not variant.pmac.get(axis):
        return 0.0, rated
    per_bit = current_per_bit(variant, axis)
    holding = abs(variant.i_variable(axis, 'Ixx29')) * per_bit
    per_second = 1e6 / variant.i_variable(axis, 'counts_per_unit')
    acceleration = variant.i_variable(axis, 'Ixx19') * per_second
    force = moving_inertia(variant, axis) * acceleration
    return holding, holding + force / force_per_ampere(variant, axis)


def tight_current(variant: Variant, axis: str) -> float:
    """Return a current with which the axis holds but lacks a little of what its moves take, A."""
    holding, moving = usual_currents(variant, axis)
    return holding + 0.7 * (moving - holding)


def force_unit(variant: Variant, axis: str) -> str:
    """Return the unit of a force on the axis."""
    return 'Nm' if rotary(variant, axis) else 'N'


def motor_force_unit(variant: Variant, axis: str) -> str:
    """Return the unit of what the motor of an axis makes."""
    return 'Nm' if motor_rotary(variant, axis) else 'N'


def damping_unit(variant: Variant, axis: str) -> str:
    """Return the unit of a force on the axis per speed of it."""
    return 'Nm s/rad' if rotary(variant, axis) else 'N s/m'


def length_unit(variant: Variant, axis: str) -> str:
    """Return the unit of the axis' position."""
    return 'rad' if rotary(variant, axis) else 'm'


def force_key(variant: Variant, axis: str) -> str:
    """Return how a force on the axis is called in a description, with its unit."""
    return 'torque_nm' if rotary(variant, axis) else 'force_n'


def disturbance(variant: Variant, axis: str, effect: str, force: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a description that adds the force of an effect to an axis from outside."""
    entry = {'coordinate': coordinate(variant, axis), **force}
    return {'disturbances': {f'{axis}_{effect}': entry}}


def tensor_entries(inertia: np.ndarray) -> dict[str, float]:
    """Return an inertia tensor (3, 3) in kg m2 as a description writes it."""
    names = {'xx': (0, 0), 'yy': (1, 1), 'zz': (2, 2), 'xy': (0, 1), 'xz': (0, 2), 'yz': (1, 2)}
    return {
        name: float(inertia[place])
        for name, place in names.items()
        if place[0] == place[1] or inertia[place] != 0.0
    }


def own_inertia(variant: Variant, axis: str) -> float:
    """Return the mass (kg), or inertia about the axis (kg m2), of the body that the axis carries."""
    body = carried_body(variant, axis)
    if not rotary(variant, axis):
        return body.mass
    direction = direction_of(variant, axis)
    return float(direction @ body.inertia @ direction)


def more_inertia(variant: Variant, axis: str, amount: float) -> dict[str, Any]:
    """
    Return the part of a description that adds mass (kg) or inertia (kg m2) to what an axis carries.

    Mass goes to the centre of gravity; inertia scales the whole tensor, so that it stays one that a
    body can have.
    """
    body = carried_body(variant, axis)
    if not rotary(variant, axis):
        return {'bodies': {body.name: {'mass_kg': body.mass + amount}}}
    scaled = body.inertia * (1.0 + amount / own_inertia(variant, axis))
    return {'bodies': {body.name: {'inertia_kg_m2': tensor_entries(scaled)}}}


def plain(variant: Variant, value: Any) -> Any:
    """Return a value of a description without where it comes from, of the damping in use."""
    if isinstance(value, dict):
        if 'value' in value:
            return value['value']
        if variant.damping in value:
            return value[variant.damping]
    return value
