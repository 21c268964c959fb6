# SPDX-License-Identifier: Apache-2.0
"""
The machine as data: what a description file says, checked, in SI units.

A description is a YAML file of bodies, joints, rotors, transmissions, connections, friction,
motors, encoders and controllers; `description.schema.json` is its grammar, and units are in the keys.
Positions, axes and inertia tensors are given in the base frame (y up) at the **home pose**, in
which every coordinate is zero; so no chain of frames has to be worked out by hand.

- A **joint** lets a child body move against its parent, through freedoms one after another. A
  freedom `held_by` connections is no axis of the machine but the give of a part.
- A **transmission** ties two coordinates together by a ratio: gear, belt, cable over a pulley.
- A **connection** is the elastic part in a joint or in a stage of a transmission. Where its state
  is `rigid` it does not give; a freedom all of whose connections are rigid does not exist.
- A **rotor** is an inertia that spins about its own axis, driven through a transmission. As in the
  thesis (2.21) and in one-dimensional drive-train models it carries only the energy
  J * speed^2 / 2 of its own coordinate: the turning of the body that it is mounted on is not felt
  by it. Model it as a body on a revolute joint where that matters.

A file may say `extends: other.yaml` and then gives only what differs; a value of `null` takes away
what the other file has (`frictions: null` makes a machine frictionless), and it is an error to
take away what is not there.

A quantity may carry where it comes from, `{value: 3.1, from: ...}`, and may have two values,
`{calculated: 0.008, improved: 0.02, from: ...}`: the damping that follows from part data, and the
one that makes the machine behave as measured (thesis, chapter 6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import USUAL_TITLES, USUAL_UNITS
from waferbot_lockstep.layout import Layout, layout_of
from waferbot_plant.bearing_loads import BearingLoad
from waferbot_plant.imperfections import Disturbance, TransmissionError, Vibration
from waferbot_plant.spring_curves import SpringCurve

Vector = NDArray[np.float64]

LONGEST_DELAY = 15
"""Longest delay of an encoder that is counted in phase cycles, all in all."""

LONGEST_DELAY_S = 0.02
"""Longest delay of an encoder that is given as a time, beyond that, s."""

BASE = 'base'
"""Name of the body that does not move."""

DAMPING = ('calculated', 'improved')
"""The two sets of loss factors and friction; see the thesis, chapter 6."""

MULTIBODY, LAGRANGE = 'multibody', 'lagrange'
FORMULATIONS = (MULTIBODY, LAGRANGE)
"""By which equations a machine moves: recursion over its tree, or those of the thesis' Appendix B."""

STATES = ('rigid', 'flexible')
"""What a connection can be."""


