# SPDX-License-Identifier: Apache-2.0
"""Friction that rises linearly with speed, as the friction elements take it."""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_plant.parts.checks import require_not_negative


@dataclass(frozen=True)
class SpeedFriction:
    """
    Friction torque against speed, tau = coulomb + viscous * |speed|, against the motion.

    `coulomb_nm` in Nm is also the breakaway torque, unless the friction element multiplies it;
    `viscous_nm_s_per_rad` in Nm s/rad. Both zero or above.
    """

    coulomb_nm: float
    viscous_nm_s_per_rad: float

    def __post_init__(self) -> None:
        """Check the signs."""
        require_not_negative(self.coulomb_nm, 'coulomb_nm')
        require_not_negative(self.viscous_nm_s_per_rad, 'viscous_nm_s_per_rad')

    def torque_nm(self, speed_rad_per_s: float) -> float:
        """Return the magnitude of the torque in Nm at a speed in rad/s of either sign."""
        return self.coulomb_nm + self.viscous_nm_s_per_rad * abs(speed_rad_per_s)
