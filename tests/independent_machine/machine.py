# SPDX-License-Identifier: Apache-2.0
"""
A machine as its description has it, what is hidden in it, and the physics of both together.

All forces, masses and positions are at the axis, in N, kg, m where it slides, Nm, kg m2, rad where it
turns; of a geared axis the motor's own are told by `ratio`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from independent_machine.plant import Encoder, Loop, Physics

GRAVITY = 9.81

Hidden = Mapping[str, Mapping[str, float]]
"""Hidden effects by kind, each with its values; `independent_machine.answers` has their meaning."""


@dataclass(frozen=True)
class Machine:
    """
    What the machine's owner knows, and writes into the description.

    `kind` is linear (a slide on a linear motor), rotary (a table on a torque motor) or geared (a load
    behind a gear, the motor with an encoder of its own or not). A rotary axis that is `upright` turns
    about the vertical, a linear one moves along it; `centre` (m) is the centre of gravity off the axis
    at zero, along x and y, and gravity is along -y. `motor_inertia` is the rotor's own. `constant` is
    N/A or Nm/A (peak of the sine) at the motor, `cycle` electrical cycles per m or pole pairs.
    `gear_stiffness` (Nm/rad, at the output) is from the data sheet. Friction is what is known of it.
    """

    kind: str
    upright: bool
    mass: float
    inertia: float
    centre: tuple[float, float]
    motor_inertia: float
    ratio: float
    constant: float
    cycle: float
    gear_stiffness: float
    resolution: float
    motor_resolution: float
    coulomb: float
    viscous: float
    rated_force: float
    current_limit: float

    @property
    def linear(self) -> bool:
        """Whether the axis slides."""
        return self.kind == 'linear'

    @property
    def axis(self) -> str:
        """The name of the axis in waferbot's contract."""
        return {'linear': 'y_linear', 'rotary': 'x_rotate', 'geared': 'y_rotate'}[self.kind]

    @property
    def load(self) -> float:
        """Mass or inertia about the axis of what is beyond the gear."""
        if self.linear:
            return self.mass
        return self.inertia + self.mass * (self.centre[0] ** 2 + self.centre[1] ** 2)

    @property
    def motor(self) -> float:
        """Inertia of the motor at the axis."""
        return self.motor_inertia * self.ratio**2

    @property
    def total(self) -> float:
        """All that moves, at the axis."""
        return self.load + self.motor

    @property
    def axis_constant(self) -> float:
        """Force or torque at the axis per ampere."""
        return self.constant * self.ratio

    @property
    def has_gravity(self) -> bool:
        """Whether weight acts along the axis, or could: about one that is not vertical."""
        return self.upright if self.linear else not self.upright


FLANKS_STIFFER = 20.0
"""By how much flanks with play between them are stiffer than the whole gear by its data sheet."""

FLANK_LOSS = 0.3
"""Damping ratio of the mode of load and motor against one another, on flanks in contact."""

SOFT_LOSS = 0.03
"""The same of a coupling that is softer than it should be."""


def physics_of(machine: Machine, hidden: Hidden) -> Physics:
    """Return the mechanism of a machine with what is hidden in it."""
    of = dict(hidden)
    centre = list(machine.centre)
    if 'imbalance' in of:
        centre[0] += of['imbalance']['offset_x']
        centre[1] += of['imbalance']['offset_y']
    load = machine.mass
    if not machine.linear:
        load = machine.inertia + machine.mass * (centre[0] ** 2 + centre[1] ** 2)
    more = of.get('mass', {}).get('amount', 0.0)
    load += more
    constant = of.get('constant_force', {}).get('force', 0.0)
    cosine = sine = 0.0
    if machine.has_gravity and machine.linear:
        constant -= load * GRAVITY
    elif machine.has_gravity:
        cosine = -machine.mass * GRAVITY * centre[0]
        sine = machine.mass * GRAVITY * centre[1]
    forward = backward = machine.coulomb
    forward += of.get('coulomb', {}).get('friction', 0.0)
    backward += of.get('coulomb', {}).get('friction', 0.0)
    forward += of.get('direction_dependent', {}).get('forward', 0.0)
    backward += of.get('direction_dependent', {}).get('backward', 0.0)
    stribeck = of.get('stribeck', {})
    elastic = machine.kind == 'geared' and ('backlash' in of or 'compliance' in of)
    stiffness = FLANKS_STIFFER * machine.gear_stiffness
    if 'compliance' in of:
        stiffness = 1.0 / of['compliance']['compliance']
    reduced = machine.motor * load / (machine.motor + load) if machine.motor else load
    loss = SOFT_LOSS if 'compliance' in of else FLANK_LOSS
    damping = 2.0 * loss * math.sqrt(stiffness * reduced)
    return Physics(
        motor_mass=machine.motor,
        load_mass=load,
        elastic=elastic,
        stiffness=stiffness,
        damping=damping,
        gap=of.get('backlash', {}).get('gap', 0.0),
        coulomb_forward=forward,
        coulomb_backward=backward,
        breakaway=stribeck.get('breakaway', 0.0),
        stribeck_speed=stribeck.get('speed', 1.0),
        viscous=machine.viscous + of.get('viscous', {}).get('damping', 0.0),
        motor_coulomb=of.get('motor_coulomb', {}).get('friction', 0.0) * machine.ratio,
        motor_viscous=0.0,
        constant_force=constant,
        gravity_cosine=cosine,
        gravity_sine=sine,
        cogging=_cogging(machine, of.get('cogging', {})),
    )


