# SPDX-License-Identifier: Apache-2.0
"""
The timing belt of the Y-Rotate axis, equations (5.32) to (5.36), and the gearbox before it.

A polyurethane belt with steel cords runs from the drive pulley on the gearbox to the driven pulley
on the payload. It is tensioned so that neither span goes slack; then both spans pull on the
payload, one more and one less, and their stiffnesses add. The cords are what stretches: the teeth
are much stiffer, and like the thesis the drive takes the axial stiffness only. For belts where that
does not hold, the stiffness of a tooth puts the meshes of both pulleys (5.33) in series with the cords.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_not_negative, require_positive
from waferbot_plant.parts.vibration import free_pair_frequency, series_stiffness


@dataclass(frozen=True)
class Belt:
    """
    A timing belt on two pulleys.

    `specific_stiffness_n_per_m` is c_sp, the force per width and unit strain, in N per metre of
    width (makers give N for a width); lengths in m, numbers of teeth whole, `span_pretension_n`
    the tension of each span at rest in N. What it may bear, for the check of a run (see
    `waferbot_plant.validity`): `allowed_span_tension_n`, of one span, in N, if the maker states it;
    `friction_coefficient` of a flat belt on its pulleys, without which the belt is toothed.
    `tooth_stiffness_n_per_m` is k_tooth of (5.33) in N/m, without which teeth do not give, and
    `virtual_teeth_share` z_mv / z_m, the maker's correction for teeth that share the load unequally, 1
    without one. Raises `UserError` for values out of range and for a belt that does not reach around
    its pulleys.
    """

    specific_stiffness_n_per_m: float
    width_m: float
    length_m: float
    tooth_pitch_m: float
    drive_pulley_teeth: int
    driven_pulley_teeth: int
    span_pretension_n: float
    loss_factor: float
    allowed_span_tension_n: float | None = None
    friction_coefficient: float | None = None
    tooth_stiffness_n_per_m: float | None = None
    virtual_teeth_share: float | None = None

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.specific_stiffness_n_per_m, 'belt: specific_stiffness_n_per_m')
        require_positive(self.width_m, 'belt: width_m')
        require_positive(self.length_m, 'belt: length_m')
        require_positive(self.tooth_pitch_m, 'belt: tooth_pitch_m')
        for name in ('drive_pulley_teeth', 'driven_pulley_teeth'):
            teeth = getattr(self, name)
            require_positive(teeth, f'belt: {name}')
            if teeth != int(teeth):
                raise UserError(f'belt: {name} is {teeth!r}; give a whole number.')
        require_positive(self.span_pretension_n, 'belt: span_pretension_n')
        require_not_negative(self.loss_factor, 'belt: loss_factor')
        for name in (
            'allowed_span_tension_n', 'friction_coefficient', 'tooth_stiffness_n_per_m',
            'virtual_teeth_share',
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None:
                require_positive(value, f'belt: {name}')
        share = self.virtual_teeth_share
        if share is not None and share > 1.0:
            raise UserError(f'belt: virtual_teeth_share is {share!r}; it is at most 1, all teeth.')
        if share is not None and self.tooth_stiffness_n_per_m is None:
            raise UserError(
                'belt: virtual_teeth_share goes with tooth_stiffness_n_per_m; give both.'
            )
        centre_distance_m(self)

    @property
    def drive_pulley_radius_m(self) -> float:
        """Return r_1, the pitch radius of the pulley on the gearbox, in m."""
        return pitch_radius_m(self.drive_pulley_teeth, self.tooth_pitch_m)

    @property
    def driven_pulley_radius_m(self) -> float:
        """Return r_2, the pitch radius of the pulley on the payload, in m."""
        return pitch_radius_m(self.driven_pulley_teeth, self.tooth_pitch_m)

    @property
    def ratio(self) -> float:
        """Return drive over driven speed, r_2/r_1."""
        return self.driven_pulley_teeth / self.drive_pulley_teeth


def pitch_radius_m(teeth: int, tooth_pitch_m: float) -> float:
    """Return the pitch radius z t/(2 pi) of a timing pulley in m."""
    return teeth * tooth_pitch_m / (2.0 * math.pi)


def belt_length_m(centre_distance: float, first_radius_m: float, second_radius_m: float) -> float:
    """
    Return the pitch length in m of an open belt around two pulleys, all lengths in m.

    Two straight spans sqrt(a^2 - (r2 - r1)^2) and the two arcs; the larger pulley is wrapped by
    pi + 2 phi, the smaller by pi - 2 phi, with sin(phi) = |r2 - r1|/a.
    """
    difference = abs(second_radius_m - first_radius_m)
    phi = math.asin(difference / centre_distance)
    span = math.sqrt(centre_distance**2 - difference**2)
    return 2.0 * span + math.pi * (first_radius_m + second_radius_m) + 2.0 * phi * difference


def centre_distance_m(belt: Belt) -> float:
    """
    Return the distance of the pulley centres in m at which the belt is just straight.

    Solves `belt_length_m` for it. Raises `UserError` if the belt is too short for pulleys that do
    not touch.
    """
    first, second = belt.drive_pulley_radius_m, belt.driven_pulley_radius_m
    shortest = belt_length_m(first + second, first, second)
    if belt.length_m <= shortest:
        raise UserError(
            f'belt: length_m is {belt.length_m!r}; around pulleys of {belt.drive_pulley_teeth} '
            f'and {belt.driven_pulley_teeth} teeth it must be more than {shortest:.4g} m.'
        )
    # Imported here, as it takes half a second of every process that simulates, and few have a belt.
    from scipy.optimize import brentq

    return float(
        brentq(
            lambda distance: belt_length_m(distance, first, second) - belt.length_m,
            first + second,
            belt.length_m / 2.0,
            xtol=1e-14,
        )
    )


def shaft_force_n(belt: Belt) -> float:
    """
    Return the pull of both spans on either shaft at rest in N, along the line of centres.

    2 T cos(phi): the spans lean by phi towards the line of centres, sin(phi) = |r2 - r1|/a.
    """
    difference = abs(belt.driven_pulley_radius_m - belt.drive_pulley_radius_m)
    phi = math.asin(difference / centre_distance_m(belt))
    return 2.0 * belt.span_pretension_n * math.cos(phi)


def span_tensions_n(belt: Belt, pull_n: float) -> tuple[float, float]:
    """
    Return the tension of the tight and the slack span in N under an effective pull F in N.

    T = F_pre + F/2 and F_pre - F/2, as equal spans share the pull: the tensions add up to 2 F_pre until
    the slack one is gone, at F = 2 F_pre; beyond, the tight one bears all, and a slack span below zero
    is by how much the pretension falls short.
    """
    pull = abs(pull_n)
    slack = belt.span_pretension_n - 0.5 * pull
    return (belt.span_pretension_n + 0.5 * pull if slack >= 0.0 else pull), slack


def slip_pull_n(belt: Belt) -> float:
    """
    Return the effective pull in N at which the belt slips on its smaller pulley.

    Euler and Eytelwein, T_1/T_2 = exp(mu beta) with T_1 + T_2 = 2 F_pre, so F = 2 F_pre tanh(mu beta/2),
    beta the wrap of the smaller pulley, pi - 2 phi (see `belt_length_m`). A toothed belt is the limit
    of large mu: its teeth can climb once a span is slack, F = 2 F_pre. Centrifugal force is left out.
    """
    if belt.friction_coefficient is None:
        return 2.0 * belt.span_pretension_n
    difference = abs(belt.driven_pulley_radius_m - belt.drive_pulley_radius_m)
    wrap = math.pi - 2.0 * math.asin(difference / centre_distance_m(belt))
    return 2.0 * belt.span_pretension_n * math.tanh(0.5 * belt.friction_coefficient * wrap)


def axial_stiffness_n_per_m(belt: Belt) -> float:
    """
    Return k_a = c_sp w/L_1 + c_sp w/L_2 = 4 c_sp w/L in N/m, equation (5.32).

    Seen at the pitch circle of one pulley with the other held. Each span is counted with half the
    length of the whole belt (L_1 = L_2 = L/2): a belt that turns to and fro about one position
    stretches on the pulleys too.
    """
    return 4.0 * belt.specific_stiffness_n_per_m * belt.width_m / belt.length_m


def teeth_in_mesh(belt: Belt, driven: bool) -> float:
    """
    Return the number of belt teeth in mesh, z_m, on one of the pulleys, equation (5.34).

    z_m = z_1/180 arccos((z_2 - z_1) t/(2 pi a)), the arc cosine in degrees, with z_1 the teeth of
    the pulley in question, z_2 those of the other and a the centre distance: the fraction of its
    teeth inside the angle of wrap. `driven` chooses the driven pulley. Not rounded.
    """
    teeth, other = belt.drive_pulley_teeth, belt.driven_pulley_teeth
    if driven:
        teeth, other = other, teeth
    argument = (other - teeth) * belt.tooth_pitch_m / (2.0 * math.pi * centre_distance_m(belt))
    return teeth / 180.0 * math.degrees(math.acos(argument))


def mesh_stiffness_n_per_m(virtual_teeth_in_mesh: float, tooth_stiffness_n_per_m: float) -> float:
    """
    Return k_m = z_mv k_tooth in N/m, equation (5.33).

    The virtual number of teeth in mesh z_mv is the belt maker's correction of `teeth_in_mesh` for
    teeth that do not share the load equally; it is smaller. In series with the axial stiffness.
    """
    require_positive(virtual_teeth_in_mesh, 'belt: virtual_teeth_in_mesh')
    require_positive(tooth_stiffness_n_per_m, 'belt: tooth_stiffness_n_per_m')
    return virtual_teeth_in_mesh * tooth_stiffness_n_per_m


def stiffness_n_per_m(belt: Belt) -> float:
    """
    Return the stiffness of a belt in N/m, at the pitch circle of one pulley with the other held.

    1/k = 1/k_a + 1/k_m1 + 1/k_m2: cords (5.32) and the meshes of both pulleys (5.33), each with its own
    number of teeth in mesh (5.34). k = k_a where `tooth_stiffness_n_per_m` is not given.
    """
    axial = axial_stiffness_n_per_m(belt)
    if belt.tooth_stiffness_n_per_m is None:
        return axial
    share = 1.0 if belt.virtual_teeth_share is None else belt.virtual_teeth_share
    meshes = (
        mesh_stiffness_n_per_m(share * teeth_in_mesh(belt, driven), belt.tooth_stiffness_n_per_m)
        for driven in (False, True)
    )
    return 1.0 / (1.0 / axial + sum(1.0 / mesh for mesh in meshes))


def drive_stiffness_nm_per_rad(belt: Belt, gearbox_stiffness_nm_per_rad: float) -> float:
    """
    Return the torsional stiffness of gearbox and belt in series at the payload, in Nm/rad.

    The belt alone is k r_2^2; the gearbox, stiffness given at its output, is seen through the
    belt as kappa_g (r_2/r_1)^2. What this leaves out: the pulleys' inertia between the two
    springs.
    """
    require_positive(gearbox_stiffness_nm_per_rad, 'gearbox stiffness')
    belt_stiffness = stiffness_n_per_m(belt) * belt.driven_pulley_radius_m**2
    return series_stiffness(belt_stiffness, gearbox_stiffness_nm_per_rad * belt.ratio**2)


def belt_frequency(
    axial_stiffness: float,
    motor_side_inertia_kg_m2: float,
    payload_inertia_kg_m2: float,
    drive_radius_m: float,
    driven_radius_m: float,
) -> float:
    """
    Return the non-rigid frequency in rad/s of two inertias joined by a belt, equation (5.36).

    omega^2 = (k_a J_1 r_2^2 + k_a J_2 r_1^2)/(J_1 J_2): J_1 of motor and gearbox about the drive
    pulley's axis, J_2 of the payload about the driven pulley's, in kg m2; k_a in N/m, radii in m.
    The gearbox is rigid here; `drive_frequency` has its stiffness too.
    """
    require_positive(axial_stiffness, 'belt: axial stiffness')
    require_positive(motor_side_inertia_kg_m2, 'motor_side_inertia_kg_m2')
    require_positive(payload_inertia_kg_m2, 'payload_inertia_kg_m2')
    require_positive(drive_radius_m, 'drive_radius_m')
    require_positive(driven_radius_m, 'driven_radius_m')
    numerator = axial_stiffness * (
        motor_side_inertia_kg_m2 * driven_radius_m**2 + payload_inertia_kg_m2 * drive_radius_m**2
    )
    return math.sqrt(numerator / (motor_side_inertia_kg_m2 * payload_inertia_kg_m2))


def drive_frequency(
    belt: Belt,
    gearbox_stiffness_nm_per_rad: float,
    motor_side_inertia_kg_m2: float,
    payload_inertia_kg_m2: float,
) -> float:
    """
    Return the non-rigid frequency in rad/s of motor and payload on gearbox and belt in series.

    The last row of Table 6.7. `motor_side_inertia_kg_m2` is J_1 of (5.36): motor and gearbox,
    referred to the gearbox output, where it counts J_1 (r_2/r_1)^2 at the payload. Both ends
    float.
    """
    stiffness = drive_stiffness_nm_per_rad(belt, gearbox_stiffness_nm_per_rad)
    return free_pair_frequency(
        stiffness, motor_side_inertia_kg_m2 * belt.ratio**2, payload_inertia_kg_m2
    )
