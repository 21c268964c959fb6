# SPDX-License-Identifier: Apache-2.0
"""
Stiffnesses in combination, and the natural frequency of one spring.

The functions hold for translation (N/m with kg) and for rotation (Nm/rad with kg m2) alike; the
two must not be mixed in one call. The frequency of an element taken by itself serves two purposes:
the structural damping is set equal to viscous damping at it (5.5), and the elements whose
frequency is above ten times the bandwidth of the controller are taken as rigid (Table 6.7).
"""

from __future__ import annotations

import math

from waferbot_plant.parts.checks import require_positive


def hertz(angular_frequency_rad_per_s: float) -> float:
    """Return the frequency in Hz of an angular frequency in rad/s."""
    return angular_frequency_rad_per_s / (2.0 * math.pi)


def series_stiffness(*stiffnesses: float) -> float:
    """
    Return the stiffness of springs one behind the other, 1/k = sum of 1/k_i.

    All stiffnesses are referred to the same coordinate, in the same unit (N/m or Nm/rad), and
    positive. The result is below the softest of them.
    """
    for stiffness in stiffnesses:
        require_positive(stiffness, 'stiffness in series')
    return 1.0 / sum(1.0 / stiffness for stiffness in stiffnesses)


def grounded_frequency(stiffness: float, inertia: float) -> float:
    """
    Return the natural frequency in rad/s of an inertia on a spring to ground, sqrt(k/m).

    Equations (5.26), (5.29) and (5.31) of the thesis. `stiffness` in N/m with `inertia` in kg, or
    Nm/rad with kg m2; both positive. The other coordinates of the body are taken as held, so that
    coupling through an offset centre of gravity is left out.
    """
    require_positive(stiffness, 'stiffness')
    require_positive(inertia, 'inertia')
    return math.sqrt(stiffness / inertia)


def free_pair_frequency(stiffness: float, first_inertia: float, second_inertia: float) -> float:
    """
    Return the non-rigid natural frequency in rad/s of two inertias joined by a spring.

    The pair floats freely, so the eigenvalues of its mass and stiffness matrices are zero (the
    pair moves as one) and k (1/m1 + 1/m2). With equal masses this is equation (5.18) of the
    thesis, sqrt(2 k/m); with the second inertia infinite it is the grounded spring. `stiffness` in
    N/m with kg, or Nm/rad with kg m2 referred to the same shaft; all positive.
    """
    require_positive(stiffness, 'stiffness')
    require_positive(first_inertia, 'first inertia')
    require_positive(second_inertia, 'second inertia')
    return math.sqrt(stiffness * (1.0 / first_inertia + 1.0 / second_inertia))
