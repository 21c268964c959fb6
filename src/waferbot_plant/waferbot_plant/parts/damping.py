# SPDX-License-Identifier: Apache-2.0
"""
The three models of loss: viscous (5.4), structural (5.5), Coulomb (5.6).

Written for translation; with torques and angular velocities in place of forces and velocities the
same functions serve rotation. Each gives the magnitude with the sign of the velocity: the force
that has to be applied to keep the motion up. On the moving body it acts with the opposite sign.
"""

from __future__ import annotations

from waferbot_plant.parts.checks import require_finite, require_not_negative, require_positive


def viscous_force(damping: float, velocity: float) -> float:
    """Return F = b v, equation (5.4): `damping` b in N s/m, `velocity` v in m/s, result in N."""
    require_not_negative(damping, 'viscous damping')
    require_finite(velocity, 'velocity')
    return damping * velocity


def structural_damping(
    loss_factor: float, stiffness: float, angular_frequency_rad_per_s: float
) -> float:
    """
    Return the viscous damping that stands for structural damping, b = eta k / omega (5.5).

    A material with loss factor eta loses 2 pi eta times the peak elastic energy in each cycle at
    any frequency; a viscous damper does so at one frequency only, here
    `angular_frequency_rad_per_s` (the first natural frequency of the element). Below it the damper
    loses too little, above it too much. The damping ratio of the element by itself is eta/2.

    `loss_factor` eta is dimensionless, zero or above; `stiffness` in N/m gives N s/m, in Nm/rad
    gives Nm s/rad.
    """
    require_not_negative(loss_factor, 'loss factor')
    require_positive(stiffness, 'stiffness')
    require_positive(angular_frequency_rad_per_s, 'angular frequency')
    return loss_factor * stiffness / angular_frequency_rad_per_s


def coulomb_force(friction_coefficient: float, normal_force_n: float, velocity: float) -> float:
    """
    Return F = mu N sgn(v) in N, equation (5.6); zero at zero velocity.

    `normal_force_n` is a magnitude, constant here. At rest the true friction is whatever prevents
    motion, up to the breakaway force: that is the friction element's business, not this
    function's.
    """
    require_not_negative(friction_coefficient, 'friction coefficient')
    require_not_negative(normal_force_n, 'normal_force_n')
    require_finite(velocity, 'velocity')
    sign = (velocity > 0.0) - (velocity < 0.0)
    return friction_coefficient * normal_force_n * sign
