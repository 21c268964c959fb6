# SPDX-License-Identifier: Apache-2.0
"""
The parts of the whole machine: read from YAML, their static loads, and Table 6.7.

`read_machine_parts` turns a file like `config/parts.yaml` into dataclasses; the keys of the file
are their fields. `element_frequencies` gives what Table 6.7 of the thesis lists: for each flexible
element the first frequency that is not zero, of that spring with the inertia that it carries,
everything else rigid. Couplings between elements through offset centres of gravity are no part of
these numbers; the modes of the whole mechanism therefore differ from them.

Each row takes this inertia:

- cable: payload against counterweight, both free (5.18);
- bearing of the counterweight: the counterweight about the bearing centre (5.26);
- bearing of the payload, about y and z: all bodies of the payload about the bearing centre (5.26);
- bearing of the payload, about x: only the bodies that do not turn with X-Rotate, because that
  axis is parallel to this spring, passes through its centre, and is free;
- X-Rotate bearing and shaft bending: the X-Rotate load with the Y-Rotate load on it (5.31);
- shaft torsion: that load against the motor's rotor, both free (5.29 is the case of a held rotor);
- gearbox and belt: Y-Rotate load against motor and gearbox, both free (5.36).
"""

from __future__ import annotations

import dataclasses
import math
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_plant.marked_yaml import Document, Key, read
from waferbot_plant.parts import (
    belt,
    cable,
    cross_roller_bearing,
    ferrofluid_seal,
    gearbox,
    linear_bearing,
    lip_seal,
    shaft,
    y_rotate_bearings,
)
from waferbot_plant.parts.bodies import (
    Body,
    Point,
    centre_of_gravity_m,
    inertia_about_kg_m2,
    total_mass_kg,
)
from waferbot_plant.parts.checks import require_finite, require_positive
from waferbot_plant.parts.friction import SpeedFriction
from waferbot_plant.parts.vibration import free_pair_frequency, grounded_frequency, hertz

DAMPING = ('calculated', 'improved')
"""Damping from part data alone, and as the thesis raised it until the loops were stable."""


@dataclass(frozen=True)
class Places:
    """
    Centres of the bearings and a point of the Y-Rotate axis: base frame, zero pose, in m.

    The X-Rotate axis is the line y = z = 0. Raises `UserError` for a point that must lie on it and
    does not.
    """

    payload_bearing_m: Point
    counterweight_bearing_m: Point
    x_rotate_bearing_m: Point
    y_rotate_axis_m: Point

    def __post_init__(self) -> None:
        """Check the data; the X-Rotate axis has to pass through the payload bearing's centre."""
        for field in dataclasses.fields(self):
            for coordinate in getattr(self, field.name):
                require_finite(coordinate, f'places: {field.name}')
        for name in ('payload_bearing_m', 'x_rotate_bearing_m'):
            if getattr(self, name)[1:] != (0.0, 0.0):
                raise UserError(
                    f'places: {name} is {getattr(self, name)!r}; y and z must be 0, as it lies on '
                    'the X-Rotate axis.'
                )


@dataclass(frozen=True)
class Bodies:
    """The bodies of the machine; the X-Rotate load carries the Y-Rotate load."""

    carriage: Body
    x_rotate_stator_part: Body
    x_rotate_load: Body
    y_rotate_load: Body
    counterweight: Body

    @property
    def fixed_to_carriage(self) -> tuple[Body, ...]:
        """Return the bodies that move with Y-Linear and do not turn with X-Rotate."""
        return self.carriage, self.x_rotate_stator_part

    @property
    def on_x_rotate(self) -> tuple[Body, ...]:
        """Return the bodies that turn with X-Rotate, without the motor's rotor."""
        return self.x_rotate_load, self.y_rotate_load

    @property
    def payload(self) -> tuple[Body, ...]:
        """Return all bodies on the payload side of the cables."""
        return self.fixed_to_carriage + self.on_x_rotate


@dataclass(frozen=True)
class Rotors:
    """Moments of inertia of the motors' rotors about their axes in kg m2."""

    x_rotate_kg_m2: float
    y_rotate_kg_m2: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.x_rotate_kg_m2, 'rotors: x_rotate_kg_m2')
        require_positive(self.y_rotate_kg_m2, 'rotors: y_rotate_kg_m2')


