# SPDX-License-Identifier: Apache-2.0
"""
The two-stage planetary gearbox of the Y-Rotate axis, from what its supplier states.

Tooth geometry is the supplier's secret, so stiffness and friction are lumped: the torsional
rigidity from input to output, and two values of the torque that turns the unloaded gearbox. Left
out: the variation of the mesh stiffness as teeth come and go, backlash, and friction that grows
with load; the friction is therefore an under-estimate. Where a test of the gearbox is at hand, a map of
`waferbot_plant.friction_laws` takes the place of this friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_not_negative, require_positive
from waferbot_plant.parts.friction import SpeedFriction

ARCMINUTES_PER_RADIAN = 180.0 * 60.0 / math.pi
RADIANS_PER_SECOND_PER_RPM = math.pi / 30.0


@dataclass(frozen=True)
class Gearbox:
    """
    Supplier's data of a reduction gearbox.

    `ratio` is input over output speed; `torsional_rigidity_nm_per_arcmin` is seen at the output
    with the input held; `no_load_speed_rpm` and `no_load_torque_nm` are two points at the input.
    Raises `UserError` for values out of range and for points from which no friction line follows.
    """

    ratio: float
    torsional_rigidity_nm_per_arcmin: float
    no_load_speed_rpm: tuple[float, ...]
    no_load_torque_nm: tuple[float, ...]
    input_inertia_kg_m2: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.ratio, 'gearbox: ratio')
        require_positive(
            self.torsional_rigidity_nm_per_arcmin, 'gearbox: torsional_rigidity_nm_per_arcmin'
        )
        require_not_negative(self.input_inertia_kg_m2, 'gearbox: input_inertia_kg_m2')
        no_load_friction(self)


def torsional_stiffness_nm_per_rad(gearbox: Gearbox) -> float:
    """Return the rigidity at the output shaft in Nm/rad; 1 Nm/arcmin is 3437.7 Nm/rad."""
    return gearbox.torsional_rigidity_nm_per_arcmin * ARCMINUTES_PER_RADIAN


def no_load_friction(gearbox: Gearbox) -> SpeedFriction:
    """
    Return the friction at the input shaft: the line through the two supplied points.

    Extrapolated to zero speed for the Coulomb part, in Nm; the slope is viscous, in Nm s/rad.
    Raises `UserError` unless there are two points at different positive speeds whose line neither
    falls with speed nor starts below zero.
    """
    speeds, torques = gearbox.no_load_speed_rpm, gearbox.no_load_torque_nm
    if len(speeds) != 2 or len(torques) != 2:
        raise UserError(
            f'gearbox: {len(speeds)} values of no_load_speed_rpm and {len(torques)} of '
            'no_load_torque_nm; give two of each.'
        )
    for speed, torque in zip(speeds, torques, strict=True):
        require_positive(speed, 'gearbox: no_load_speed_rpm')
        require_not_negative(torque, 'gearbox: no_load_torque_nm')
    if speeds[1] <= speeds[0]:
        raise UserError(f'gearbox: no_load_speed_rpm {speeds!r} must rise.')
    slope_nm_per_rpm = (torques[1] - torques[0]) / (speeds[1] - speeds[0])
    at_rest_nm = torques[0] - slope_nm_per_rpm * speeds[0]
    if slope_nm_per_rpm < 0.0 or at_rest_nm < 0.0:
        raise UserError(
            f'gearbox: the line through no_load_torque_nm {torques!r} at {speeds!r} rpm falls '
            f'with speed or is negative at rest ({at_rest_nm:.3g} Nm); check the two points.'
        )
    return SpeedFriction(at_rest_nm, slope_nm_per_rpm / RADIANS_PER_SECOND_PER_RPM)
