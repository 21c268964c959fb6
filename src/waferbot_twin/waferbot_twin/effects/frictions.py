# SPDX-License-Identifier: Apache-2.0
"""
Where effects put friction: a slot of its own on each axis for each of them.

So effects of several kinds add up, and none touches a friction that the model has itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant

ON_AXIS = (
    'cold_ferrofluid',
    'coulomb_friction',
    'direction_dependent_damping',
    'direction_dependent_friction',
    'position_dependent_friction',
    'presliding',
    'rolling_drag',
    'stribeck_friction',
    'velocity_strengthening_friction',
)
"""Effects with a slot on the coordinate of the axis."""

ON_MOTOR = ('gear_efficiency', 'gearbox_friction', 'load_dependent_friction')
"""Effects with a slot on the coordinate of the motor."""

ON_COUNTERWEIGHT = ('counterweight_friction',)
"""Effects with a slot on the coordinate of the counterweight, on axes that have one."""

OF_GEARBOX = ('gearbox_damping', 'gearbox_friction')
"""Effects with a slot only where a transmission is between motor and axis."""

STICKS = (0.3, 1.0)
"""
Sizes at which dry friction is tried, in its typical one.

A little of it slides wherever the axis moves; more of it sticks, and its force is whatever holds.
"""


def slot(
    variant: Variant,
    axis: str,
    effect: str,
    speeds: Sequence[float],
    resistances: Sequence[float],
    law: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """
    Return the part of a description that fills the slot of an effect.

    A table of resistance (N, Nm) over speed (m/s, rad/s), and the keys of a friction law.
    """
    coordinate, turns = _place(variant, axis, effect)
    entry = {
        'coordinate': coordinate,
        'speed_rad_s' if turns else 'speed_m_s': list(speeds),
        'torque_nm' if turns else 'force_n': list(resistances),
        **(law or {}),
    }
    return {'frictions': {f'{axis}_{effect}': entry}}


def drag(
    variant: Variant,
    axis: str,
    effect: str,
    coefficient: float,
    exponent: float,
    law: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """
    Return the part of a description that fills a slot with friction b |v|^p.

    `coefficient` is b: N or Nm at 1 m/s or rad/s.
    """
    if coefficient == 0.0:
        return slot(variant, axis, effect, [0.0], [0.0])
    _, turns = _place(variant, axis, effect)
    force, speed = ('torque_nm', 'at_speed_rad_s') if turns else ('force_n', 'at_speed_m_s')
    grows = {'drag': {force: coefficient, speed: 1.0, 'exponent': exponent}}
    return slot(variant, axis, effect, [0.0], [0.0], {**(law or {}), **grows})


STRIBECK_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 3.0)
"""Points of a table of Stribeck's curve, in Stribeck's speed: straight lines are off by 2 % at most."""


def stribeck_curve() -> tuple[float, ...]:
    """Return exp(-(v / v_s)^2) at `STRIBECK_SHARES` of v_s: from one to nothing, which it is beyond."""
    return (*(math.exp(-(share**2)) for share in STRIBECK_SHARES[:-1]), 0.0)


def _place(variant: Variant, axis: str, effect: str) -> tuple[str, bool]:
    """Return the coordinate that an effect resists on an axis, and whether that turns."""
    if effect in ON_COUNTERWEIGHT:
        coordinate = places.counterweight_coordinate(variant, axis)
    elif effect in ON_MOTOR or effect in OF_GEARBOX:
        coordinate = places.motor_coordinate(variant, axis)
    else:
        coordinate = places.coordinate(variant, axis)
    return coordinate, bool(variant.base.description.revolute[coordinate])


def damper(variant: Variant, axis: str, effect: str, damping: float) -> dict[str, Any]:
    """Return the part of a description that fills a slot of damping, N s/m, Nm s/rad."""
    coordinate, turns = _place(variant, axis, effect)
    entry = {
        'coordinate': coordinate,
        'damping_nm_s_rad' if turns else 'damping_n_s_m': damping,
    }
    return {'dampers': {f'{axis}_{effect}': entry}}


def slots(axis: str) -> tuple[str, ...]:
    """Return the names of all slots of dry friction on an axis."""
    return tuple(f'{axis}_{effect}' for effect in (*ON_AXIS, *ON_MOTOR, *ON_COUNTERWEIGHT))


def of_axis(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return the frictions that the model itself has on what moves with an axis."""
    return tuple(
        name
        for name, friction in variant.description.frictions.items()
        if places.moves_with(variant, axis, friction.coordinate) and name not in slots(axis)
    )
