# SPDX-License-Identifier: Apache-2.0
"""
The energy audit: where the energy came from, where it is, and which element lost how much.

Every element books its loss in the state, tick by tick, with the very forces and speeds of the
step. So

    electrical + work of outside forces = change of stored energy + sum of losses

holds to the second order of the step, and to rounding in what is linear. Losses are shown in
joules since the start; `loss_powers` gives the mean watts between two moments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from waferbot_plant import plant
from waferbot_plant.plant import Machine


@dataclass(frozen=True)
class Books:
    """
    The books at one moment, J.

    `supplied` since the start, from the amplifiers (by axis) and `outside`; `stored` at this
    moment (kinetic, gravity, elastic, magnetic); `lost` since the start by element.
    """

    supplied: dict[str, float]
    stored: dict[str, float]
    lost: dict[str, float]


def books(machine: Machine, state: NDArray[np.void], parameters: NDArray[np.void]) -> Books:
    """Return the books of a state. Names of losses say the element and its kind."""
    s = state[0]
    stored = np.zeros(4)
    plant.energy(state, parameters, stored)
    assembly = machine.assembly
    lost = {}
    for place, axis in enumerate(machine.layout.axes):
        if axis in machine.description.motors:
            lost[f'{axis} copper'] = float(s['copper_loss'][place])
    for place, element in enumerate(assembly.springs):
        kind = 'damping' if element.connections else 'viscous friction'
        lost[f'{element.name} {kind}'] = float(s['spring_loss'][place])
    for place, element in enumerate(assembly.cables):
        lost[f'{element.name} damping'] = float(s['cable_loss'][place])
    for place, name in enumerate(machine.description.frictions):
        lost[f'{name} dry friction'] = float(s['friction_loss'][place])
    supplied = {
        axis: float(s['electrical_energy'][place])
        for place, axis in enumerate(machine.layout.axes)
        if axis in machine.description.motors
    }
    for place, (name, force) in enumerate(machine.description.disturbances.items()):
        if force.kind != 'periodic':
            supplied[f'{name} disturbance'] = float(s['disturbance_work'][place])
    if machine.description.vibration.acceleration.any():
        supplied['floor'] = float(s['floor_work'])
    return Books(
        supplied={**supplied, 'outside': float(s['external_work'])},
        stored=dict(
            zip(('kinetic', 'gravity', 'elastic', 'magnetic'), stored.tolist(), strict=True)
        ),
        lost=lost,
    )


def imbalance(before: Books, after: Books) -> float:
    """Return supplied minus stored minus lost between two moments, J."""
    totals = [
        sum(book.supplied.values()) - sum(book.stored.values()) - sum(book.lost.values())
        for book in (before, after)
    ]
    return totals[1] - totals[0]


def loss_powers(before: Books, after: Books, seconds: float) -> dict[str, float]:
    """Return the mean loss of every element between two moments, W."""
    return {name: (after.lost[name] - before.lost[name]) / seconds for name in after.lost}
