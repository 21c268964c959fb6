# SPDX-License-Identifier: Apache-2.0
"""
The hollow drive shaft of the X-Rotate axis, equations (5.27) to (5.31).

A round shaft of constant section carries the motor's torque to the payload and, fixed at one end,
bends under the payload at the other. Both stiffnesses use the whole length. Left out are the
compliance of flanges and seats, and shear: a shaft of five diameters in length bends 4 % more than
said here, one of 2.7 diameters 14 % more (hollow, bore half the diameter).

The thesis prints the bending stiffness (5.30) with the J of (5.28). That J is the polar moment,
for torsion; bending needs the area moment about a diameter, which is half of it. It is right here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_not_negative, require_positive
from waferbot_plant.parts.vibration import free_pair_frequency, grounded_frequency


@dataclass(frozen=True)
class Shaft:
    """
    A hollow round shaft (inner diameter 0 for a solid one): diameters and length in m, moduli in
    Pa.

    Raises `UserError` for a bore not below the outer diameter, and for moduli that no isotropic
    metal has: Poisson's ratio E/(2 G) - 1 must lie between 0 and 0.5.
    """

    outer_diameter_m: float
    inner_diameter_m: float
    length_m: float
    elastic_modulus_pa: float
    shear_modulus_pa: float
    loss_factor: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.outer_diameter_m, 'shaft: outer_diameter_m')
        require_not_negative(self.inner_diameter_m, 'shaft: inner_diameter_m')
        require_positive(self.length_m, 'shaft: length_m')
        require_positive(self.elastic_modulus_pa, 'shaft: elastic_modulus_pa')
        require_positive(self.shear_modulus_pa, 'shaft: shear_modulus_pa')
        require_not_negative(self.loss_factor, 'shaft: loss_factor')
        if self.inner_diameter_m >= self.outer_diameter_m:
            raise UserError(
                f'shaft: inner_diameter_m is {self.inner_diameter_m!r}; it must be smaller than '
                f'outer_diameter_m, {self.outer_diameter_m!r}.'
            )
        poisson_ratio = self.elastic_modulus_pa / (2.0 * self.shear_modulus_pa) - 1.0
        if not 0.0 < poisson_ratio < 0.5:
            raise UserError(
                f'shaft: elastic_modulus_pa {self.elastic_modulus_pa!r} and shear_modulus_pa '
                f"{self.shear_modulus_pa!r} give Poisson's ratio {poisson_ratio:.3g}; "
                'metals have 0 to 0.5.'
            )


def polar_moment_m4(shaft: Shaft) -> float:
    """Return the polar second moment of area J = pi (d_o^4 - d_i^4)/32 in m4, equation (5.28)."""
    return math.pi * (shaft.outer_diameter_m**4 - shaft.inner_diameter_m**4) / 32.0


def area_moment_m4(shaft: Shaft) -> float:
    """Return the second moment of area about a diameter in m4: half of the polar one."""
    return 0.5 * polar_moment_m4(shaft)


def torsional_stiffness_nm_per_rad(shaft: Shaft) -> float:
    """Return kappa_s = G J / L in Nm/rad, equation (5.27)."""
    return shaft.shear_modulus_pa * polar_moment_m4(shaft) / shaft.length_m


def bending_stiffness_n_per_m(shaft: Shaft) -> float:
    """Return k_sb = 3 E I / L^3 in N/m of a cantilever, (5.30) with the area moment I."""
    return 3.0 * shaft.elastic_modulus_pa * area_moment_m4(shaft) / shaft.length_m**3


def torsion_frequency(
    shaft: Shaft, load_inertia_kg_m2: float, rotor_inertia_kg_m2: float = math.inf
) -> float:
    """
    Return the first non-rigid frequency in rad/s of rotor and load on the twisting shaft.

    sqrt(kappa_s (1/I_x + 1/J_rotor)). With the rotor held (infinite inertia, the default) this is
    equation (5.29), sqrt(kappa_s/I_x); but the motor holds its rotor only within its bandwidth,
    and far above it the two swing against each other. Inertias about the shaft axis in kg m2.
    """
    stiffness = torsional_stiffness_nm_per_rad(shaft)
    if rotor_inertia_kg_m2 == math.inf:
        return grounded_frequency(stiffness, load_inertia_kg_m2)
    return free_pair_frequency(stiffness, load_inertia_kg_m2, rotor_inertia_kg_m2)


def bending_frequency(shaft: Shaft, load_mass_kg: float) -> float:
    """Return sqrt(k_sb/m) in rad/s, equation (5.31), with the mass in kg at the shaft's end."""
    return grounded_frequency(bending_stiffness_n_per_m(shaft), load_mass_kg)
