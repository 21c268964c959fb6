# SPDX-License-Identifier: Apache-2.0
"""
The two bearings of the vertical Y-Rotate shaft: static loads and friction, (5.39) to (5.42).

A needle bearing (B) and, above it, an angular-contact duplex pair (A) hold the shaft. The
payload's weight, its centre of gravity off the axis, tips the shaft; the belt pulls it sideways
between the two bearings, at the distance L_T from the needle bearing. Balance of moments about the
needle bearing and of forces across the shaft give the loads that the shaft puts on its bearings:

    R_A,x (L_A + L_B) = x m g + L_T T sin(beta)        R_B,x =  T sin(beta) - R_A,x
    R_A,z (L_A + L_B) = z m g - L_T T cos(beta)        R_B,z = -T cos(beta) - R_A,z

where the belt pulls the shaft with (T sin(beta), -T cos(beta)) along (x, z). The thesis prints
(5.40) without the division by L_A + L_B, which makes a moment of the force, and exchanges the
names of R_B,x and R_B,z in (5.41) and (5.42), which would not balance the forces; the exchange
does not touch the resultant, and only that is used.

Radial loads only: the pair also carries the weight along y, whose friction is left out as in the
thesis. Loads at the zero pose of the X-Rotate axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_plant.parts.checks import (
    STANDARD_GRAVITY_M_PER_S2,
    require_finite,
    require_not_negative,
    require_positive,
)


@dataclass(frozen=True)
class YRotateBearings:
    """
    Distances along the shaft in m, belt direction, and the friction of both bearings.

    `duplex_to_centre_of_gravity_m` L_A, `needle_to_centre_of_gravity_m` L_B, `needle_to_belt_m`
    L_T; `belt_angle_rad` beta, the belt's pull from the tangent of the pulley; friction radii in m
    (mean radius of the rolling elements). Raises `UserError` for values out of range.
    """

    duplex_to_centre_of_gravity_m: float
    needle_to_centre_of_gravity_m: float
    needle_to_belt_m: float
    belt_angle_rad: float
    duplex_friction_radius_m: float
    needle_friction_radius_m: float
    duplex_friction_coefficient: float
    needle_friction_coefficient: float

    def __post_init__(self) -> None:
        """Check the data."""
        for name in (
            'duplex_to_centre_of_gravity_m',
            'needle_to_centre_of_gravity_m',
            'duplex_friction_radius_m',
            'needle_friction_radius_m',
        ):
            require_positive(getattr(self, name), f'y-rotate bearings: {name}')
        for name in (
            'needle_to_belt_m',
            'duplex_friction_coefficient',
            'needle_friction_coefficient',
        ):
            require_not_negative(getattr(self, name), f'y-rotate bearings: {name}')
        require_finite(self.belt_angle_rad, 'y-rotate bearings: belt_angle_rad')


@dataclass(frozen=True)
class BearingLoads:
    """Forces of the shaft on its two bearings along x and z, in N."""

    duplex_x_n: float
    duplex_z_n: float
    needle_x_n: float
    needle_z_n: float

    @property
    def duplex_n(self) -> float:
        """Return the resultant radial load of the duplex pair in N."""
        return math.hypot(self.duplex_x_n, self.duplex_z_n)

    @property
    def needle_n(self) -> float:
        """Return the resultant radial load of the needle bearing in N."""
        return math.hypot(self.needle_x_n, self.needle_z_n)


def static_loads(
    bearings: YRotateBearings,
    mass_kg: float,
    centre_of_gravity_x_m: float,
    centre_of_gravity_z_m: float,
    belt_force_n: float,
    gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2,
) -> BearingLoads:
    """
    Return the static loads in N, equations (5.39) to (5.42) as corrected above.

    `centre_of_gravity_x_m` and `centre_of_gravity_z_m` are from the Y-Rotate axis; `belt_force_n`
    is the pull of the whole belt on the shaft, both spans together.
    """
    require_positive(mass_kg, 'mass_kg')
    require_finite(centre_of_gravity_x_m, 'centre_of_gravity_x_m')
    require_finite(centre_of_gravity_z_m, 'centre_of_gravity_z_m')
    require_not_negative(belt_force_n, 'belt_force_n')
    weight_n = mass_kg * gravity_m_per_s2
    distance_m = bearings.duplex_to_centre_of_gravity_m + bearings.needle_to_centre_of_gravity_m
    belt_sine_n = belt_force_n * math.sin(bearings.belt_angle_rad)
    belt_cosine_n = belt_force_n * math.cos(bearings.belt_angle_rad)
    arm_m = bearings.needle_to_belt_m
    duplex_x_n = (centre_of_gravity_x_m * weight_n + arm_m * belt_sine_n) / distance_m
    duplex_z_n = (centre_of_gravity_z_m * weight_n - arm_m * belt_cosine_n) / distance_m
    return BearingLoads(
        duplex_x_n=duplex_x_n,
        duplex_z_n=duplex_z_n,
        needle_x_n=belt_sine_n - duplex_x_n,
        needle_z_n=-belt_cosine_n - duplex_z_n,
    )


def friction_torque_nm(bearings: YRotateBearings, loads: BearingLoads) -> float:
    """Return the Coulomb friction torque of both bearings in Nm, mu R r each (5.6)."""
    duplex = bearings.duplex_friction_coefficient * loads.duplex_n
    needle = bearings.needle_friction_coefficient * loads.needle_n
    return duplex * bearings.duplex_friction_radius_m + needle * bearings.needle_friction_radius_m
