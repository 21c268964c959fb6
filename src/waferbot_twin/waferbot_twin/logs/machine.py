# SPDX-License-Identifier: Apache-2.0
"""
Constants of a machine that turn what a log holds (counts, phase currents) into SI units.

A plain log needs a description only where it is in counts. A recording of the contract's topics needs
the servo's and the amplifier's settings too: counts per unit, and the commutation angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.parameters import did_you_mean
from waferbot_lockstep.timing import Timing
from waferbot_plant.description import Description
from waferbot_plant.description_file import load_description
from waferbot_plant.plant import description_source
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.models import Model


@dataclass(frozen=True)
class Machine:
    """
    What is known of the machine that a log is of.

    `linear` tells for each axis whether it moves by metres; `counts_per_unit` is counts per m or rad
    by name of the encoder, of its own coordinate; `countings` how each counts in logs.
    """

    name: str
    linear: Mapping[str, bool]
    counts_per_unit: Mapping[str, float]
    countings: Mapping[str, str] = field(default_factory=dict)
    layout: Layout = SHIPPED

    def encoder(self, axis: str, kind: str) -> str:
        """
        Return the encoder behind `position` (that of the load, if there are two) or `motor_position`.

        Raises `UserError` for an axis that the machine lacks.
        """
        own = self.layout.encoders_of(axis)
        if not own:
            raise UserError(
                f'machine {self.name} has no axis {axis}{did_you_mean(axis, self.layout.axes)}'
            )
        return own[-1] if kind == 'motor_position' else own[0]

    def counting(self, axis: str, kind: str) -> str:
        """Return how the encoder behind a position counts in logs, '' where nobody says."""
        if kind not in ('position', 'motor_position'):
            return ''
        return self.countings.get(self.encoder(axis, kind), '')

    def counts(self, axis: str, kind: str) -> float:
        """Return the counts per m or rad behind a kind of signal; raises `UserError`."""
        place = self.encoder(axis, kind)
        if place not in self.counts_per_unit:
            known = ', '.join(self.counts_per_unit) or 'none'
            raise UserError(
                f'machine {self.name} has no encoder {place}, so counts of {axis} {kind} have no '
                f'length (its encoders: {known})'
            )
        return self.counts_per_unit[place]


def machine_of(description: Description) -> Machine:
    """Return the constants of a description."""
    return Machine(
        description.name,
        {axis: not description.turns(axis) for axis in description.axes},
        {place: encoder.counts_per_unit for place, encoder in description.encoders.items()},
        {place: encoder.counting for place, encoder in description.encoders.items()},
        description.layout,
    )


def load_constants(name_or_path: str | Path) -> Machine:
    """Return the constants of a description by name or path; raises `UserError`."""
    return machine_of(load_description(description_source(name_or_path)))


@dataclass(frozen=True)
class Controls:
    """Settings behind the contract's topics: `servo` and `amplifier` as the nodes use them."""

    timing: Timing
    servo: np.void
    amplifier: np.void
    machine: Machine


def controls_of(model: Model, timing: Timing, where: str) -> Controls:
    """Return the settings in a model; raises `UserError`."""
    source = description_source(model.description)
    damping = str(model.parameters['plant'].get('damping', 'improved'))
    return Controls(
        timing,
        servo_parameters(model.of_axes('pmac'), where, model.layout)[0],
        amplifier_parameters(model.of_axes('copley'), timing, where, model.layout)[0],
        machine_of(load_description(source, damping=damping)),
    )