@dataclass(frozen=True)
class MachineParts:
    """
    Everything that the stiffnesses and frictions of the machine follow from.

    `y_rotate_output_friction_factor` multiplies the friction at the Y-Rotate output: 1 as
    calculated, more where the thesis lumps unknown losses of gearbox and belt there.
    """

    places: Places
    bodies: Bodies
    rotors: Rotors
    cable: cable.Cable
    payload_bearing: linear_bearing.LinearBearing
    counterweight_bearing: linear_bearing.LinearBearing
    x_rotate_bearing: cross_roller_bearing.CrossRollerBearing
    x_rotate_shaft: shaft.Shaft
    ferrofluid_seal: ferrofluid_seal.FerrofluidSeal
    gearbox: gearbox.Gearbox
    belt: belt.Belt
    lip_seal: lip_seal.LipSeal
    y_rotate_bearings: y_rotate_bearings.YRotateBearings
    y_rotate_output_friction_factor: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.y_rotate_output_friction_factor, 'y_rotate_output_friction_factor')

    @property
    def motor_side_inertia_kg_m2(self) -> float:
        """Return J_1 of (5.36): Y-Rotate rotor and gearbox at the gearbox output, in kg m2."""
        at_input = self.rotors.y_rotate_kg_m2 + self.gearbox.input_inertia_kg_m2
        return at_input * self.gearbox.ratio**2

    @property
    def y_rotate_inertia_kg_m2(self) -> float:
        """Return J_2 of (5.36): the Y-Rotate load about its axis, in kg m2."""
        return inertia_about_kg_m2((self.bodies.y_rotate_load,), self.places.y_rotate_axis_m)[1]


def read_machine_parts(path: Path, damping: str = 'calculated') -> MachineParts:
    """
    Read the parts from a YAML file.

    A quantity is a number or a list of numbers, or `{value: ..., from: ...}`, or `{calculated:
    ..., improved: ..., from: ...}` of which `damping` chooses one. Raises `UserError` naming file,
    line and key for an unknown or missing key and for a value out of range.
    """
    if damping not in DAMPING:
        raise UserError(f'damping is {damping!r}; choose one of {", ".join(DAMPING)}.')
    document = read(path)
    return _read_dataclass(MachineParts, document.data, document, (), damping)


def _read_dataclass(kind: Any, data: Any, document: Document, key: Key, damping: str) -> Any:
    """Build the dataclass `kind` from a mapping whose keys are its fields."""
    types = typing.get_type_hints(kind)
    if not isinstance(data, dict):
        raise document.error(key, f'must be a mapping with the keys {", ".join(types)}')
    for name in data:
        if name not in types:
            raise document.error((*key, name), f'unknown key; choose from {", ".join(types)}')
    for name in types:
        if name not in data:
            raise document.error(key, f'the key {name} is missing')
    values = {}
    for name, inner in types.items():
        if dataclasses.is_dataclass(inner):
            values[name] = _read_dataclass(inner, data[name], document, (*key, name), damping)
        else:
            values[name] = _read_quantity(inner, data[name], document, (*key, name), damping)
    try:
        return kind(**values)
    except UserError as error:
        raise document.error(key, str(error)) from None


def _read_quantity(kind: Any, data: Any, document: Document, key: Key, damping: str) -> Any:
    """Return a number, or a tuple of numbers, out of its wrapping."""
    if isinstance(data, dict):
        chosen = 'value' if 'value' in data else damping
        allowed = {'value', 'from'} if chosen == 'value' else {*DAMPING, 'from'}
        if not set(data) <= allowed or chosen not in data:
            raise document.error(
                key, 'write a number, {value, from}, or {calculated, improved, from}'
            )
        data = data[chosen]
    numbers = data if isinstance(data, list) else [data]
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, (int, float)):
            raise document.error(key, f'{number!r} is not a number')
    if typing.get_origin(kind) is not tuple:
        if isinstance(data, list):
            raise document.error(key, 'is a list; give one number')
        return data
    if not isinstance(data, list) or (kind == Point and len(data) != 3):
        raise document.error(key, 'give a list of numbers (three for a point)')
    return tuple(float(number) for number in data)


@dataclass(frozen=True)
class StaticLoads:
    """What gravity and belt tension put on the bearings at a pose."""

    payload_block: linear_bearing.BlockLoad
    counterweight_block: linear_bearing.BlockLoad
    x_rotate_bearing: cross_roller_bearing.CrossRollerLoad


