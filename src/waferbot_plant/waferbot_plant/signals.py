# SPDX-License-Identifier: Apache-2.0
"""What a plant takes and shows, by name and unit: the inputs and outputs of a plant that is an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.layout import SHIPPED, Layout


@dataclass(frozen=True)
class Variable:
    """An input or output: name, unit ('' for none, 'count'), what it is."""

    name: str
    unit: str
    meaning: str


def per_axis(name: str, unit: str, meaning: str, layout: Layout = SHIPPED) -> tuple[Variable, ...]:
    """Return a variable for each axis."""
    return tuple(Variable(f'{axis}_{name}', unit, f'{axis}: {meaning}') for axis in layout.axes)


def voltages(layout: Layout = SHIPPED) -> tuple[Variable, ...]:
    """Return the terminal voltages of the motors."""
    return tuple(
        Variable(f'{axis}_voltage_{terminal}', 'V', f'{axis}: terminal {terminal} of the motor')
        for axis in layout.axes
        for terminal in (1, 2, 3)
    )


def terminals(layout: Layout = SHIPPED) -> tuple[Variable, ...]:
    """Return whether the terminals of the motors are open."""
    return per_axis('open', '', '1: the terminals of the motor are open, 0: connected', layout)


def lines(layout: Layout = SHIPPED) -> tuple[Variable, ...]:
    """Return the measured line currents."""
    return tuple(
        Variable(f'{axis}_current_{line}', 'A', f'{axis}: measured current into line {line}')
        for axis in layout.axes
        for line in (1, 2)
    )


def counts(layout: Layout = SHIPPED) -> tuple[Variable, ...]:
    """Return the counts of the encoders."""
    return tuple(
        Variable(f'{name}_counts', 'count', f'encoder {name}, as published')
        for name in layout.encoders
    )


def positions(units: Mapping[str, str] = USUAL_UNITS) -> tuple[Variable, ...]:
    """Return the positions of the axes of a machine with these units, `Description.axis_units`."""
    return tuple(
        Variable(f'{axis}_position', unit, f'{axis}: where it is') for axis, unit in units.items()
    )


def speeds(units: Mapping[str, str] = USUAL_UNITS) -> tuple[Variable, ...]:
    """Return the speeds of the axes of a machine with these units."""
    return tuple(
        Variable(f'{axis}_velocity', f'{unit}/s', f'{axis}: how fast it is')
        for axis, unit in units.items()
    )
