# SPDX-License-Identifier: Apache-2.0
"""
Modal analysis: which connections matter, and how the machine vibrates as a whole.

Two different things are called frequency here. The **first frequency** of a connection is that of
its spring alone with the inertia that it carries, everything else held (Table 6.7 of the thesis);
it serves to pick the simplified model. The **coupled modes** are those of the whole machine at a
pose, with every flexible connection at once, from the linearised equations

    M z'' + D z' + K z = 0,    (K - omega^2 M) shape = 0

where K holds springs, taut cables and the stiffness of gravity, and the axes are free. Damping is
shown as the ratio of each mode by itself, shape' D shape / (2 omega); friction and motors are left
out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg
import yaml
from numpy.typing import NDArray

from waferbot_lockstep.atomic_files import write_text
from waferbot_lockstep.errors import UserError
from waferbot_plant import plant, statics
from waferbot_plant.assembly import Behaviour
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine

THESIS_FIRST_FREQUENCIES = {
    'cable': 37.44,
    'counterweight_bearing_x': 265.29,
    'counterweight_bearing_y': 197.25,
    'counterweight_bearing_z': 140.58,
    'payload_bearing_x': 1179.05,
    'payload_bearing_y': 254.36,
    'payload_bearing_z': 235.70,
    'x_rotate_bearing_radial': 433.18,
    'x_rotate_bearing_y': 77.35,
    'x_rotate_bearing_z': 76.28,
    'x_rotate_shaft_torsion': 1629.27,
    'x_rotate_shaft_bending': 349.86,
    'gearbox': 19.74,
    'belt': 19.74,
}
"""Table 6.7 by the names of our connections, Hz; gearbox and belt are one row there."""

BANDWIDTH_FACTOR = 10.0
"""A connection with a first frequency above this many bandwidths is rigid (chapter 6)."""


@dataclass(frozen=True)
class Mode:
    """
    A coupled mode: frequency in Hz, damping ratio, and shape by coordinate (largest entry 1).

    `energy` is the share of each connection group in the mode's elastic energy: where it bends.
    """

    frequency_hz: float
    damping_ratio: float
    shape: dict[str, float]
    energy: dict[str, float]


def first_frequencies(description: Description) -> dict[str, float]:
    """Return the first frequency of every connection in Hz, whatever its switch says."""
    return Behaviour(description).first_frequencies()


@dataclass(frozen=True)
class FirstFrequency:
    """
    A row of Table 6.7: connections that share a first frequency, Hz, beside that of the thesis.

    `thesis_hz` is None for a connection that the thesis does not have; `flexible` is the state of
    the connections in the description.
    """

    connections: tuple[str, ...]
    frequency_hz: float
    thesis_hz: float | None
    flexible: bool

    @property
    def difference_percent(self) -> float | None:
        """Return how far ours is above the thesis', in percent of that."""
        if self.thesis_hz is None:
            return None
        return 100.0 * (self.frequency_hz / self.thesis_hz - 1.0)


def table_of_first_frequencies(description: Description) -> list[FirstFrequency]:
    """Return the first frequencies of all connections, the stages of a transmission in one row."""
    frequencies = first_frequencies(description)
    together: dict[str, tuple[str, ...]] = {name: (name,) for name in frequencies}
    for transmission in description.transmissions.values():
        names = tuple(stage.connection for stage in transmission.stages if stage.connection)
        together.update(dict.fromkeys(names, names))
    return [
        FirstFrequency(
            connections=names,
            frequency_hz=frequencies[names[0]],
            thesis_hz=THESIS_FIRST_FREQUENCIES.get(names[0]),
            flexible=any(description.connections[name].flexible for name in names),
        )
        for names in dict.fromkeys(together.values())
    ]


def pick_simplified(
    description: Description, bandwidth_hz: float, factor: float = BANDWIDTH_FACTOR
) -> dict[str, str]:
    """
    Return switches by the rule of the thesis: rigid above `factor` times the controller's
    bandwidth.

    With 30 Hz and the factor of ten, connections from 300 Hz up are rigid.
    """
    if bandwidth_hz <= 0.0 or factor <= 0.0:
        raise UserError(f'bandwidth {bandwidth_hz:g} Hz and factor {factor:g} must be above zero')
    limit = factor * bandwidth_hz
    return {
        name: 'rigid' if frequency > limit else 'flexible'
        for name, frequency in first_frequencies(description).items()
    }


