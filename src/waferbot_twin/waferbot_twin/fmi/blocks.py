# SPDX-License-Identifier: Apache-2.0
"""
Parts of the twin with named inputs and outputs, tick by tick: what an FMU holds.

    plant    voltages                              -> counts, line currents, positions, speeds
    pmac     commanded positions, counts           -> current commands, following errors
    copley   current commands, line currents, counts -> voltages
    twin     commanded positions                   -> counts, currents, positions, speeds, commands

`step` takes the inputs of tick k and goes on to tick k + 1. Outputs of plant and twin are those of the
tick that was reached: what the encoders and current sensors show there. Those of PMAC and Copley are
what they put out in tick k, held until they put out something else; the PMAC acts on its servo ticks.
Values are float64, SI or counts.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from waferbot_copley import amplifier
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.timing import Timing
from waferbot_plant import plant
from waferbot_plant.motors import check_windings
from waferbot_plant.signals import (
    Variable,
    counts,
    lines,
    per_axis,
    positions,
    speeds,
    terminals,
    voltages,
)
from waferbot_pmac import servo
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import open_terminals

KINDS = ('plant', 'twin', 'pmac', 'copley')

Floats = np.ndarray

Variables = tuple[Variable, ...]


def variables_of(
    kind: str, units: Mapping[str, str] = USUAL_UNITS, layout: Layout = SHIPPED
) -> tuple[Variables, Variables]:
    """
    Return inputs and outputs of a kind of block, in the order of its arrays.

    Of a machine whose axes have these units, m or rad: `Description.axis_units`.
    """
    commands = per_axis('current_command', 'A', 'current command, peak of the sine', layout)
    errors = per_axis('following_error', 'count', 'following error', layout)
    driven = (*voltages(layout), *terminals(layout))
    seen, measured = counts(layout), lines(layout)
    commanded = tuple(
        Variable(
            f'{axis}_commanded', units[axis], f'{axis}: commanded position, from where it began'
        )
        for axis in layout.axes
    )
    shown = (*seen, *measured, *positions(units), *speeds(units))
    return {
        'plant': (driven, shown),
        'twin': (commanded, (*shown, *commands)),
        'pmac': ((*commanded, *seen), (*commands, *errors)),
        'copley': ((*commands, *measured, *seen), driven),
    }[kind]


class PlantBlock:
    """Mechanism, motors, encoders and sensors."""

    def __init__(self, variant: Variant, timing: Timing) -> None:
        """Begin at rest, held by the motors' currents; raises `UserError`."""
        machine = variant.build(timing)
        check_windings(machine.description)
        self._machine = machine
        self._parameters = machine.parameters()
        self._state = machine.resting_state(self._parameters)
        self._tick = 0
        axes = self._axes = len(machine.layout.axes)
        self._counts = np.zeros(len(machine.layout.encoders), np.int64)
        self._lines = np.zeros(2 * axes)
        self._motion = np.zeros((2, axes))
        self._measure()

    def step(self, inputs: Floats) -> None:
        """Advance by a tick with the inputs held."""
        voltage, opened = np.split(inputs, (3 * self._axes,))
        mask = sum(1 << axis for axis, off in enumerate(opened) if off != 0.0)
        open_terminals(self._state, mask)
        plant.advance(self._state, self._parameters, np.ascontiguousarray(voltage))
        self._tick += 1
        self._measure()
        coordinate = plant.runaway(self._state)
        if coordinate >= 0:
            raise UserError(self._machine.runaway_message(coordinate, self._tick))

    def _measure(self) -> None:
        plant.measure(self._state, self._parameters, self._tick, self._counts, self._lines)
        plant.joint_positions(self._state, self._parameters, self._motion[0], self._motion[1])

    def values(self) -> Floats:
        """Return the outputs."""
        return np.concatenate([self._counts, self._lines, *self._motion])


class PmacBlock:
    """The servo of all axes."""

    def __init__(self, variant: Variant, timing: Timing) -> None:
        """Begin with all loops open; they close at the counts of the first tick."""
        self._timing = timing
        axes = self._axes = len(variant.layout.axes)
        self._parameters = servo_parameters(variant.pmac, variant.name, variant.layout)
        self._state = servo.initial_state(self._parameters)
        self._start = np.zeros(axes)
        self._current = np.zeros(axes)
        self._tick = 0

    def step(self, inputs: Floats) -> None:
        """Run a servo cycle if it is time for one."""
        if self._tick % self._timing.servo_divider == 0:
            commanded, readings = np.split(inputs, (self._axes,))
            counts = np.rint(readings).astype(np.int64)
            if self._tick == 0:
                self._start = counts[self._parameters['Ixx03'][0]].astype(float)
                servo.prime(self._state, self._parameters, counts, self._start)
            target = self._start + commanded * self._parameters['counts_per_unit'][0]
            servo.step(self._state, self._parameters, counts, target, self._current)
        self._tick += 1

    def values(self) -> Floats:
        """Return the outputs."""
        return np.concatenate([self._current, self._state['following_error'][0]])


class CopleyBlock:
    """The amplifiers of all axes."""

    def __init__(self, variant: Variant, timing: Timing) -> None:
        """Begin at rest; raises `UserError`."""
        self._layout = variant.layout
        self._parameters = amplifier_parameters(variant.copley, timing, variant.name, self._layout)
        self._state = amplifier.initial_state(self._parameters)
        self._voltage = np.zeros(3 * len(self._layout.axes))

    def step(self, inputs: Floats) -> None:
        """Run a tick of the current loops."""
        axes = len(self._layout.axes)
        command, lines, readings = (part.copy() for part in np.split(inputs, (axes, 3 * axes)))
        counts = np.rint(readings).astype(np.int64)
        amplifier.step(
            self._state,
            self._parameters,
            self._layout.all_axes,
            command,
            lines,
            counts,
            self._voltage,
        )

    def values(self) -> Floats:
        """Return the outputs."""
        mask = amplifier.open_bridges(self._state)
        opened = [float(mask >> axis & 1) for axis in range(len(self._layout.axes))]
        return np.concatenate([self._voltage, opened])


class TwinBlock:
    """All three in closed loop."""

    def __init__(self, variant: Variant, timing: Timing) -> None:
        """Begin at rest; raises `UserError`."""
        self._plant = PlantBlock(variant, timing)
        self._pmac = PmacBlock(variant, timing)
        self._copley = CopleyBlock(variant, timing)
        self._axes, self._encoders = len(variant.layout.axes), len(variant.layout.encoders)

    def step(self, inputs: Floats) -> None:
        """Run a tick: PMAC, Copley, plant."""
        edges = (self._encoders, self._encoders + 2 * self._axes)
        readings, lines, _ = np.split(self._plant.values(), edges)
        self._pmac.step(np.concatenate([inputs, readings]))
        command = self._pmac.values()[: self._axes]
        self._copley.step(np.concatenate([command, lines, readings]))
        self._plant.step(self._copley.values())

    def values(self) -> Floats:
        """Return the outputs."""
        return np.concatenate([self._plant.values(), self._pmac.values()[: self._axes]])


Block = PlantBlock | PmacBlock | CopleyBlock | TwinBlock

BLOCKS: dict[str, type[PlantBlock] | type[PmacBlock] | type[CopleyBlock] | type[TwinBlock]] = {
    'plant': PlantBlock,
    'twin': TwinBlock,
    'pmac': PmacBlock,
    'copley': CopleyBlock,
}