def _cogging(machine: Machine, values: Mapping[str, float]) -> np.ndarray:
    """Return wave number at the axis, cosine and sine at the axis of every order."""
    orders = sorted({int(key.split('_')[1]) for key in values})
    per_order = 2.0 * math.pi * machine.cycle if machine.linear else machine.ratio
    rows = [
        (
            order * per_order,
            machine.ratio * values[f'cosine_{order}'],
            machine.ratio * values[f'sine_{order}'],
        )
        for order in orders
    ]
    return np.array(rows, float).reshape(len(rows), 3)


def encoders_of(
    machine: Machine, hidden: Hidden, rounds: bool, step_s: float
) -> tuple[Encoder, Encoder]:
    """Return the encoders of load and motor; the second is of no use where there is none."""
    none = {'cosine': 0.0, 'sine': 0.0, 'period': 1.0}
    own, of_motor = hidden.get('eccentricity', none), hidden.get('motor_eccentricity', none)
    late = round(hidden.get('encoder_delay', {}).get('delay_s', 0.0) / step_s)
    load = Encoder(
        1.0, machine.resolution, rounds, own['cosine'], own['sine'], own['period'], late
    )
    motor = Encoder(
        machine.ratio,
        machine.motor_resolution or machine.resolution,
        rounds,
        of_motor['cosine'],
        of_motor['sine'],
        of_motor['period'],
        0,
    )
    return load, motor


@dataclass(frozen=True)
class Tuning:
    """How a loop is set up: bandwidth of its speed loop (rad/s), form, feedforward (shares), lag."""

    bandwidth: float
    cascade: bool
    velocity_feedforward: float
    mass_feedforward: float
    position_on_motor: bool
    velocity_on_motor: bool
    lag_s: float


def loop_of(
    machine: Machine,
    hidden: Hidden,
    tuning: Tuning,
    start: float,
    tick_s: float,
    step_s: float,
) -> Loop:
    """
    Return the loop for the machine as it is known; what is hidden changes force and delay.

    It begins with what holds the known machine at `start`.
    """
    known_physics = physics_of(machine, {})
    weight = known_physics.constant_force
    weight += known_physics.gravity_cosine * math.cos(start)
    weight += known_physics.gravity_sine * math.sin(start)
    omega, total = tuning.bandwidth, machine.total
    filter_share = 1.0 - math.exp(-8.0 * omega * tick_s)
    if tuning.cascade:
        gains = omega / 4.0, total * omega, omega / 4.0
    else:
        own = omega / 2.5
        gains = total * own**2, 1.6 * total * own, own / 6.0
    known = machine.axis_constant
    return Loop(
        cascade=tuning.cascade,
        position_gain=gains[0],
        velocity_gain=gains[1],
        integral_rate=gains[2],
        velocity_feedforward=tuning.velocity_feedforward,
        mass_feedforward=tuning.mass_feedforward * total,
        filter_share=filter_share,
        position_on_motor=tuning.position_on_motor,
        velocity_on_motor=tuning.velocity_on_motor,
        known_constant=known,
        true_constant=known * hidden.get('motor_constant', {}).get('ratio', 1.0),
        limit=machine.current_limit,
        delay_steps=round(hidden.get('drive_delay', {}).get('delay_s', 0.0) / step_s),
        lag_s=tuning.lag_s,
        bias=-weight,
    )
