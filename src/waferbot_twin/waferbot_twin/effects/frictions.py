# SPDX-License-Identifier: Apache-2.0
"""
Where effects put friction: a slot of its own on each axis for each of them.

A slot with resistance zero is without effect. A machine that has all slots (see `host`) therefore
has the same structure in memory whatever friction an effect adds, and need not be compiled again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant

ON_AXIS = (
    'cold_ferrofluid',
    'coulomb_friction',
    'direction_dependent_friction',
    'position_dependent_friction',
    'presliding',
    'stribeck_friction',
)
"""Effects with a slot on the coordinate of the axis."""

ON_MOTOR = ('gearbox_friction', 'load_dependent_friction')
"""Effects with a slot on the coordinate of the motor."""

DAMPING = ('gearbox_damping', 'viscous_friction')
"""Effects whose slot is a viscous damper."""

OF_GEARBOX = ('gearbox_damping', 'gearbox_friction')
"""Effects with a slot only where a transmission is between motor and axis."""


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
    on_motor = effect in ON_MOTOR
    turns = (places.motor_rotary if on_motor else places.rotary)(variant, axis)
    entry = {
        'coordinate': (places.motor_coordinate if on_motor else places.coordinate)(variant, axis),
        'speed_rad_s' if turns else 'speed_m_s': list(speeds),
        'torque_nm' if turns else 'force_n': list(resistances),
        **(law or {}),
    }
    return {'frictions': {f'{axis}_{effect}': entry}}


def damper(variant: Variant, axis: str, effect: str, damping: float) -> dict[str, Any]:
    """Return the part of a description that fills a slot of damping, N s/m, Nm s/rad."""
    on_motor = effect in OF_GEARBOX
    turns = (places.motor_rotary if on_motor else places.rotary)(variant, axis)
    entry = {
        'coordinate': (places.motor_coordinate if on_motor else places.coordinate)(variant, axis),
        'damping_nm_s_rad' if turns else 'damping_n_s_m': damping,
    }
    return {'dampers': {f'{axis}_{effect}': entry}}


def slots_of(variant: Variant, axis: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the effects that have a slot on an axis: of dry friction, and of damping."""
    geared = axis in places.geared_axes(variant)
    dry, viscous = (
        tuple(effect for effect in effects if geared or effect not in OF_GEARBOX)
        for effects in ((*ON_AXIS, *ON_MOTOR), DAMPING)
    )
    return dry, viscous


def slots(axis: str) -> tuple[str, ...]:
    """Return the names of all slots of dry friction on an axis."""
    return tuple(f'{axis}_{effect}' for effect in (*ON_AXIS, *ON_MOTOR))


def of_axis(variant: Variant, axis: str) -> tuple[str, ...]:
    """Return the frictions that the model itself has on what moves with an axis."""
    return tuple(
        name
        for name, friction in variant.description.frictions.items()
        if places.moves_with(variant, axis, friction.coordinate) and name not in slots(axis)
    )