def write_switches(
    path: Path, base: str, switches: Mapping[str, str], force: bool = False
) -> None:
    """Write a description that extends `base` and sets the switches; overwrites only if forced."""
    if path.exists() and not force:
        raise UserError(f'{path} exists; choose another name or force overwriting it')
    data = {
        'extends': base,
        'connections': {name: {'state': state} for name, state in switches.items()},
    }
    write_text(path, yaml.safe_dump(data, sort_keys=False))


def stiffness_at(
    machine: Machine, state: NDArray[np.void], parameters: NDArray[np.void]
) -> NDArray[np.float64]:
    """Return K at the state's pose, elastic plus gravity; the latter by central differences."""
    size = len(machine.coordinates)
    stiffness = statics.elastic_stiffness(machine)
    p = parameters.copy()
    p[0]['spring_stiffness'] = 0.0
    p[0]['cable_stiffness'] = 0.0
    probe = state.copy()
    probe[0]['velocity'] = 0.0
    step = 1e-5
    ahead, behind = np.zeros(size), np.zeros(size)
    gravity = np.zeros((size, size))
    for row in range(size):
        home = probe[0]['position'][row]
        probe[0]['position'][row] = home + step
        plant.generalised_forces(probe, p, ahead)
        probe[0]['position'][row] = home - step
        plant.generalised_forces(probe, p, behind)
        probe[0]['position'][row] = home
        gravity[:, row] = (behind - ahead) / (2.0 * step)
    return stiffness + 0.5 * (gravity + gravity.T)


def damping_matrix(machine: Machine) -> NDArray[np.float64]:
    """Return D of spring-dampers, dampers and taut cables, (n, n), N s/m or Nm s/rad."""
    size = len(machine.coordinates)
    damping = np.zeros((size, size))
    for element in (*machine.assembly.springs, *machine.assembly.cables):
        arms = np.zeros(size)
        for place, ratio in element.terms:
            arms[place] += ratio
        damping += element.damping * np.outer(arms, arms)
    return damping


def coupled_modes(machine: Machine, positions: Mapping[str, float] | None = None) -> list[Mode]:
    """
    Return the modes of the machine with the axes free at a pose, by rising frequency.

    Modes without elastic energy to speak of (the axes moving, perhaps swinging under gravity) are
    left out: those whose frequency is below 1e-4 of the highest, or whose stiffness is negative.
    """
    parameters = machine.parameters()
    state = machine.initial_state(parameters, positions)
    size = len(machine.coordinates)
    mass = np.zeros((size, size))
    plant.mass_matrix(state, parameters, mass)
    squares, shapes = scipy.linalg.eigh(stiffness_at(machine, state, parameters), mass)
    damping = damping_matrix(machine)
    elastic = statics.elastic_stiffness(machine)
    modes = []
    for square, shape in zip(squares, shapes.T, strict=True):
        if square <= 0.0 or square < 1e-8 * squares[-1]:
            continue
        if shape @ elastic @ shape < 0.5 * square:
            continue
        largest = shape[np.argmax(np.abs(shape))]
        modes.append(
            Mode(
                frequency_hz=math.sqrt(square) / (2.0 * math.pi),
                damping_ratio=float(shape @ damping @ shape) / (2.0 * math.sqrt(square)),
                shape=dict(zip(machine.coordinates, (shape / largest).tolist(), strict=True)),
                energy=_elastic_shares(machine, shape),
            )
        )
    return modes


def _elastic_shares(machine: Machine, shape: NDArray[np.float64]) -> dict[str, float]:
    """Return the share of every flexible element in the elastic energy of a shape."""
    energies = {
        element.name: element.stiffness
        * sum(ratio * shape[place] for place, ratio in element.terms) ** 2
        for element in (*machine.assembly.springs, *machine.assembly.cables)
        if element.connections
    }
    total = sum(energies.values())
    return {name: float(energy / total) for name, energy in energies.items()}
