# SPDX-License-Identifier: Apache-2.0
"""
Inverse dynamics: what the motors must do for a motion of the axes.

With q(t) the positions of the axes, z what follows from them where nothing gives, and B the arms of
the motors,

    B F = M(z) z'' - h(z, z') + R(z, z') sign(z')

h are springs, dampers, cables, gravity, Coriolis and centrifugal forces and disturbances over position
and speed, R is sliding friction; where an axis is commanded to stand, friction is left out, as it may
hold either way. F are the forces (N) or torques (Nm) of the motors, and the current is what the motor
needs for it where it stands, with ripple and saturation if it has them.

Friction may grow with the motors' own force, mu |F| sign(z'); then F stands on both sides, row by row,

    F - R(F) sign(z') = what is needed without that part,

which rises with F, as a loss is less than all of it, and has one solution (Newton's steps).

Connections that give are taken as rigid: at most what a flexible machine needs below its first mode.
Disturbances over time, noise and a vibrating floor are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant import disturbances, friction_laws, motors, plant
from waferbot_plant.assembly import assemble
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine

Floats = NDArray[np.float64]

_OVER_MOTION = tuple(
    disturbances.KINDS[kind]
    for kind in (
        disturbances.CONSTANT, disturbances.PERIODIC, disturbances.POSITION, disturbances.VELOCITY
    )
)  # fmt: skip


MOST_STEPS = 50
"""Newton's steps for a force at most; where friction is in proportion to it, two or three are taken."""

NEAR = 1e-12
"""What is missing of a force in the end, as a share of it."""


class InverseDynamics:
    """The forces and currents that motions of a machine need; `axes` are those that have a motor."""

    def __init__(self, description: Description, timing: Timing | None = None) -> None:
        """
        Take the machine with every connection rigid.

        Raises `UserError` for one that is not sound, or of which an axis cannot move then, as what it
        drives is locked.
        """
        connections = {
            name: replace(part, flexible=False) for name, part in description.connections.items()
        }
        forces = {
            name: force
            for name, force in description.disturbances.items()
            if force.kind in _OVER_MOTION
        }
        rigid = replace(description, connections=connections, disturbances=forces)
        self.machine = Machine(rigid, assemble(rigid), timing or Timing())
        self.axes = tuple(axis for axis in rigid.axes if axis in rigid.motors)
        self._parameters = self.machine.parameters()
        # Bristles slide with the friction of their law, and what was cold is warm.
        for name in ('friction_bristle_stiffness', 'friction_cold_amplitude'):
            self._parameters[name] = 0.0
        self._state = self.machine.initial_state(self._parameters)
        size = len(self.machine.coordinates)
        placing = self.machine.assembly.placing
        for axis in self.axes:
            if placing[rigid.axes[axis]][0] in self.machine.assembly.locked:
                raise UserError(
                    f'{description.name}: what {axis} drives is locked, so with every connection '
                    'rigid it cannot move and has no inverse dynamics'
                )
        self._from_axes = np.zeros((size, len(self.axes)))
        self._arms = np.zeros((size, len(self.axes)))
        for column, axis in enumerate(self.axes):
            row, ratio = placing[rigid.axes[axis]]
            self._from_axes[row, column] = 1.0 / ratio
            row, ratio = placing[rigid.motors[axis].coordinate]
            self._arms[row, column] = ratio

    def forces(self, position: Floats, velocity: Floats, acceleration: Floats) -> Floats:
        """Return the motors' forces (n, axes), N or Nm, for motions (n, axes) of the axes, SI units."""
        motion = [
            np.ascontiguousarray(values @ self._from_axes.T)
            for values in (position, velocity, acceleration)
        ]
        needed = np.zeros(motion[0].shape)
        _needed(self._state.copy(), self._parameters, motion[0], motion[1], motion[2], needed)
        found, *_ = np.linalg.lstsq(self._arms, needed.T, rcond=None)
        return np.ascontiguousarray(found.T)

    def currents(self, position: Floats, velocity: Floats, acceleration: Floats) -> Floats:
        """
        Return the current commands (n, axes), A peak of the sine, for motions (n, axes) of the axes.

        NaN where a motor saturates before it makes the force.
        """
        forces = self.forces(position, velocity, acceleration)
        return np.column_stack(
            [
                self.current_of(axis, forces[:, column], position[:, column])
                for column, axis in enumerate(self.axes)
            ]
        )

    def current_of(self, axis: str, force: Floats, position: Floats) -> Floats:
        """Return the current command (n,), A, that makes forces (n,) at positions (n,) of an axis."""
        motor = self.machine.description.motors[axis]
        place = self.machine.layout.place(axis)
        if not self._parameters[0]['motor_imperfect'][place]:
            return np.asarray(force / motors.force_constant(motor))
        row, ratio = self.machine.assembly.placing[motor.coordinate]
        per_position = ratio * self._from_axes[row, self.axes.index(axis)] * motor.electrical_gain
        return np.array(
            [
                motors.current_of_force(self._parameters, place, per_position * at, one)
                for at, one in zip(position, force, strict=True)
            ]
        )


