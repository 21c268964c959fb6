# SPDX-License-Identifier: Apache-2.0
"""
The mathematical plant: the rigid mechanism by the Euler-Lagrange equations of the thesis.

Chapter 2 and Appendix B of the thesis, kept independent of the multibody plant so that the two can
check each other. Three coordinates q = [d1, theta2, theta3] (2.27 to 2.29):

    M(q) q_ddot + h(q, q_dot) = Q

with M the mass matrix, h the bias (Coriolis, centrifugal and gravity terms) and Q the generalised
forces.

- ``derivation``  the symbolic derivation, equation by equation, in the order of the thesis;
- ``generate``    turns it into plain code: ``python -m waferbot_plant.lagrange.generate``;
- ``generated``   that code, kept in the repository, so that nothing is derived at run time;
- ``dynamics``    what one calls: forward and inverse dynamics, energies, payload frame;
- ``parameters``  the parameter record, and its making from bodies given in the base frame.

Where the text of the thesis disagrees with itself, see ``docs/thesis_errata.md``.
"""

from .dynamics import (
    PAYLOAD_FRAME,
    bias,
    counterweight_height,
    energies,
    forward_dynamics,
    generalised_forces,
    inverse_dynamics,
    mass_matrix,
    motor_angle,
    payload_frame,
)
from .parameters import (
    PARAMETERS,
    CableGeometry,
    RigidBody,
    YRotateDrive,
    check,
    combine,
    parameters_from_base_frame,
)

__all__ = [
    'PARAMETERS',
    'PAYLOAD_FRAME',
    'CableGeometry',
    'RigidBody',
    'YRotateDrive',
    'bias',
    'check',
    'combine',
    'counterweight_height',
    'energies',
    'forward_dynamics',
    'generalised_forces',
    'inverse_dynamics',
    'mass_matrix',
    'motor_angle',
    'parameters_from_base_frame',
    'payload_frame',
]
