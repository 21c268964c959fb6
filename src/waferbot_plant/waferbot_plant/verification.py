# SPDX-License-Identifier: Apache-2.0
"""
The plant checked: against the mathematical plant, as in chapter 3 of the thesis, and its energy.

Both plants get the same bodies; one works them out by Euler-Lagrange, the other by recursion over
the tree. The test of the thesis: 1 A on each axis in turn, no controller, and the accelerations
compared. Its two programs differed by 1.4e-5 %, 4.3e-4 % and 2.7e-3 %. Here the same, and random
machines, states and forces as well. Then the energy books: what the amplifiers supply is stored or
lost in a known place, and without losses nothing drifts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_plant import audit, lagrange, motors, plant
from waferbot_plant.lagrange.from_description import mathematical_parameters
from waferbot_plant.plant import Machine, load_machine

THESIS_DIFFERENCE_PERCENT = dict(zip(AXES, (1.4e-5, 4.3e-4, 2.7e-3), strict=True))
"""Difference of the thesis' two programs in acceleration under 1 A on the axis."""

DRIVING_VOLTAGE_V = (60.0, 60.0, 20.0)
DRIVING_RAD_PER_TICK = 1e-3
"""Amplitudes and (times 2, 3, 4) turning rate of the voltages that drive the energy check."""

DRIVING_CURRENT_A = 3.0
"""The current that voltages would drive through a winding at rest, where another machine is checked."""

FREE_SPEEDS = (0.05, 2.0, 3.0)
"""Speeds of the axes when they are let go without losses, m/s and rad/s."""

FREE_SPEED_OF_UNIT = {'m': 0.05, 'rad': 0.5}
"""Those of the axes of another machine, m/s or rad/s, by their unit."""


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


def random_agreement(seed: int, machines: int = 40, states: int = 25) -> float:
    """
    Return the largest relative difference of the two plants' accelerations over random draws.

    `machines` draws of all masses, centres of gravity, tensors, the rotor, the drive's ratio and
    the place of the Y-Rotate axis; for each, `states` draws of position, velocity and forces. The
    difference of the vector of accelerations is relative to its largest entry.
    """
    random = np.random.default_rng(seed)
    worst = 0.0
    expected, found = np.zeros(len(AXES)), np.zeros(len(AXES))
    names = tuple(load_machine('rigid').description.bodies)
    for _ in range(machines):
        machine = load_machine('machine', overlays=[_random_machine(random, names)])
        record = mathematical_parameters(machine.description)
        parameters = machine.parameters()
        state = machine.initial_state(parameters)
        for _ in range(states):
            position = random.uniform(-3.0, 3.0, 3)
            velocity = random.normal(0.0, [1.0, 4.0, 4.0])
            force = random.normal(0.0, [500.0, 50.0, 50.0])
            state[0]['position'][:3], state[0]['velocity'][:3] = position, velocity
            plant.acceleration(state, parameters, force, found)
            lagrange.forward_dynamics(position, velocity, force, record, expected)
            worst = max(worst, float(np.abs(found - expected).max() / np.abs(expected).max()))
    return worst


def _random_machine(random: np.random.Generator, names: Iterable[str]) -> dict[str, Any]:
    """Return an overlay that makes the shipped machine rigid, with random bodies and drive."""
    held = {
        'payload_guide': [f'payload_bearing_{axis}' for axis in 'xyz'],
        'counterweight_guide': [f'counterweight_bearing_{axis}' for axis in 'xyz'],
        'x_rotate': [f'x_rotate_bearing_{axis}' for axis in ('radial', 'y', 'z')],
        'x_rotate_shaft': ['x_rotate_shaft_torsion'],
    }
    joints: dict[str, Any] = {
        joint: {'freedoms': dict.fromkeys(freedoms)} for joint, freedoms in held.items()
    }
    joints['y_rotate'] = {'at_m': [float(random.uniform(0.1, 0.5)), 0, float(random.normal())]}
    ratio = float(random.uniform(2, 60))
    return {
        'bodies': {name: random_body(random) for name in names},
        'rotors': {'y_rotate_motor': {'inertia_kg_m2': float(random.uniform(1e-5, 1e-3))}},
        'connections': None,
        'frictions': None,
        'parts': None,
        'joints': joints,
        'transmissions': {
            'cable': {'stages': [{'kind': 'cable'}]},
            'y_rotate_drive': {'stages': [{'kind': 'gear', 'ratio': ratio}]},
        },
    }


