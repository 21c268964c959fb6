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

from waferbot_lockstep.errors import UserError
from waferbot_plant import plant, statics
from waferbot_plant.assembly import Behaviour
from waferbot_plant.description import Description
from waferbot_plant.plant import Machine

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
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding='utf-8')


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


def plot_modes(machine: Machine, modes: list[Mode], path: Path) -> None:
    """Draw how every coordinate moves in every mode (bars, largest 1) into an image file."""
    import matplotlib

    matplotlib.use('Agg')
    import matplotlib.pyplot as pyplot

    figure, axes = pyplot.subplots(
        len(modes), 1, figsize=(10.0, 1.1 * len(modes) + 1.5), sharex=True, squeeze=False
    )
    for axis, mode in zip(axes[:, 0], modes, strict=True):
        axis.bar(range(len(mode.shape)), list(mode.shape.values()), color='tab:blue')
        axis.axhline(0.0, color='black', linewidth=0.5)
        axis.set_ylim(-1.1, 1.1)
        axis.set_ylabel(f'{mode.frequency_hz:.1f} Hz', rotation=0, ha='right', va='center')
        axis.set_yticks([])
    axes[-1, 0].set_xticks(range(len(machine.coordinates)))
    axes[-1, 0].set_xticklabels(machine.coordinates, rotation=60, ha='right')
    figure.suptitle(f'{machine.description.name}: mode shapes (m and rad, largest entry 1)')
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
