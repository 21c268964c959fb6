# SPDX-License-Identifier: Apache-2.0
"""
From the parts named in a description to stiffness, loss factor and friction.

A part is given by what its supplier or drawing states; `parts` holds the equations. Here they are
applied: which kinds there are, what each gives, and which static load of the machine at home a
bearing's secant stiffness is taken at. The equations of guides and cross-roller bearings have the
machine's directions in them: gravity along -y, rails along y, X-Rotate along x.
"""

from __future__ import annotations

import dataclasses
import pickle
import typing
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Document, Key
from waferbot_lockstep.parameters import did_you_mean
from waferbot_plant.bearing_loads import BearingLoad, guide_amounts, ring_amounts
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
from waferbot_plant.parts.belt import Belt
from waferbot_plant.parts.cable import Cable
from waferbot_plant.parts.cross_roller_bearing import CrossRollerBearing
from waferbot_plant.parts.ferrofluid_seal import FerrofluidSeal
from waferbot_plant.parts.friction import SpeedFriction
from waferbot_plant.parts.gearbox import Gearbox
from waferbot_plant.parts.linear_bearing import LinearBearing
from waferbot_plant.parts.lip_seal import LipSeal
from waferbot_plant.parts.shaft import Shaft
from waferbot_plant.parts.y_rotate_bearings import YRotateBearings
from waferbot_plant.spring_curves import SpringCurve

KINDS: dict[str, type] = {
    'cable': Cable,
    'linear_bearing': LinearBearing,
    'cross_roller_bearing': CrossRollerBearing,
    'shaft': Shaft,
    'ferrofluid_seal': FerrofluidSeal,
    'gearbox': Gearbox,
    'belt': Belt,
    'lip_seal': LipSeal,
    'y_rotate_bearings': YRotateBearings,
}
"""Kinds of part, with the dataclass whose fields are the keys of the file."""


@dataclass(frozen=True)
class Carried:
    """What hangs on a joint at home: mass in kg, centre of gravity from the joint's point in m."""

    mass: float
    x: float
    z: float


def read_part(document: Document, key: Key, data: dict[str, Any]) -> Any:
    """Build a part from its mapping; raises `UserError` naming file, line and key."""
    try:
        return _part(pickle.dumps(data))
    except UserError:  # said again, with the place in this document
        return _of_kind(document, key, data)


@lru_cache(maxsize=256)
def _part(pickled: bytes) -> Any:
    """Build a part; remembered, since descriptions by the thousand have the same ones."""
    return _of_kind(Document({}), (), pickle.loads(pickled))


def _of_kind(document: Document, key: Key, data: dict[str, Any]) -> Any:
    values = dict(data)
    return _build(document, key, KINDS[values.pop('kind')], values)


_fields = lru_cache(maxsize=None)(typing.get_type_hints)
"""Names and types of the fields of a part."""


def _build(document: Document, key: Key, kind: type, data: Any) -> Any:
    """Build the dataclass `kind` from a mapping whose keys are its fields."""
    if not isinstance(data, dict):
        raise document.error(key, 'must be a mapping')
    types = _fields(kind)
    for name in data:
        if name not in types:
            raise document.error((*key, name), f'unknown key{did_you_mean(name, types)}')
    optional = {field.name for field in dataclasses.fields(kind) if field.default is None}
    missing = [name for name in types if name not in data and name not in optional]
    if missing:
        raise document.error(key, f'{" and ".join(missing)} missing')
    values = {}
    for name, inner in types.items():
        if name not in data:
            continue
        value = data[name]
        if dataclasses.is_dataclass(inner):
            values[name] = _build(document, (*key, name), typing.cast(type, inner), value)
            continue
        wants_list = typing.get_origin(inner) is tuple
        numbers = value if isinstance(value, list) else [value]
        for number in numbers:
            if isinstance(number, bool) or not isinstance(number, (int, float)):
                raise document.error((*key, name), f'is {number!r}; it must be a number')
        if wants_list != isinstance(value, list):
            wanted = 'a list of numbers' if wants_list else 'one number'
            raise document.error((*key, name), f'must be {wanted}')
        values[name] = tuple(value) if wants_list else value
    try:
        return kind(**values)
    except UserError as error:
        raise document.error(key, str(error)) from None


def directions(part: Any) -> tuple[str, ...]:
    """Return in which directions a part has a stiffness; one without a name needs none."""
    if isinstance(part, LinearBearing):
        return 'about_x', 'about_y', 'about_z'
    if isinstance(part, CrossRollerBearing):
        return 'radial_y', 'about_y', 'about_z'
    if isinstance(part, Shaft):
        return 'torsion', 'bending'
    return ('',) if isinstance(part, (Cable, Gearbox, Belt)) else ()


def stiffness(part: Any, direction: str, carried: Callable[[], Carried]) -> tuple[float, bool]:
    """
    Return the stiffness of a part in a direction, and whether it is rotary (Nm/rad, else N/m).

    `carried` tells what hangs on the joint that the part is in; asked of bearings only.
    """
    if isinstance(part, (LinearBearing, CrossRollerBearing)):
        return _bearing_stiffness(part, direction, carried())
    if isinstance(part, Shaft):
        if direction == 'torsion':
            return shaft.torsional_stiffness_nm_per_rad(part), True
        return shaft.bending_stiffness_n_per_m(part), False
    if isinstance(part, Gearbox):
        return gearbox.torsional_stiffness_nm_per_rad(part), True
    if isinstance(part, Belt):
        return belt.stiffness_n_per_m(part), False
    return cable.effective_stiffness_n_per_m(part), False