def static_loads(
    parts: MachineParts, x_rotate_rad: float = 0.0, y_rotate_rad: float = 0.0
) -> StaticLoads:
    """
    Return the static loads on guides and cross-roller bearing at a pose.

    Y-Rotate turns its load about y through `places.y_rotate_axis_m`, X-Rotate then turns both
    loads about the x axis; both by the right-hand rule. The position of Y-Linear does not matter.
    """
    places = parts.places
    load = parts.bodies.y_rotate_load
    turned = _turned_about_y(load, places.y_rotate_axis_m, y_rotate_rad)
    on_x_rotate = tuple(
        _turned_about_x(body, x_rotate_rad) for body in (parts.bodies.x_rotate_load, turned)
    )
    payload = parts.bodies.fixed_to_carriage + on_x_rotate
    x_m, _, z_m = centre_of_gravity_m(payload)
    overhang_m = centre_of_gravity_m(on_x_rotate)[0] - places.x_rotate_bearing_m[0]
    counterweight = parts.bodies.counterweight
    return StaticLoads(
        payload_block=linear_bearing.static_block_load(
            total_mass_kg(payload),
            x_m - places.payload_bearing_m[0],
            z_m - places.payload_bearing_m[2],
            parts.payload_bearing.vertical_spacing_m,
        ),
        counterweight_block=linear_bearing.static_block_load(
            counterweight.mass_kg,
            counterweight.centre_of_gravity_m[0] - places.counterweight_bearing_m[0],
            counterweight.centre_of_gravity_m[2] - places.counterweight_bearing_m[2],
            parts.counterweight_bearing.vertical_spacing_m,
        ),
        x_rotate_bearing=cross_roller_bearing.static_load(total_mass_kg(on_x_rotate), overhang_m),
    )


def _turned_about_y(body: Body, axis_m: Point, angle_rad: float) -> Body:
    """Return the body at its new place; its own moments of inertia are not turned."""
    x_m, y_m, z_m = (body.centre_of_gravity_m[i] - axis_m[i] for i in range(3))
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    place = (
        axis_m[0] + cosine * x_m + sine * z_m,
        axis_m[1] + y_m,
        axis_m[2] - sine * x_m + cosine * z_m,
    )
    return dataclasses.replace(body, centre_of_gravity_m=place)


def _turned_about_x(body: Body, angle_rad: float) -> Body:
    """Return the body at its new place; its own moments of inertia are not turned."""
    x_m, y_m, z_m = body.centre_of_gravity_m
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    place = (x_m, cosine * y_m - sine * z_m, sine * y_m + cosine * z_m)
    return dataclasses.replace(body, centre_of_gravity_m=place)


@dataclass(frozen=True)
class Frictions:
    """Friction against the motion of each axis, at the zero pose."""

    payload_guide_n: float
    counterweight_guide_n: float
    x_rotate: SpeedFriction
    y_rotate_gearbox_input: SpeedFriction
    y_rotate_output_nm: float


def frictions(parts: MachineParts) -> Frictions:
    """
    Return the friction of all parts: guides in N, rotary axes in Nm and Nm s/rad.

    The gearbox' friction acts at its input shaft (the motor), the output friction (lip seal and
    shaft bearings, times `y_rotate_output_friction_factor`) on the Y-Rotate load, both Coulomb at
    all loads.
    """
    loads = static_loads(parts)
    y_load = parts.bodies.y_rotate_load
    shaft_loads = y_rotate_bearings.static_loads(
        parts.y_rotate_bearings,
        y_load.mass_kg,
        y_load.centre_of_gravity_m[0] - parts.places.y_rotate_axis_m[0],
        y_load.centre_of_gravity_m[2] - parts.places.y_rotate_axis_m[2],
        belt.shaft_force_n(parts.belt),
    )
    output_nm = lip_seal.drag_torque_nm(parts.lip_seal) + y_rotate_bearings.friction_torque_nm(
        parts.y_rotate_bearings, shaft_loads
    )
    bearing_nm = cross_roller_bearing.friction_torque_nm(
        parts.x_rotate_bearing, loads.x_rotate_bearing
    )
    return Frictions(
        payload_guide_n=linear_bearing.travel_friction_n(
            parts.payload_bearing, loads.payload_block
        ),
        counterweight_guide_n=linear_bearing.travel_friction_n(
            parts.counterweight_bearing, loads.counterweight_block
        ),
        x_rotate=ferrofluid_seal.drag(parts.ferrofluid_seal, bearing_nm),
        y_rotate_gearbox_input=gearbox.no_load_friction(parts.gearbox),
        y_rotate_output_nm=output_nm * parts.y_rotate_output_friction_factor,
    )


