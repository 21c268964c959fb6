# SPDX-License-Identifier: Apache-2.0
"""
Drag of the ferrofluid seal around the X-Rotate shaft.

The magnetised fluid in the gap shears like a viscous film. Its viscosity under the field is the
supplier's secret; what is given is the drag torque of the assembled feedthrough (seal and its
bearing) at one speed. Together with the static friction of the bearing that makes a line of torque
against speed.

Limit: warm and running. After a long rest the fluid starts several times stiffer and takes minutes
to come down.
"""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_not_negative, require_positive
from waferbot_plant.parts.friction import SpeedFriction


@dataclass(frozen=True)
class FerrofluidSeal:
    """Drag torque in Nm, bearing included, at a shaft speed in rad/s; both positive."""

    drag_torque_nm: float
    drag_speed_rad_per_s: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.drag_torque_nm, 'ferrofluid seal: drag_torque_nm')
        require_positive(self.drag_speed_rad_per_s, 'ferrofluid seal: drag_speed_rad_per_s')


def drag(seal: FerrofluidSeal, bearing_friction_nm: float) -> SpeedFriction:
    """
    Return the friction of seal and bearing: `bearing_friction_nm` at rest, the drag torque at
    speed.

    The viscous part is (drag - bearing friction)/speed in Nm s/rad. Raises `UserError` if the
    supplier's drag torque is below the bearing's friction, as it should contain it.
    """
    require_not_negative(bearing_friction_nm, 'bearing_friction_nm')
    if seal.drag_torque_nm < bearing_friction_nm:
        raise UserError(
            f'ferrofluid seal: drag_torque_nm {seal.drag_torque_nm!r} is below the friction of '
            f'the bearing that it contains, {bearing_friction_nm:.6g} Nm; check both.'
        )
    viscous = (seal.drag_torque_nm - bearing_friction_nm) / seal.drag_speed_rad_per_s
    return SpeedFriction(coulomb_nm=bearing_friction_nm, viscous_nm_s_per_rad=viscous)