@lru_cache(maxsize=1024)
def _bearing_stiffness(
    part: LinearBearing | CrossRollerBearing, direction: str, carried: Carried
) -> tuple[float, bool]:
    """Return the stiffness of a bearing that carries something, as above."""
    if isinstance(part, LinearBearing):
        moments = linear_bearing.moment_stiffness(part, guide_load(part, carried))
        return getattr(moments, f'{direction}_nm_per_rad'), True
    stiffnesses = cross_roller_bearing.stiffness(part, ring_load(carried))
    rotary = direction != 'radial_y'
    return getattr(stiffnesses, f'{direction}_{"nm_per_rad" if rotary else "n_per_m"}'), rotary


def follows_chart(part: Any) -> bool:
    """Return whether a part has a chart that its springs can follow: bearings have."""
    return isinstance(part, (LinearBearing, CrossRollerBearing))


@lru_cache(maxsize=1024)
def curve(
    part: LinearBearing | CrossRollerBearing, direction: str, carried: Carried
) -> tuple[SpringCurve, float, bool]:
    """
    Return a bearing's force over deflection by its chart, the static load, and whether it is rotary.

    N over m, or Nm over rad. `carried` is what hangs on the joint that the part is in.
    """
    if isinstance(part, LinearBearing):
        return *linear_bearing.tilt_curve(part, guide_load(part, carried), direction[-1]), True
    found = cross_roller_bearing.curve(part, ring_load(carried), direction)
    return *found, direction != 'radial_y'


def guide_load(part: LinearBearing, carried: Carried) -> linear_bearing.BlockLoad:
    """Return the static load on each block of a guide, (5.20), (5.21)."""
    return linear_bearing.static_block_load(
        carried.mass, carried.x, carried.z, part.vertical_spacing_m
    )


def ring_load(carried: Carried) -> cross_roller_bearing.CrossRollerLoad:
    """Return the static load on a cross-roller bearing whose axis is x."""
    return cross_roller_bearing.static_load(carried.mass, carried.x)


def bearing_load(part: Any, carried: Carried) -> BearingLoad:
    """Return how a bearing's load is made of what its springs bear; `UserError` for another part."""
    if isinstance(part, LinearBearing):
        return guide_amounts(part, guide_load(part, carried))
    if isinstance(part, CrossRollerBearing):
        return ring_amounts(part, ring_load(carried))
    raise UserError('is no guide and no cross-roller bearing, whose load is not known')


def rolling_friction(part: Any, other: Any, bearing: Any) -> tuple[float, float]:
    """
    Return the friction of a part at rest without load (N, Nm), and per load of its bearing (N/N, Nm/N).

    `other` as of `friction`. Raises `UserError` if `bearing` is not the one whose friction it is.
    """
    if isinstance(part, LinearBearing) and bearing is part:
        return linear_bearing.BLOCKS * part.seal_force_per_block_n, part.friction_coefficient
    ring = other if isinstance(part, FerrofluidSeal) else part
    if isinstance(ring, CrossRollerBearing) and bearing is ring:
        return 0.0, 0.5 * ring.friction_coefficient * ring.pitch_diameter_m
    raise UserError('is not the bearing whose friction this is')


def friction(part: Any, other: Any, carried: Callable[[], Carried]) -> SpeedFriction:
    """
    Return the friction of a part: at rest (N or Nm), and what it gains per speed (viscous).

    `other` is the part that takes part in it: the bearing inside a ferrofluid seal, the belt that
    pulls on the Y-Rotate bearings. Raises `UserError` if it is missing or the part has no
    friction.
    """
    if isinstance(part, LinearBearing):
        return SpeedFriction(
            linear_bearing.travel_friction_n(part, guide_load(part, carried())), 0.0
        )
    if isinstance(part, CrossRollerBearing):
        return SpeedFriction(
            cross_roller_bearing.friction_torque_nm(part, ring_load(carried())), 0.0
        )
    if isinstance(part, FerrofluidSeal):
        if not isinstance(other, CrossRollerBearing):
            raise UserError('a ferrofluid seal needs `with`, naming its cross-roller bearing')
        bearing = cross_roller_bearing.friction_torque_nm(other, ring_load(carried()))
        return ferrofluid_seal.drag(part, bearing)
    if isinstance(part, Gearbox):
        return gearbox.no_load_friction(part)
    if isinstance(part, LipSeal):
        return SpeedFriction(lip_seal.drag_torque_nm(part), 0.0)
    if isinstance(part, YRotateBearings):
        if not isinstance(other, Belt):
            raise UserError(
                'the Y-Rotate bearings need `with`, naming the belt that pulls on them'
            )
        load = carried()
        loads = y_rotate_bearings.static_loads(
            part, load.mass, load.x, load.z, belt.shaft_force_n(other)
        )
        return SpeedFriction(y_rotate_bearings.friction_torque_nm(part, loads), 0.0)
    raise UserError(f'there is no friction in a part of kind {type(part).__name__}')
