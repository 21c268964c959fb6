# SPDX-License-Identifier: Apache-2.0
"""
What moves behind the plant's node: the model of this package, or an FMU.

Both measure at a tick, advance over it with the terminal voltages held, and can begin anew.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import Layout
from waferbot_lockstep.timing import Timing
from waferbot_plant import loads, plant
from waferbot_plant.foreign_plant import ForeignPlant, read_mapping


class Mechanism(Protocol):
    """Mechanism, motors and encoders, tick by tick."""

    def measure(self, tick: int, counts: np.ndarray, line_currents: np.ndarray) -> None:
        """Fill in the counts (encoders,) and measured line currents (2 axes,), A, of a tick."""

    def advance(self, tick: int, voltages: Any, mask: int) -> None:
        """Go on to the next tick with terminal voltages (3 axes,), V; bits of `mask`: open bridges."""

    def joints(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in positions and speeds (axes,) of the axes, m or rad."""

    def runaway(self, tick: int) -> str:
        """Return what blew up at this tick, or ''."""

    def note_loads(self) -> None:
        """Note what parts bear, once in a servo cycle."""

    def take_loads(self, borne: np.ndarray) -> bool:
        """Fill in what parts had to bear since last asked (loads.width,); False if nobody knows."""

    def reset(self) -> None:
        """Begin anew, at rest."""


class ModelledMechanism:
    """The compiled model; `state` and `parameters` are its arrays."""

    def __init__(self, machine: plant.Machine) -> None:
        """Begin at rest."""
        self._machine = machine
        self.parameters = machine.parameters()
        self.state = machine.resting_state(self.parameters)
        self._axes = len(machine.layout.axes)
        self._loads = loads.begin(self._axes)
        self._warm_up()

    def measure(self, tick: int, counts: np.ndarray, line_currents: np.ndarray) -> None:
        """Fill in counts and line currents."""
        plant.measure(self.state, self.parameters, tick, counts, line_currents)

    def advance(self, tick: int, voltages: Any, mask: int) -> None:
        """Integrate over the tick."""
        terminals_open = self.state['terminals_open'][0]
        for axis in range(self._axes):
            terminals_open[axis] = mask >> axis & 1
        plant.advance(self.state, self.parameters, voltages)

    def joints(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in where the axes are and how fast."""
        plant.joint_positions(self.state, self.parameters, position, velocity)

    def runaway(self, tick: int) -> str:
        """Return what blew up, or ''."""
        coordinate = plant.runaway(self.state)
        return self._machine.runaway_message(coordinate, tick) if coordinate >= 0 else ''

    def note_loads(self) -> None:
        """Note what springs bear."""
        loads.note(self.state, self.parameters, self._loads)

    def take_loads(self, borne: np.ndarray) -> bool:
        """Fill in what parts had to bear."""
        loads.take(self.state, self.parameters, self._loads, borne)
        return True

    def reset(self) -> None:
        """Put the machine to rest where it began."""
        self.state[:] = self._machine.resting_state(self.parameters)
        self._loads[:] = loads.begin(self._axes)

    def _warm_up(self) -> None:
        """Compile before the first message, so that no peer waits for the compiler."""
        axes, counts = self._axes, np.zeros(len(self._machine.layout.encoders), np.int64)
        state, moved = self._machine.initial_state(self.parameters), np.zeros((2, axes))
        plant.measure(state, self.parameters, 0, counts, np.zeros(2 * axes))
        plant.advance(state, self.parameters, np.zeros(3 * axes))
        plant.joint_positions(state, self.parameters, moved[0], moved[1])
        plant.runaway(state)
        loads.take(state, self.parameters, loads.begin(axes), np.zeros(loads.width(axes)))


class ForeignMechanism:
    """An FMU; what its parts bear nobody knows."""

    def __init__(self, fmu: str, mapping: str, timing: Timing, layout: Layout) -> None:
        """Instantiate an FMU, with a file of names or ''; raises `UserError`."""
        names = read_mapping(Path(mapping) if mapping else None, layout)
        self._plant = ForeignPlant(Path(fmu), names, timing, layout)
        self._shown = self._plant.values()

    def measure(self, tick: int, counts: np.ndarray, line_currents: np.ndarray) -> None:
        """Fill in what the FMU shows."""
        self._shown = self._plant.values()
        readings, line_currents[:], _, _ = self._plant.parts(self._shown)
        counts[:] = np.rint(readings)

    def advance(self, tick: int, voltages: Any, mask: int) -> None:
        """Step the FMU."""
        self._plant.step(tick, np.asarray(voltages), mask)

    def joints(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Fill in what the FMU shows of them, or zeros."""
        _, _, position[:], velocity[:] = self._plant.parts(self._shown)

    def runaway(self, tick: int) -> str:
        """Return '': values that are not finite are refused where they are read."""
        return ''

    def note_loads(self) -> None:
        """Note nothing."""

    def take_loads(self, borne: np.ndarray) -> bool:
        """Tell that nobody knows."""
        return False

    def reset(self) -> None:
        """Instantiate anew."""
        self._plant.reset()


def mechanism(machine: plant.Machine, fmu: str, mapping: str, timing: Timing) -> Mechanism:
    """Return the model of a machine, or the FMU at a path that is not empty; raises `UserError`."""
    if not fmu:
        if mapping:
            raise UserError('fmu_map is for an FMU in the place of the plant: fmu is empty')
        return ModelledMechanism(machine)
    return ForeignMechanism(fmu, mapping, timing, machine.layout)