@dataclass(frozen=True)
class Body:
    """A rigid body: mass in kg, centre of gravity in m, tensor about it in kg m2 (base frame)."""

    name: str
    mass: float
    centre_of_gravity: Vector
    inertia: Vector

    def equivalent_box(self) -> tuple[Vector, Vector]:
        """
        Return the box that has this mass and these moments of inertia: sides (m), axes (columns).

        A box of sides a, b, c has the moments m (b^2 + c^2) / 12, and so on. The axes are
        right-handed principal axes.
        """
        moments, axes = np.linalg.eigh(self.inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        squares = 6.0 * (moments.sum() - 2.0 * moments) / self.mass
        return np.sqrt(np.maximum(squares, 1e-6)), axes


@dataclass(frozen=True)
class Freedom:
    """
    One freedom of a joint: slide (m) along, or turn (rad) about, the unit vector `axis`.

    One that is `locked` is held still from outside, as an output that is bolted to a table.
    """

    name: str
    revolute: bool
    axis: Vector
    connections: tuple[str, ...]
    locked: bool = False


@dataclass(frozen=True)
class Joint:
    """The freedoms between two bodies; all of them act at the point `at`, m, base frame."""

    name: str
    parent: str
    child: str
    at: Vector
    freedoms: tuple[Freedom, ...]


@dataclass(frozen=True)
class Payload:
    """The payload (wafer) frame: a point `at` of a body, m, base frame, home pose."""

    body: str
    at: Vector


@dataclass(frozen=True)
class Rotor:
    """
    An inertia in kg m2 that spins about its own axis.

    Its angle is the coordinate `coordinate`: one of its own name, or one that it shares.
    """

    name: str
    inertia: float
    coordinate: str


@dataclass(frozen=True)
class Stage:
    """
    One stage of a transmission.

    `ratio` is motion out over motion in. `lever` turns a unit of the stage's motion out into the
    deflection in which its connection states its stiffness: 1, or for a belt the radius (m) of the
    driven pulley, because a belt is stretched in metres.
    """

    kind: str
    ratio: float
    lever: float
    connection: str | None


@dataclass(frozen=True)
class Transmission:
    """The coordinate `driven` follows `driving` times the product of the stages' ratios."""

    name: str
    driving: str
    driven: str
    stages: tuple[Stage, ...]
    error: TransmissionError | None = None

    @property
    def ratio(self) -> float:
        """Motion of the driven coordinate over motion of the driving one."""
        return math.prod(stage.ratio for stage in self.stages)

    @property
    def pulls_only(self) -> bool:
        """Whether it can pull only: a cable does not push."""
        return any(stage.kind == 'cable' for stage in self.stages)


@dataclass(frozen=True)
class Connection:
    """
    An elastic part: stiffness in N/m or Nm/rad, and its damping.

    Damping is either viscous (`damping`, N s/m or Nm s/rad) or structural (`loss_factor`), which
    becomes an equivalent viscous one at the part's first natural frequency, eq. (5.5). In that,
    the coordinates `free` may follow; in a joint, all others are held.

    One that is not `flexible` is rigid. The rest is what makes it more than a linear spring, in its
    own unit (see `spring_laws`): whole `gap` in m or rad, `hardening` in 1/m2 or 1/rad2, `slip` in N
    or Nm, a belt's `slack_preload` per strand in N; of a cable, `slack` in m beyond home, and
    `rope_mass` in kg. None: never. `part` is the part that the stiffness is of, `direction` that of a
    bearing or shaft; None where the stiffness is given. With a `curve` the force follows that; the
    stiffness is its slope at the static load then.
    """

    name: str
    flexible: bool
    rotary: bool
    stiffness: float
    damping: float | None
    loss_factor: float | None
    free: tuple[str, ...]
    gap: float = 0.0
    hardening: float = 0.0
    slip: float | None = None
    slack_preload: float | None = None
    slack: float = 0.0
    rope_mass: float = 0.0
    part: Any = None
    direction: str = ''
    curve: SpringCurve | None = None


@dataclass(frozen=True)
class Friction:
    """
    Dry friction on a coordinate: resistance (N or Nm) over speed (m/s or rad/s), both from zero
    up.

    Between the points it is interpolated, outside them held constant. `breakaway` multiplies the
    resistance at speed zero to give the peak of static friction. `law` has the parameters of
    `friction_laws` by name; those not in it are zero.

    `resistances` (n,) are over `speeds` (n,); of a map (m, n), a row for each of the `loads` (m,), which
    are magnitudes of the motors' force or torque on the same coordinate, N or Nm, from zero up; with a
    `bearing`, of the load that it bears, N.
    """

    name: str
    coordinate: str
    speeds: Vector
    resistances: Vector
    breakaway: float
    law: Mapping[str, float] = field(default_factory=dict)
    loads: Vector = field(default_factory=lambda: np.zeros(1))
    bearing: BearingLoad | None = None


@dataclass(frozen=True)
class Damper:
    """Viscous damping of a coordinate, N s/m or Nm s/rad, eq. (5.4)."""

    name: str
    coordinate: str
    damping: float


@dataclass(frozen=True)
class Motor:
    """
    A three-phase motor as its data sheet gives it: values from lead to lead.

    Resistance in ohm, inductance in H, `back_emf` the amplitude in V per m/s or rad/s,
    `electrical_gain` the electrical angle (rad) per m or rad of the coordinate; a pair of poles in a
    turn or in a metre stands for it where the poles are not `poles_known`. Imperfections, see
    `waferbot_plant.motors`: `saturation_current` in A, 0 for none; relative `phase_imbalance` of
    the windings 1 and 2.

    A motor that is known `by_force` alone has stand-ins for its windings: `motors.check_windings`
    refuses to put voltages on them. `lag` is the time constant, s, with which the force follows what the
    drive is told, where that is not modelled (`motors.lag_step`); an amplifier has its own.
    `peak_current` is what motor and drive can bear, A, infinite where nobody says; nothing limits it.
    """

    axis: str
    coordinate: str
    winding: str
    resistance: float
    inductance: float
    back_emf: float
    electrical_gain: float
    heating: Heating | None
    saturation_current: float
    ripple: tuple[Ripple, ...]
    phase_imbalance: tuple[float, float]
    by_force: bool = False
    lag: float = 0.0
    peak_current: float = math.inf
    poles_known: bool = True


@dataclass(frozen=True)
class Ripple:
    """Force and back-EMF times 1 + cosine cos(order theta) + sine sin(order theta), relative."""

    order: float
    cosine: float
    sine: float


@dataclass(frozen=True)
class Heating:
    """
    How a motor's windings warm up: one heat capacity on one resistance to the air about it.

    `to_air` in K/W, `capacity` in J/K, `air` and, of the windings, `start` in degC; the data sheet's
    winding resistance holds at `resistance_at` (degC) and rises by `coefficient` (1/K) of it. Copper
    has 0.00393 at 20 degC. `limit` (degC) is what the insulation bears, if that is known.
    """

    to_air: float
    capacity: float
    air: float
    resistance_at: float
    coefficient: float
    start: float
    limit: float | None = None


@dataclass(frozen=True)
class CyclicError:
    """An error of `amplitude` cos(2 pi x / `period` - `phase`); amplitude and period in one unit."""

    amplitude: float = 0.0
    period: float = 1.0
    phase: float = 0.0


@dataclass(frozen=True)
class EncoderErrors:
    """
    What is wrong with an encoder, none by default; see `waferbot_plant.encoders`.

    `scale` is relative; `eccentricity` in m or rad; `interpolation`, `coarseness`, `noise` (rms) and
    `lost_counts` in counts; `extra_delay` and `delay_fraction` in phase cycles, `delay` in s;
    `lost_every` in m or rad, 0 where nothing is lost.
    """

    scale: float = 0.0
    eccentricity: CyclicError = CyclicError()
    interpolation: CyclicError = CyclicError()
    coarseness: float = 1.0
    extra_delay: int = 0
    delay_fraction: float = 0.0
    delay: float = 0.0
    noise: float = 0.0
    noise_seed: int = 0
    lost_counts: float = 0.0
    lost_every: float = 0.0


@dataclass(frozen=True)
class Encoder:
    """
    An encoder at a place of the contract, in counts per m or per rad of a coordinate.

    `counting` says how readings in imported logs become whole counts: `floor`, `round`, or `average`
    (several rounded down, averaged); '' where nobody says. The contract's counts are rounded down.
    """

    place: str
    coordinate: str
    counts_per_unit: float
    errors: EncoderErrors
    counting: str = ''


@dataclass(frozen=True)
class CurrentSensors:
    """
    The errors of the current sensors of a motor, lines 1 and 2: relative gains; A; A rms.

    See `waferbot_plant.current_sensors`.
    """

    axis: str
    gains: tuple[float, float]
    offsets: tuple[float, float]
    noise: float
    noise_seed: int


@dataclass(frozen=True)
class Controller:
    """
    The controller of an axis by its law, for machines that no PMAC drives; see
    `description_controllers`.

    Gains are in the unit of the `output` (A, N, Nm, V, or a share of full scale) per unit of the axis,
    m or rad, and per s. `rate` and corner frequencies in Hz, times in s. Without a limit it is infinite,
    without a filter its frequency is 0. `drive_gain` is what the drive makes of a unit of the output, in
    `drive_unit` (A of the motor; N or Nm at the axis). Gains that the `kind` does not have are 0.
    """

    axis: str
    kind: str
    rate: float
    output: str
    drive_gain: float
    drive_unit: str
    output_limit: float = math.inf
    delay: float = 0.0
    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    derivative_filter: float = 0.0
    derivative_of: str = 'error'
    integral_limit: float = math.inf
    anti_windup: str = 'conditional'
    tracking_time: float = 0.0
    velocity_feedforward: float = 0.0
    acceleration_feedforward: float = 0.0
    position_gain: float = 0.0
    position_integral: float = 0.0
    position_integral_limit: float = math.inf
    velocity_limit: float = math.inf
    velocity_gain: float = 0.0
    velocity_integral: float = 0.0
    velocity_filter: float = 0.0

    @property
    def integrates(self) -> bool:
        """Whether it can hold a force without an error."""
        return self.integral > 0.0 or self.velocity_integral > 0.0 or self.position_integral > 0.0


@dataclass(frozen=True)
class Description:
    """
    A whole machine, checked.

    `revolute` tells for every coordinate whether it is an angle, `titles` for every axis of the contract
    what reports and plots call it: as the machine says, the usual title of one of which it says nothing.
    """

    name: str
    gravity: Vector
    substeps: int
    encoder_delay: int
    bodies: Mapping[str, Body]
    joints: Mapping[str, Joint]
    rotors: Mapping[str, Rotor]
    transmissions: Mapping[str, Transmission]
    connections: Mapping[str, Connection]
    frictions: Mapping[str, Friction]
    dampers: Mapping[str, Damper]
    disturbances: Mapping[str, Disturbance]
    vibration: Vibration
    axes: Mapping[str, str]
    motors: Mapping[str, Motor]
    encoders: Mapping[str, Encoder]
    current_sensors: Mapping[str, CurrentSensors]
    controllers: Mapping[str, Controller]
    parts: Mapping[str, Any]
    revolute: Mapping[str, bool]
    provenance: Mapping[str, str]
    formulation: str = MULTIBODY
    payload: Payload | None = None
    titles: Mapping[str, str] = field(default_factory=lambda: USUAL_TITLES)

    @cached_property
    def layout(self) -> Layout:
        """The axes and encoders, in the order of their places; see `layout_of`."""
        return layout_of(tuple(self.axes), tuple(self.encoders))

    @property
    def locked(self) -> frozenset[str]:
        """The coordinates that are held still from outside."""
        return frozenset(
            freedom.name
            for joint in self.joints.values()
            for freedom in joint.freedoms
            if freedom.locked
        )

    def turns(self, axis: str) -> bool:
        """
        Tell whether an axis turns (positions in rad, forces in Nm) or slides (m, N).

        The coordinate that it is says so, not its name. Raises `KeyError` for an axis that the
        machine lacks.
        """
        return self.revolute[self.axes[axis]]

    def motor_turns(self, axis: str) -> bool:
        """Tell whether the motor of an axis turns, as that of a belt or a screw that makes it slide."""
        return self.revolute[self.motors[axis].coordinate]

    def position_encoder(self, axis: str) -> str:
        """
        Return the encoder that positions an axis: of its places the first that there is.

        That behind the transmission comes before that on the motor. The first place where there is none.
        """
        places = self.layout.encoders_of(axis)
        return next((name for name in places if name in self.encoders), places[0])

    @property
    def axis_units(self) -> dict[str, str]:
        """Unit of each axis' position, `m` or `rad`; the usual one of an axis that the machine lacks."""
        own = {axis: 'rad' if self.turns(axis) else 'm' for axis in self.axes}
        return {axis: own.get(axis) or USUAL_UNITS[axis] for axis in self.layout.axes}
