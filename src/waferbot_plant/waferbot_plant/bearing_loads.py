# SPDX-License-Identifier: Apache-2.0
"""
The load of a bearing at the moment, for friction that depends on it.

A bearing's springs carry its load. With the moments M_x, M_y, M_z and the force F_y that they carry now,
and the spacings b_y, b_z of a guide's blocks or the pitch diameter D of a ring, the load is, in N,

    guide           P = 4 max(|M_z| / (2 b_y), |M_y| / (2 b_z)) + 4 |M_x| / (2 b_y)
    cross-roller    P = |F_y| + 2 sqrt(M_y^2 + M_z^2) / D

Of a guide that is the sum over four blocks of radial and transverse load, each block's equivalent load
by the guide makers' rule: the two normal parts +-a and +-b add up to |a + b| in two blocks and |a - b|
in the others, 4 max(|a|, |b|) together. Of a ring it is the equivalent radial load without axial force.
With the static loads (5.20), (5.21) these are the loads of `linear_bearing.travel_friction_n` and of
`cross_roller_bearing.friction_torque_nm`. A spring's damper is a part of what it carries.

Both are made of three amounts: the greatest or the resultant of the first two, plus the third; an amount
is a share of a spring's force. **Where a direction is rigid there is no spring, and its static load is
used**, the weight at home: inertia forces are not in it then.

Limits: loads of springs only, so not an internal preload, whose rolling friction is in the drag of the
data sheet, nor a motor's magnetic pull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_lockstep.compiled import compiled
from waferbot_plant.parts.cross_roller_bearing import CrossRollerBearing, CrossRollerLoad
from waferbot_plant.parts.linear_bearing import BLOCKS, BlockLoad, LinearBearing
from waferbot_plant.spring_laws import force_and_arms_now

GREATEST, RESULTANT = 1, 2
"""How the first two amounts of a load go together; 0 is a friction that follows no bearing."""

AMOUNTS = 3


@dataclass(frozen=True)
class Amount:
    """
    A part of a bearing's load: `share` (N per N, or N per Nm) of what the spring in a `direction` bears.

    `static` (N) is what it comes to under the weight at home. `freedom` is the spring's coordinate, ''
    where no connection of the description puts the bearing in that direction.
    """

    direction: str
    share: float
    static: float
    freedom: str = ''


@dataclass(frozen=True)
class BearingLoad:
    """The load of a bearing from three amounts, `together` GREATEST or RESULTANT for the first two."""

    together: int
    amounts: tuple[Amount, Amount, Amount]

    @property
    def static(self) -> float:
        """The load under the weight at home, N."""
        first, second, third = (amount.static for amount in self.amounts)
        return (
            max(first, second) if self.together == GREATEST else math.hypot(first, second)
        ) + third


def guide_amounts(bearing: LinearBearing, load: BlockLoad) -> BearingLoad:
    """Return the load of a guide's four blocks, with `load` on each at rest."""
    vertical = BLOCKS / (2.0 * bearing.vertical_spacing_m)
    horizontal = BLOCKS / (2.0 * bearing.horizontal_spacing_m)
    return BearingLoad(
        GREATEST,
        (
            Amount('about_z', vertical, BLOCKS * load.radial_n),
            Amount('about_y', horizontal, 0.0),
            Amount('about_x', vertical, BLOCKS * load.transverse_n),
        ),
    )


def ring_amounts(bearing: CrossRollerBearing, load: CrossRollerLoad) -> BearingLoad:
    """Return the equivalent radial load of a cross-roller bearing, with `load` at rest."""
    per_moment = 2.0 / bearing.pitch_diameter_m
    return BearingLoad(
        RESULTANT,
        (
            Amount('about_z', per_moment, per_moment * load.moment_nm),
            Amount('about_y', per_moment, 0.0),
            Amount('radial_y', 1.0, load.radial_n),
        ),
    )


def parameter_fields(frictions: int) -> list[tuple]:
    """
    Return the dtype fields, by friction: 0 or how amounts go together; of each amount the spring or -1,
    its share, and its static value, N. `per_load` is the friction per load, N/N or Nm/N.
    """
    return [
        ('friction_bearing', 'i8', (frictions,)),
        ('friction_bearing_spring', 'i8', (frictions, AMOUNTS)),
        ('friction_bearing_share', 'f8', (frictions, AMOUNTS)),
        ('friction_bearing_static', 'f8', (frictions, AMOUNTS)),
        ('friction_per_load', 'f8', (frictions,)),
    ]


@compiled
def _amount(s, p, friction, place, position, velocity):
    """Return an amount of a bearing's load at positions and speeds (n,), N."""
    spring = p['friction_bearing_spring'][friction, place]
    if spring < 0:
        return p['friction_bearing_static'][friction, place]
    force, _, _ = force_and_arms_now(s, p, spring, position, velocity)
    return p['friction_bearing_share'][friction, place] * abs(force)


@compiled
def bearing_load(s, p, friction, position, velocity):
    """Return the load of the bearing that a friction follows, at positions and speeds (n,), N."""
    first = _amount(s, p, friction, 0, position, velocity)
    second = _amount(s, p, friction, 1, position, velocity)
    if p['friction_bearing'][friction] == GREATEST:
        together = max(first, second)
    else:
        together = math.hypot(first, second)
    return together + _amount(s, p, friction, 2, position, velocity)
