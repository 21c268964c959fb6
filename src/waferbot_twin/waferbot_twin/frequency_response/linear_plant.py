# SPDX-License-Identifier: Apache-2.0
"""
Small motion of the plant alone: the response that its linearised equations have.

    M z'' + D z' + K z = b F        x = c z        x / F = c (K + j w D - w^2 M)^-1 b

with F the force (N) or torque (Nm) of an axis' motor, referred to the axis, and x what its position
encoder is on (m, rad). M, D, K as in `waferbot_plant.modes`; dry friction is left out, and so are
delays.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_plant.modes import damping_matrix, stiffness_at
from waferbot_plant.plant import mass_matrix
from waferbot_twin.effects.places import coordinate, motor_coordinate, motor_ratio
from waferbot_twin.effects.variant import Variant
from waferbot_twin.frequency_response.estimate import Array, ComplexArray


def position_over_force(
    variant: Variant,
    axes: tuple[str, str],
    frequency_hz: Array,
    positions: Mapping[str, float] | None = None,
) -> ComplexArray:
    """
    Return the position of the second axis over the force at the first one, m or rad per N or Nm, (n,).

    `positions` are where the axes stand (m, rad); home by default.
    """
    machine = variant.build(Timing())
    parameters = machine.parameters()
    state = machine.initial_state(parameters, positions)
    size = len(machine.coordinates)
    mass = np.zeros((size, size))
    mass_matrix(state, parameters, mass)
    pushed, read = np.zeros(size), np.zeros(size)
    placing = machine.assembly.placing
    row, ratio = placing[motor_coordinate(variant, axes[0])]
    pushed[row] = ratio / motor_ratio(variant, axes[0])
    row, ratio = placing[coordinate(variant, axes[1])]
    read[row] = ratio
    omega = 2.0 * np.pi * frequency_hz[:, None, None]
    dynamic = (
        stiffness_at(machine, state, parameters)
        + 1j * omega * damping_matrix(machine)
        - omega**2 * mass
    )
    right = np.broadcast_to(pushed[:, None], (*dynamic.shape[:2], 1))
    response = np.linalg.solve(dynamic, right)[..., 0] @ read
    return np.asarray(response, np.complex128)
