# SPDX-License-Identifier: Apache-2.0
"""
Statics: where the machine rests when its axes are held, and what holds it.

With the axes at given positions, all other coordinates are where springs and gravity balance, and
the motors' forces F are what is left over on their coordinates:

    springs(z) + gravity(z) + B F = 0,     z of the axes given.

Solved for the other coordinates and F by Newton's method with the elastic stiffness as slope;
gravity changes the slope by parts in a thousand, so that each iteration gains about three digits.
Dry friction is left out: it could hold more or less.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant import elements, motors, plant, spring_laws
from waferbot_plant.plant import Machine

_ITERATIONS = 60


class NoEquilibrium(UserError):
    """The machine cannot be held: a coordinate has neither a motor nor a spring on it."""


def settle(
    machine: Machine,
    state: NDArray[np.void],
    parameters: NDArray[np.void],
    positions: Mapping[str, float],
    holding: bool,
) -> None:
    """
    Put `state` at rest with the axes at `positions` (m, rad; home where not given).

    With `holding`, the windings get the currents that hold it. Raises `UserError` for an unknown
    axis, and where holding is asked of an axis that has no motor.
    """
    description = machine.description
    for axis in positions:
        if axis not in description.axes:
            raise UserError(
                f'{description.name} has no axis {axis!r}{did_you_mean(axis, description.axes)}'
            )
    s = state[0]
    s['velocity'] = 0.0
    s['position'][: len(machine.coordinates)] = _with_axes_at(machine, positions)
    forces = _balance(machine, state, parameters, holding or any(positions.values()))
    s['winding_current'] = 0.0
    if not holding:
        return
    for axis, force in forces.items():
        place = machine.layout.place(axis)
        angle = _electrical_angle(machine, state, axis)
        amplitude = _amplitude(machine, parameters, axis, force, angle)
        lines = amplitude * np.sin(angle - 2.0 * np.pi / 3.0 * np.arange(2))
        motors.set_line_currents(state, parameters, place, (float(lines[0]), float(lines[1])))


def holding_forces(
    machine: Machine, parameters: NDArray[np.void], positions: Mapping[str, float]
) -> dict[str, float]:
    """Return the force (N) or torque (Nm) of each motor that holds the axes at `positions`."""
    return _held(machine, parameters, positions)[1]


def holding_currents(
    machine: Machine, parameters: NDArray[np.void], positions: Mapping[str, float]
) -> dict[str, float]:
    """Return the current command, A peak of sine, that holds each axis at `positions`."""
    state, forces = _held(machine, parameters, positions)
    return {
        axis: _amplitude(machine, parameters, axis, force, _electrical_angle(machine, state, axis))
        for axis, force in forces.items()
    }


def _held(
    machine: Machine, parameters: NDArray[np.void], positions: Mapping[str, float]
) -> tuple[NDArray[np.void], dict[str, float]]:
    """Return the state of equilibrium with the axes at `positions`, and the motors' forces."""
    state = np.zeros(1, machine.state_dtype)
    state[0]['position'][: len(machine.coordinates)] = _with_axes_at(machine, positions)
    forces = _balance(machine, state, parameters, True)
    return state, forces


def _electrical_angle(machine: Machine, state: NDArray[np.void], axis: str) -> float:
    """Return the electrical angle of an axis' motor at a state, rad."""
    motor = machine.description.motors[axis]
    row, ratio = machine.assembly.placing[motor.coordinate]
    return float(motor.electrical_gain * ratio * state[0]['position'][row])


def _amplitude(
    machine: Machine, parameters: NDArray[np.void], axis: str, force: float, angle: float
) -> float:
    """Return the amplitude of line currents (A) with which a motor makes a force (N, Nm)."""
    place = machine.layout.place(axis)
    if not parameters[0]['motor_imperfect'][place]:
        return force / motors.force_constant(machine.description.motors[axis])
    amplitude = motors.current_of_force(parameters, place, angle, force)
    if not np.isfinite(amplitude):
        raise NoEquilibrium(
            f'{machine.description.name}: the motor of {axis} cannot hold {force:.4g} N or Nm: '
            f'it saturates (motors.{axis}.saturation_current_a)'
        )
    return amplitude


