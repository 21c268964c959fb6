# SPDX-License-Identifier: Apache-2.0
"""
The counterweight cables: stranded rope over a pulley, stiffness by equations (5.1) to (5.3).

The payload and the counterweight hang on two equal cables of 7x19 construction: seven strands of
nineteen wires. The cable is taken as massless and bent fully around the upper half of its pulley,
without slip; it pulls and does not push.

Limit: the metallic area times the modulus of the wire is the stiffness of straight wires. The
wires of a rope are helices that bed into one another, so a real rope, above all a new one,
stretches up to twice as much. The frequency of the cable is therefore an upper estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from waferbot_lockstep.errors import UserError
from waferbot_plant.parts.checks import require_not_negative, require_positive

WIRES_7X19 = 7 * 19
"""Wires in a rope of seven strands of nineteen wires."""

WIRES_ACROSS_7X19 = 3 * 5
"""Wires side by side across the diameter: three strands, each five wires across."""


@dataclass(frozen=True)
class Cable:
    """
    The set of equal parallel cables between payload and counterweight.

    Diameter, moduli and lengths in m and Pa; `cable_length_m` is L_cable of (5.3), from the mount
    on the payload over the pulley to the mount on the counterweight. Raises `UserError` for values
    that are not positive and for a cable shorter than its arc on the pulley.
    """

    nominal_diameter_m: float
    elastic_modulus_pa: float
    cable_length_m: float
    pulley_radius_m: float
    number_of_cables: int
    loss_factor: float

    def __post_init__(self) -> None:
        """Check the data."""
        require_positive(self.nominal_diameter_m, 'cable: nominal_diameter_m')
        require_positive(self.elastic_modulus_pa, 'cable: elastic_modulus_pa')
        require_positive(self.cable_length_m, 'cable: cable_length_m')
        require_positive(self.pulley_radius_m, 'cable: pulley_radius_m')
        require_positive(self.number_of_cables, 'cable: number_of_cables')
        if self.number_of_cables != int(self.number_of_cables):
            raise UserError(
                f'cable: number_of_cables is {self.number_of_cables!r}; give a whole number.'
            )
        require_not_negative(self.loss_factor, 'cable: loss_factor')
        free_length_m(self.cable_length_m, self.pulley_radius_m)


def metallic_area_7x19_m2(nominal_diameter_m: float) -> float:
    """
    Return the cross-section of steel in m2 of a 7x19 rope of a nominal diameter in m.

    Fifteen equal round wires lie side by side across the nominal diameter d, so each is d/15 thick
    and the 133 together have 133/225 = 0.591 of the area of the circle, 0.464 d^2. The lay of the
    strands (which makes their sections slightly oval) and gaps between wires are left out; makers'
    figures for 7x19 lie at 0.46 to 0.49 d^2.
    """
    require_positive(nominal_diameter_m, 'nominal_diameter_m')
    wire_diameter_m = nominal_diameter_m / WIRES_ACROSS_7X19
    return WIRES_7X19 * math.pi / 4.0 * wire_diameter_m**2


def free_length_m(cable_length_m: float, pulley_radius_m: float) -> float:
    """
    Return L1 + L2 = L_cable - pi r_p in m, equation (5.3).

    This is the length that hangs free on the two sides; the half turn on the pulley is held by
    friction. Raises `UserError` if nothing is left.
    """
    require_positive(cable_length_m, 'cable_length_m')
    require_positive(pulley_radius_m, 'pulley_radius_m')
    length_m = cable_length_m - math.pi * pulley_radius_m
    if length_m <= 0.0:
        raise UserError(
            f'cable: cable_length_m {cable_length_m!r} is not longer than the half turn on the '
            f'pulley, {math.pi * pulley_radius_m:.6g} m; check cable_length_m and pulley_radius_m.'
        )
    return length_m


def effective_stiffness_n_per_m(cable: Cable) -> float:
    """
    Return the stiffness in N/m of all cables together between payload and counterweight.

    One cable has EA/L (5.1); its two sides in series give k_eff = EA/(L1 + L2) (5.2), which does
    not depend on where the payload is. The parallel cables add: 2 k_eff in the thesis.
    """
    area_m2 = metallic_area_7x19_m2(cable.nominal_diameter_m)
    length_m = free_length_m(cable.cable_length_m, cable.pulley_radius_m)
    return cable.number_of_cables * cable.elastic_modulus_pa * area_m2 / length_m


def least_tension_n(cable: Cable) -> float:
    """
    Return the tension of one rope in N below which it does not bend around the half of its pulley.

    An elastica of flexural rigidity E I that leaves a pulley of radius R with the moment E I / R turns
    by theta before it touches, T (1 - cos theta) = E I / (2 R^2). At T = E I / (2 R^2) that is 90
    degrees on either side: the rope touches at the top only, and its bow is a second compliance in
    series. I is that of the wires side by side, 133 pi (d/15)^4 / 64, as they slide on one another; a
    rope whose wires are held by rust or dirt is stiffer, up to a rod's, 380 times.
    """
    wire_diameter_m = cable.nominal_diameter_m / WIRES_ACROSS_7X19
    area_moment_m4 = WIRES_7X19 * math.pi / 64.0 * wire_diameter_m**4
    return cable.elastic_modulus_pa * area_moment_m4 / (2.0 * cable.pulley_radius_m**2)
