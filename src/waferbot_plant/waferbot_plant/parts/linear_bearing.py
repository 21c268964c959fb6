# SPDX-License-Identifier: Apache-2.0
"""
Profiled-rail guides of a carriage on four blocks, equations (5.20) to (5.25).

Two rails run vertically (y) at the horizontal spacing b_z; each carries two blocks at the vertical
spacing b_y. A block gives way along x (radial when pressed on the rail, reverse when pulled off)
and along z (transverse). The carriage is rigid, so the blocks take forces only; together they act
as three springs against rotation about the bearing centre. Translation of the bearing along x and
z is left out, as in the thesis: no motor axis moves that way.

The stiffness is a secant over the loads of normal motion, (5.22). For accelerations of the order
of 1 g the loads leave that range and the numbers lose meaning. `tilt_curve` follows the charts
instead, at the load of the moment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import (
    STANDARD_GRAVITY_M_PER_S2,
    require_finite,
    require_fraction,
    require_not_negative,
    require_positive,
)
from waferbot_plant.parts.load_deflection import ForceDeflection
from waferbot_plant.spring_curves import LONGEST_CURVE, SpringCurve

BLOCKS = 4
"""Blocks under one carriage."""


@dataclass(frozen=True)
class LinearBearing:
    """
    Four blocks of a supplier's guide under one carriage.

    Spacings in m between block centres; charts of one block. `load_variability` is gamma of
    (5.22), `friction_coefficient` that of rolling, `seal_force_per_block_n` the drag of the wipers
    of one block in N, `loss_factor` that of the contacts. Raises `UserError` for values out of
    range.
    """

    vertical_spacing_m: float
    horizontal_spacing_m: float
    radial: ForceDeflection
    reverse: ForceDeflection
    transverse: ForceDeflection
    load_variability: float
    friction_coefficient: float
    seal_force_per_block_n: float
    loss_factor: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.vertical_spacing_m, 'linear bearing: vertical_spacing_m')
        require_positive(self.horizontal_spacing_m, 'linear bearing: horizontal_spacing_m')
        require_fraction(self.load_variability, 'linear bearing: load_variability')
        require_not_negative(self.friction_coefficient, 'linear bearing: friction_coefficient')
        require_not_negative(self.seal_force_per_block_n, 'linear bearing: seal_force_per_block_n')
        require_not_negative(self.loss_factor, 'linear bearing: loss_factor')


@dataclass(frozen=True)
class BlockLoad:
    """Magnitude of the static load on each of the four blocks: along x and along z, in N."""

    radial_n: float
    transverse_n: float


@dataclass(frozen=True)
class MomentStiffness:
    """Stiffness of a bearing against rotation about x, y and z, in Nm/rad."""

    about_x_nm_per_rad: float
    about_y_nm_per_rad: float
    about_z_nm_per_rad: float


def static_block_load(
    mass_kg: float,
    centre_of_gravity_x_m: float,
    centre_of_gravity_z_m: float,
    vertical_spacing_m: float,
    gravity_m_per_s2: float = STANDARD_GRAVITY_M_PER_S2,
) -> BlockLoad:
    """
    Return the load on each block from the weight of the payload, equations (5.20) and (5.21).

    F_r = m g |p_x| / (2 b_y) and F_t = m g |p_z| / (2 b_y): the weight hangs at (p_x, p_z) from
    the bearing centre, the cables hold it at the bearing centre, and the two blocks above take the
    moment with the two below. Half of the blocks are loaded radially, the other half in reverse.
    Only the spacing b_y counts, as the weight makes no moment about y. Result in N, magnitudes.
    """
    require_positive(mass_kg, 'mass_kg')
    require_finite(centre_of_gravity_x_m, 'centre_of_gravity_x_m')
    require_finite(centre_of_gravity_z_m, 'centre_of_gravity_z_m')
    require_positive(vertical_spacing_m, 'vertical_spacing_m')
    weight_n = mass_kg * gravity_m_per_s2
    return BlockLoad(
        radial_n=weight_n * abs(centre_of_gravity_x_m) / (2.0 * vertical_spacing_m),
        transverse_n=weight_n * abs(centre_of_gravity_z_m) / (2.0 * vertical_spacing_m),
    )


@lru_cache(maxsize=64)
def moment_stiffness(bearing: LinearBearing, load: BlockLoad) -> MomentStiffness:
    """
    Return the stiffness against rotation about x, y and z in Nm/rad, equations (5.23) to (5.25).

    kappa_x = k_t b_y^2, kappa_y = (k_rad + k_rev)/2 b_z^2, kappa_z = (k_rad + k_rev)/2 b_y^2: two
    blocks on either side of the centre, each at half the spacing, two of them pressed and two
    pulled. The stiffness of a block is the secant of its chart over the range (5.22) about the
    static load. Raises `UserError` where that range leaves the chart, and where there is no static
    load to take a range about.
    """
    gamma = bearing.load_variability
    radial = bearing.radial.curve('linear bearing: radial')
    reverse = bearing.reverse.curve('linear bearing: reverse')
    transverse = bearing.transverse.curve('linear bearing: transverse')
    normal_n_per_m = 0.5 * (
        radial.secant_over_range(load.radial_n, gamma)
        + reverse.secant_over_range(load.radial_n, gamma)
    )
    transverse_n_per_m = transverse.secant_over_range(load.transverse_n, gamma)
    return MomentStiffness(
        about_x_nm_per_rad=transverse_n_per_m * bearing.vertical_spacing_m**2,
        about_y_nm_per_rad=normal_n_per_m * bearing.horizontal_spacing_m**2,
        about_z_nm_per_rad=normal_n_per_m * bearing.vertical_spacing_m**2,
    )


@lru_cache(maxsize=64)
def tilt_curve(bearing: LinearBearing, load: BlockLoad, axis: str) -> tuple[SpringCurve, float]:
    """
    Return moment over tilt (Nm over rad) about `axis` x, y or z, and the static moment in it, Nm.

    A tilt phi moves the blocks by +- phi b/2 and the charts say what each answers, with f_t, f_rad and
    f_rev the force over deflection of one block,

        M_x = 2 b_y f_t(phi b_y/2)
        M_z = b_y (f_rad(phi b_y/2) + f_rev(phi b_y/2))
        M_y = b_z/2 (g(d + u) - g(d - u) + g(u - d) - g(-u - d)),    u = phi b_z/2

    where g is f_rad for a block that is pressed on its rail and -f_rev for one that is pulled off it.
    The weight makes no moment about y, but holds the blocks at the normal deflection +-d, with
    M_z(2 d / b_y) = 2 b_y F_r (5.20). For small phi these are (5.23) to (5.25) with the slopes of the
    charts at the static load in place of secants. An internal preload is in the chart, as suppliers
    print one chart for each class of preload. All three are odd in phi.

    Exact at the deflections of the charts' points, slopes too. Limits: about y the blocks keep the
    deflection d of the static load while the machine moves about z; translation is left out, as in
    (5.23) to (5.25), so that pressed and pulled blocks move alike, where a carriage free along x would
    let them share the force alike (0.7 % softer where k_rev = 0.85 k_rad). Raises `UserError` if the
    charts have more points, taken together, than `LONGEST_CURVE`.
    """
    vertical_m, horizontal_m = bearing.vertical_spacing_m, bearing.horizontal_spacing_m
    if axis == 'x':
        block = bearing.transverse.curve('linear bearing: transverse').force_curve()
        tilts = [2.0 * at / vertical_m for at in block.deflections]
        moments = [2.0 * vertical_m * force for force in block.forces]
        return SpringCurve.through(tilts, moments), 2.0 * vertical_m * load.transverse_n
    pressed = bearing.radial.curve('linear bearing: radial').force_curve()
    pulled = bearing.reverse.curve('linear bearing: reverse').force_curve()
    places = sorted({*pressed.deflections, *pulled.deflections})
    _check_number(places)
    moments = [vertical_m * (pressed.force(at) + pulled.force(at)) for at in places]
    slopes = [0.5 * vertical_m**2 * (pressed.slope(at) + pulled.slope(at)) for at in places]
    about_z = SpringCurve.through([2.0 * at / vertical_m for at in places], moments, slopes=slopes)
    static_nm = 2.0 * vertical_m * load.radial_n
    if axis == 'z':
        return about_z, static_nm
    held = 0.5 * vertical_m * about_z.deflection(static_nm)
    places = sorted({*places, held})  # where a block leaves off pressing and begins to pull
    _check_number(places)

    def normal(at: float) -> tuple[float, float]:
        """Return force and slope of a block pressed by a deflection, or pulled by a negative one."""
        if at == 0.0:
            return 0.0, 0.5 * (pressed.slope(0.0) + pulled.slope(0.0))
        chart = pressed if at > 0.0 else pulled
        return chart.force(at), chart.slope(at)

    moments, slopes = [], []
    for at in places:
        there = [normal(held + at), normal(at - held)]
        opposite = [normal(held - at), normal(-at - held)]
        moments.append(
            0.5 * horizontal_m * (sum(f for f, _ in there) - sum(f for f, _ in opposite))
        )
        slopes.append(0.25 * horizontal_m**2 * sum(slope for _, slope in there + opposite))
    tilts = [2.0 * at / horizontal_m for at in places]
    return SpringCurve.through(tilts, moments, slopes=slopes), 0.0


def _check_number(places: list[float]) -> None:
    """Raise `UserError` for more deflections than a curve can have."""
    if len(places) > LONGEST_CURVE:
        raise UserError(
            f'linear bearing: radial and reverse have {len(places)} different deflections (about y '
            f'with that of the static load); a spring by the chart can have {LONGEST_CURVE}. Give '
            'fewer points, or the same deflections in both.'
        )


def travel_friction_n(bearing: LinearBearing, load: BlockLoad) -> float:
    """
    Return the friction in N against travel along y, the same at all speeds.

    mu times the normal force of the four blocks, plus their seals. The equivalent load of a
    four-row guide is the sum of its radial and its transverse load (guide makers' rule), so the
    normal force is 4 (F_r + F_t). Static loads: small accelerations are assumed.
    """
    normal_n = BLOCKS * (load.radial_n + load.transverse_n)
    return bearing.friction_coefficient * normal_n + BLOCKS * bearing.seal_force_per_block_n