@dataclass(frozen=True)
class ElementFrequency:
    """
    One row of Table 6.7.

    `stiffness` in N/m with `inertia` in kg for translation, in Nm/rad with kg m2 for rotation
    (then `rotary` is true). `inertia` is the equivalent one: stiffness / (2 pi frequency)^2, which
    for a free pair is m1 m2/(m1 + m2).
    """

    element: str
    rotary: bool
    stiffness: float
    inertia: float

    @property
    def frequency_hz(self) -> float:
        """Return the first frequency that is not zero, in Hz."""
        return hertz(grounded_frequency(self.stiffness, self.inertia))


def element_frequencies(parts: MachineParts) -> tuple[ElementFrequency, ...]:
    """Return the thirteen rows of Table 6.7 in its order; the module's text tells the inertias."""
    bodies, places = parts.bodies, parts.places
    loads = static_loads(parts)
    counterweight = linear_bearing.moment_stiffness(
        parts.counterweight_bearing, loads.counterweight_block
    )
    payload = linear_bearing.moment_stiffness(parts.payload_bearing, loads.payload_block)
    x_rotate = cross_roller_bearing.stiffness(parts.x_rotate_bearing, loads.x_rotate_bearing)

    payload_kg = total_mass_kg(bodies.payload)
    load_kg = total_mass_kg(bodies.on_x_rotate)
    about_counterweight = inertia_about_kg_m2(
        (bodies.counterweight,), places.counterweight_bearing_m
    )
    about_payload = inertia_about_kg_m2(bodies.payload, places.payload_bearing_m)
    carriage_about_x = inertia_about_kg_m2(bodies.fixed_to_carriage, places.payload_bearing_m)[0]
    about_x_bearing = inertia_about_kg_m2(bodies.on_x_rotate, places.x_rotate_bearing_m)

    cable_stiffness = cable.effective_stiffness_n_per_m(parts.cable)
    torsion = shaft.torsional_stiffness_nm_per_rad(parts.x_rotate_shaft)
    drive = belt.drive_stiffness_nm_per_rad(
        parts.belt, gearbox.torsional_stiffness_nm_per_rad(parts.gearbox)
    )
    motor_at_payload = parts.motor_side_inertia_kg_m2 * parts.belt.ratio**2

    def row(element: str, rotary: bool, stiffness: float, inertia: float) -> ElementFrequency:
        return ElementFrequency(element, rotary, stiffness, inertia)

    def pair(first: float, second: float) -> float:
        return 1.0 / free_pair_frequency(1.0, first, second) ** 2

    return (
        row('cable', False, cable_stiffness, pair(payload_kg, bodies.counterweight.mass_kg)),
        row(
            'counterweight bearing, about x',
            True,
            counterweight.about_x_nm_per_rad,
            about_counterweight[0],
        ),
        row(
            'counterweight bearing, about y',
            True,
            counterweight.about_y_nm_per_rad,
            about_counterweight[1],
        ),
        row(
            'counterweight bearing, about z',
            True,
            counterweight.about_z_nm_per_rad,
            about_counterweight[2],
        ),
        row('payload bearing, about x', True, payload.about_x_nm_per_rad, carriage_about_x),
        row('payload bearing, about y', True, payload.about_y_nm_per_rad, about_payload[1]),
        row('payload bearing, about z', True, payload.about_z_nm_per_rad, about_payload[2]),
        row('x_rotate bearing, radial y', False, x_rotate.radial_y_n_per_m, load_kg),
        row('x_rotate bearing, about y', True, x_rotate.about_y_nm_per_rad, about_x_bearing[1]),
        row('x_rotate bearing, about z', True, x_rotate.about_z_nm_per_rad, about_x_bearing[2]),
        row(
            'x_rotate shaft, torsion',
            True,
            torsion,
            pair(about_x_bearing[0], parts.rotors.x_rotate_kg_m2),
        ),
        row(
            'x_rotate shaft, bending',
            False,
            shaft.bending_stiffness_n_per_m(parts.x_rotate_shaft),
            load_kg,
        ),
        row(
            'y_rotate gearbox and belt',
            True,
            drive,
            pair(motor_at_payload, parts.y_rotate_inertia_kg_m2),
        ),
    )
