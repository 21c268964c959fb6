# SPDX-License-Identifier: Apache-2.0
"""
Drag of a lip seal on its shaft, equations (5.37) and (5.38).

The lip, pressed on the shaft by its own stiffness and a garter spring, slides: Coulomb friction.
Left out: the dependence on temperature, wear and the pressure across the seal (one atmosphere
about doubles the normal force).
"""

from __future__ import annotations

from dataclasses import dataclass

from waferbot_plant.parts.checks import require_not_negative, require_positive


@dataclass(frozen=True)
class LipSeal:
    """Shaft radius in m, friction coefficient, and the normal force summed around the lip in N."""

    shaft_radius_m: float
    friction_coefficient: float
    normal_force_n: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.shaft_radius_m, 'lip seal: shaft_radius_m')
        require_not_negative(self.friction_coefficient, 'lip seal: friction_coefficient')
        require_not_negative(self.normal_force_n, 'lip seal: normal_force_n')


def drag_torque_nm(seal: LipSeal) -> float:
    """Return tau = r_s mu F_N in Nm, equations (5.37) and (5.38); the same at all speeds."""
    return seal.shaft_radius_m * seal.friction_coefficient * seal.normal_force_n