def random_body(random: np.random.Generator) -> dict[str, Any]:
    """Return a body of a description, made of six random points of mass."""
    spread = random.normal(0.0, 0.15, (6, 3))
    weights = random.uniform(0.2, 3.0, 6)
    spread -= weights @ spread / weights.sum()
    tensor = sum(
        weight * (point @ point * np.eye(3) - np.outer(point, point))
        for weight, point in zip(weights, spread, strict=True)
    )
    return {
        'mass_kg': float(weights.sum()),
        'centre_of_gravity_m': random.uniform(-0.5, 0.5, 3).tolist(),
        'inertia_kg_m2': {
            axes: float(tensor['xyz'.index(axes[0]), 'xyz'.index(axes[1])])
            for axes in ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')
        },
    }


def energy_imbalance(machine: Machine, ticks: int = 9000) -> float:
    """
    Return energy supplied less stored less lost, over energy supplied, of a driven run.

    From rest, held, with slow three-phase voltages on all motors and every loss of the description
    at work.
    """
    parameters = machine.parameters()
    state = machine.initial_state(parameters, holding=True)
    before = audit.books(machine, state, parameters)
    amplitudes = _driving_voltages(machine)
    voltage = np.zeros(3 * len(amplitudes))
    lines = 2.0 * np.pi / 3.0 * np.arange(3)
    for tick in range(ticks):
        for motor, amplitude in enumerate(amplitudes):
            angle = DRIVING_RAD_PER_TICK * (2 + motor) * tick
            voltage[3 * motor : 3 * motor + 3] = amplitude * np.sin(angle - lines)
        plant.advance(state, parameters, voltage)
    after = audit.books(machine, state, parameters)
    return audit.imbalance(before, after) / sum(after.supplied.values())


def _driving_voltages(machine: Machine) -> tuple[float, ...]:
    """Return the amplitudes with which motors are driven, V; of other machines for a current."""
    if machine.layout.axes == AXES:
        return DRIVING_VOLTAGE_V
    found = machine.description.motors
    return tuple(
        DRIVING_CURRENT_A * found[axis].resistance if axis in found else 0.0
        for axis in machine.layout.axes
    )


def _free_speeds(machine: Machine) -> dict[str, float]:
    """Return the speeds with which axes are let go, m/s or rad/s."""
    if machine.layout.axes == AXES:
        return dict(zip(AXES, FREE_SPEEDS, strict=True))
    units = machine.description.axis_units
    return {axis: FREE_SPEED_OF_UNIT[unit] for axis, unit in units.items()}


def lossless_drift(machine: Machine, substeps: int, seconds: float = 1.0) -> float:
    """
    Return the largest change of stored energy over energy of motion, losses and motors taken out.

    The axes are let go with speed from home, so that everything that gives vibrates. `substeps`
    divide the tick: with twice as many the drift is about a quarter, as the step is of second
    order.
    """
    parameters = machine.parameters()
    p = parameters[0]
    for name in ('friction_resistance', 'spring_damping', 'cable_damping'):
        p[name] = 0.0
    p['step'] *= p['substeps'] / substeps
    p['substeps'] = substeps
    state = machine.initial_state(parameters)
    s = state[0]
    s['terminals_open'] = 1
    coordinates = list(machine.coordinates)
    for axis, speed in _free_speeds(machine).items():
        coordinate = machine.description.axes.get(axis)
        if coordinate in coordinates:
            s['velocity'][coordinates.index(coordinate)] = speed
    for item in machine.description.transmissions.values():
        if item.driving in coordinates and item.driven in machine.description.axes.values():
            driven = s['velocity'][coordinates.index(item.driven)]
            s['velocity'][coordinates.index(item.driving)] = driven / item.ratio
    stored = np.zeros(4)
    plant.energy(state, parameters, stored)
    start, motion = stored.sum(), stored[0]
    voltage = np.zeros(3 * len(machine.layout.axes))
    drift = 0.0
    for tick in range(machine.timing.ticks(seconds)):
        plant.advance(state, parameters, voltage)
        if tick % 10 == 0:
            plant.energy(state, parameters, stored)
            drift = max(drift, abs(float(stored.sum() - start)))
    return drift / float(motion)