@compiled
def _friction(s, p, position, velocity, motors, found):
    """Fill `found` (coordinates,) with sliding friction against motions, where motors make `motors`."""
    for row in range(len(found)):
        s['external_force'][row] = motors[row]
    friction_laws.limit_lawful_friction(s, p, position, velocity, p['step'])
    for row in range(len(found)):
        s['external_force'][row] = 0.0
        found[row] = 0.0
        if velocity[row] > 0.0:
            found[row] = s['sliding_friction'][row] + s['sliding_tilt'][row]
        elif velocity[row] < 0.0:
            found[row] = s['sliding_tilt'][row] - s['sliding_friction'][row]


@compiled
def _friction_by_motors(s, p, position, velocity, without, friction):
    """
    Fill `friction` (coordinates,) with that which motors meet that need `without` (n,) beside it.

    By Newton's steps; slopes are over a millionth of the force.
    """
    size = len(friction)
    motors, more, beside = np.zeros(size), np.zeros(size), np.zeros(size)
    # What pushes from outside stands for a motor whose terminals are open.
    for motor in range(len(s['terminals_open'])):
        s['terminals_open'][motor] = 1
    _friction(s, p, position, velocity, motors, friction)
    for _ in range(MOST_STEPS):
        missing = 0.0
        for row in range(size):
            more[row] = motors[row] + 1e-6 * max(abs(motors[row]), abs(without[row]), 1e-9)
        _friction(s, p, position, velocity, more, beside)
        for row in range(size):
            left = without[row] + friction[row] - motors[row]
            slope = 1.0 - (beside[row] - friction[row]) / (more[row] - motors[row])
            motors[row] += left / (slope if slope > 0.0 else 1.0)
            missing = max(missing, abs(left) / max(abs(motors[row]), 1e-9))
        _friction(s, p, position, velocity, motors, friction)
        if missing <= NEAR:
            break
    for motor in range(len(s['terminals_open'])):
        s['terminals_open'][motor] = 0


@compiled
def _needed(state, parameters, position, velocity, acceleration, needed):
    """Fill `needed` (n, coordinates), the generalised forces of the motors, for motions of z."""
    s = state[0]
    p = parameters[0]
    size = position.shape[1]
    plant.find_imperfections(s, p)
    by_motors = False
    for one in range(p['frictions']):
        by_motors |= friction_laws.by_motor_force(p, one)
    result, without = np.zeros(size), np.zeros(size)
    friction, none = np.zeros(size), np.zeros(size)
    for sample in range(position.shape[0]):
        for row in range(size):
            s['position'][row] = position[sample, row]
            s['velocity'][row] = velocity[sample, row]
        plant.generalised_forces(state, parameters, result)
        for row in range(size):
            force = -result[row]
            for column in range(row + 1):
                force += s['mass_matrix'][row, column] * acceleration[sample, column]
            for column in range(row + 1, size):
                force += s['mass_matrix'][column, row] * acceleration[sample, column]
            without[row] = force
        if by_motors:
            _friction_by_motors(s, p, position[sample], velocity[sample], without, friction)
        else:
            _friction(s, p, position[sample], velocity[sample], none, friction)
        for row in range(size):
            needed[sample, row] = without[row] + friction[row]
