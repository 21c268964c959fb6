# SPDX-License-Identifier: Apache-2.0
"""
The cross-roller bearing that carries the X-Rotate load: stiffness by secant, friction.

Rollers with crossed axes let one ring take radial, axial and moment loads. The shaft axis is x.
The weight of the load hangs beyond the bearing, so that the bearing reacts with a force along y
and a moment about z, at every angle of the axis (the bearing's outer ring does not turn). The
stiffness in each direction is a secant of the supplier's chart at that static load (5.22). Axial
stiffness (x) is left out: no motor axis moves that way.

Along the static load the secant spans the range of loads; across it, where the static moment has
no component, it goes from zero to the static load (see `LoadDeflection.secant_from_zero`). The
bearing is stiffer in the plane of the static moment (about z) than across it (about y).

`curve` follows the charts instead, at the load of the moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from waferbot_plant.parts.checks import (
    STANDARD_GRAVITY_M_PER_S2,
    require_finite,
    require_fraction,
    require_not_negative,
    require_positive,
)
from waferbot_plant.parts.load_deflection import ForceDeflection, MomentTilt
from waferbot_plant.spring_curves import SpringCurve


@dataclass(frozen=True)
class CrossRollerBearing:
    """
    Supplier's data: charts, pitch diameter of the rollers in m, friction, loss factor.

    `load_variability` is gamma of (5.22). Raises `UserError` for values out of range.
    """

    radial: ForceDeflection
    moment: MomentTilt
    load_variability: float
    pitch_diameter_m: float
    friction_coefficient: float
    loss_factor: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_fraction(self.load_variability, 'cross-roller bearing: load_variability')
        require_positive(self.pitch_diameter_m, 'cross-roller bearing: pitch_diameter_m')
        require_not_negative(
            self.friction_coefficient, 'cross-roller bearing: friction_coefficient'
        )
        require_not_negative(self.loss_factor, 'cross-roller bearing: loss_factor')


@dataclass(frozen=True)
class CrossRollerLoad:
    """Magnitudes of the static load: force along y in N, moment about z in Nm."""

    radial_n: float
    moment_nm: float


@dataclass(frozen=True)
class CrossRollerStiffness:
    """Stiffness along y in N/m, about y and about z in Nm/rad."""

    radial_y_n_per_m: float
    about_y_nm_per_rad: float
    about_z_nm_per_rad: float


def static_load(
    mass_kg: float, overhang_m: float, gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2
) -> CrossRollerLoad:
    """
    Return the reaction to a weight that hangs `overhang_m` beyond the bearing centre along x.

    F_y = m g in N and M_z = m g |overhang| in Nm. An offset of the centre of gravity along z makes
    a moment about x, which the motor holds and the bearing does not feel.
    """
    require_positive(mass_kg, 'mass_kg')
    require_finite(overhang_m, 'overhang_m')
    weight_n = mass_kg * gravity_m_per_s2
    return CrossRollerLoad(radial_n=weight_n, moment_nm=weight_n * abs(overhang_m))


@lru_cache(maxsize=64)
def stiffness(bearing: CrossRollerBearing, load: CrossRollerLoad) -> CrossRollerStiffness:
    """
    Return the stiffnesses of the bearing at its static load.

    Along y and about z (in the directions of the static load) the secant over the range (5.22),
    about y the secant from zero. Raises `UserError` where the load leaves the chart.
    """
    radial = bearing.radial.curve('cross-roller bearing: radial')
    moment = bearing.moment.curve('cross-roller bearing: moment')
    gamma = bearing.load_variability
    return CrossRollerStiffness(
        radial_y_n_per_m=radial.secant_over_range(load.radial_n, gamma),
        about_y_nm_per_rad=moment.secant_from_zero(load.moment_nm),
        about_z_nm_per_rad=moment.secant_over_range(load.moment_nm, gamma),
    )


@lru_cache(maxsize=64)
def curve(
    bearing: CrossRollerBearing, load: CrossRollerLoad, direction: str
) -> tuple[SpringCurve, float]:
    """
    Return force over deflection (N over m; Nm over rad) and the static load in a direction.

    `radial_y` and `about_z` are the charts themselves. The bearing is alike all round, so its elastic
    potential is a function U(r) of the resulting tilt r, with U' = f the moment chart. About y, across
    the static moment f(r_0) about z,

        M_y = f(r) phi / r,    r = sqrt(r_0^2 + phi^2)

    which has the slope f(r_0) / r_0 at phi = 0 (`LoadDeflection.secant_from_zero`). Limit: the tilt
    about z keeps its static value r_0 in that, and phi does not act back on the spring about z; good
    while phi is small against r_0.
    """
    if direction == 'radial_y':
        chart = bearing.radial.curve('cross-roller bearing: radial')
        return chart.force_curve(), load.radial_n
    along = bearing.moment.curve('cross-roller bearing: moment').force_curve()
    if direction == 'about_z':
        return along, load.moment_nm
    held = along.deflection(load.moment_nm)
    moments, slopes = [], []
    for tilt in along.deflections:
        resulting = math.hypot(held, tilt)
        # Without a static moment the bearing is alike in this direction and along.
        across = along.force(resulting) / resulting if resulting > 0.0 else along.slope(0.0)
        share = (tilt / resulting) ** 2 if resulting > 0.0 else 1.0
        moments.append(across * tilt)
        slopes.append(share * along.slope(resulting) + (1.0 - share) * across)
    return SpringCurve.through(along.deflections, moments, slopes=slopes), 0.0


def friction_torque_nm(bearing: CrossRollerBearing, load: CrossRollerLoad) -> float:
    """
    Return the friction torque in Nm about x, mu P D/2.

    P = F + 2 M/D is the equivalent radial load of a cross-roller bearing in N (bearing makers'
    rule for static loads without axial force), D the pitch diameter. The same at all speeds.
    """
    equivalent_n = load.radial_n + 2.0 * load.moment_nm / bearing.pitch_diameter_m
    return bearing.friction_coefficient * equivalent_n * bearing.pitch_diameter_m / 2.0