def reactions(
    machine: Machine, state: NDArray[np.void], parameters: NDArray[np.void]
) -> dict[str, float]:
    """
    Return the force of every flexible element at a state, by name: N of cables, N or Nm of
    springs.

    Positive where a deflection in the positive sense would load the spring, and for tension.
    """
    s, p = state[0], parameters[0]
    spring_laws.find_spring_laws(s, p)
    elements.judge_cables(s, p, s['position'], s['velocity'])
    found = {
        element.name: spring_laws.force_and_arms_now(s, p, place, s['position'], s['velocity'])[0]
        for place, element in enumerate(machine.assembly.springs)
        if element.connections
    }
    for place, element in enumerate(machine.assembly.cables):
        found[element.name] = elements.cable_tension(s, p, place, s['position'], s['velocity'])
    return found


def elastic_stiffness(
    machine: Machine,
    parameters: NDArray[np.void] | None = None,
    state: NDArray[np.void] | None = None,
) -> NDArray[np.float64]:
    """
    Return the stiffness matrix of springs and taut cables, (n, n), N/m, N/rad or Nm/rad.

    That of the description, or of `parameters` where given; with `state`, springs that are not linear
    have their slope there.
    """
    p = (machine.parameters() if parameters is None else parameters)[0]
    size = len(machine.coordinates)
    stiffness = np.zeros((size, size))
    for kind, two_sided in (
        ('spring', machine.assembly.springs),
        ('cable', machine.assembly.cables),
    ):
        for spring, element in enumerate(two_sided):
            arms = np.zeros(size)
            for place, ratio in element.terms:
                arms[place] += ratio
            slope = p[f'{kind}_stiffness'][spring]
            if state is not None and kind == 'spring':
                slope = spring_laws.stiffness_now(state[0], p, spring, state[0]['position'])
            stiffness += slope * np.outer(arms, arms)
    return stiffness


def _with_axes_at(machine: Machine, positions: Mapping[str, float]) -> NDArray[np.float64]:
    """Return z with the axes at their positions and what is driven or driving along with them."""
    position = np.zeros(len(machine.coordinates))
    placing = machine.assembly.placing
    known = set()
    for axis, coordinate in machine.description.axes.items():
        place, ratio = machine.assembly.placing[coordinate]
        position[place] = positions.get(axis, 0.0) / ratio
        known.add(coordinate)
    transmissions = list(machine.description.transmissions.values())
    for _ in transmissions:
        for transmission in transmissions:
            ends = transmission.driving, transmission.driven
            for (one, other), factor in (
                (ends, transmission.ratio),
                (ends[::-1], 1 / transmission.ratio),
            ):
                if one in known and other not in known:
                    place, ratio = machine.assembly.placing[one]
                    value = position[place] * ratio * factor
                    place, ratio = machine.assembly.placing[other]
                    position[place] = value / ratio
                    known.add(other)
    for cable in machine.assembly.cables:
        (driving, ratio), (rope, _) = cable.terms
        if machine.coordinates[rope] not in placing:
            position[rope] = ratio * position[driving]
    return position


def _balance(
    machine: Machine, state: NDArray[np.void], parameters: NDArray[np.void], needed: bool
) -> dict[str, float]:
    """Move what gives in `state` to equilibrium and return the motors' forces; see the module."""
    description = machine.description
    placing = machine.assembly.placing
    size = len(machine.coordinates)
    given = {placing[coordinate][0] for coordinate in description.axes.values()}
    free = [place for place in range(size) if place not in given]
    axes = [axis for axis in description.axes if axis in description.motors]
    arms = np.zeros((size, len(axes)))
    for column, axis in enumerate(axes):
        row, ratio = placing[description.motors[axis].coordinate]
        arms[row, column] = ratio
    if not needed and not free:
        return {}
    forces = np.zeros(len(axes))
    residual = np.zeros(size)
    slope = None
    for _ in range(_ITERATIONS):
        plant.generalised_forces(state, parameters, residual)
        if slope is None or state[0]['any_spring_law']:
            stiffness = elastic_stiffness(machine, parameters, state)
            slope = np.hstack([stiffness[:, free], -arms])
        unbalanced = residual + arms @ forces
        correction, _, rank, _ = np.linalg.lstsq(slope, unbalanced, rcond=1e-14)
        if rank < slope.shape[1] or np.abs(slope @ correction - unbalanced).max() > 1e-6 * (
            1.0 + np.abs(unbalanced).max()
        ):
            if not needed:
                return {}
            raise NoEquilibrium(
                f'{description.name}: no static equilibrium; '
                'a coordinate is held neither by a motor nor by a spring'
            )
        state[0]['position'][free] += correction[: len(free)]
        forces += correction[len(free) :]
        if np.abs(unbalanced).max() < 1e-10 * (1.0 + np.abs(residual).max()):
            break
    return dict(zip(axes, forces.tolist(), strict=True))
