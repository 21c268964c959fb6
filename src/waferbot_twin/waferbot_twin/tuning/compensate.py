# SPDX-License-Identifier: Apache-2.0
"""What compensation tables gain: runs of a machine without and with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
import yaml

from waferbot_lockstep.timing import Timing
from waferbot_pmac.compensation import Table, table_text
from waferbot_pmac.experiments import Experiment
from waferbot_twin.effects.variant import Overlay, Variant
from waferbot_twin.html_page import save_picture
from waferbot_twin.plain_values import finite
from waferbot_twin.plot import COMMAND_COLOUR, ERROR_COLOUR, MEASURED_COLOUR, scaled_unit
from waferbot_twin.recording.writer import as_json
from waferbot_twin.tuning.feedforward import (
    commanded_motion,
    compensated,
    machine_tables,
    motion_tables,
)
from waferbot_twin.tuning.runs import Behaviour, behave

FILES = ('compensation.csv', 'model.yaml', 'feedforward.png', 'feedforward.json')

CASES = ('as it is', 'Ixx32 = Ixx31', 'with tables')
"""What is run: the present settings, velocity feedforward alone, and the tables."""

COLOURS = (COMMAND_COLOUR, MEASURED_COLOUR, ERROR_COLOUR)

LEAST_TRAVEL, LEAST_SPEED = 1e-3, 1e-2
"""Least range of a table of the machine, m or rad, and per s."""


@dataclass(frozen=True, eq=False)
class Compensated:
    """Tables that were made from a model, the machine with them, and its runs by case and axis."""

    source: str
    experiment: str
    kind: str
    tables: tuple[Table, ...]
    variant: Variant
    runs: Mapping[str, Mapping[str, Behaviour]]

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes that the experiment moves."""
        return tuple(axis for axis, run in self.runs[CASES[0]].items() if run.response.moves())

    def gain(self, axis: str, case: str = CASES[0]) -> float:
        """Return by what share the tables make the RMS following error of a case smaller."""
        before = self.runs[case][axis].rms_following_error
        after = self.runs[CASES[-1]][axis].rms_following_error
        return 1.0 - after / before if before > 0.0 else math.nan


def compensate(
    model: Variant,
    on: Variant,
    experiment: Experiment,
    kind: str,
    timing: Timing | None = None,
) -> Compensated:
    """
    Make tables (`feedforward.KINDS`) from a model, and run the experiment on a machine without and with.

    The model gives the mechanics, the machine `on` the controller. Raises `UserError`.
    """
    timing = timing or Timing()
    known = replace(model, pmac=on.pmac)
    if kind == 'motion':
        tables = motion_tables(known, experiment, timing)
    else:
        position = commanded_motion(known, experiment, timing)
        speed = np.abs(np.diff(position, axis=0)).max(axis=0, initial=0.0) * timing.servo_hz
        moved = [axis for axis in known.description.axes if speed[known.layout.place(axis)] > 0.0]
        travel = {}
        for axis in moved:
            own = position[:, known.layout.place(axis)]
            low, high = float(own.min()), float(own.max())
            travel[axis] = (low, max(high, low + LEAST_TRAVEL))
        highest = {
            axis: max(float(speed[known.layout.place(axis)]), LEAST_SPEED) for axis in moved
        }
        tables = machine_tables(known, travel, highest)
    with_tables = compensated(known, tables)
    with_tables = replace(
        on, pmac=with_tables.pmac, node_settings=with_tables.node_settings, origin=on.base
    )
    velocity = on.with_overlay(
        Overlay(pmac={axis: {'Ixx32': int(on.i_variable(axis, 'Ixx31'))} for axis in on.pmac})
    )
    variants = dict(zip(CASES, (on, velocity, with_tables), strict=True))
    runs = {case: behave(variant, experiment, timing) for case, variant in variants.items()}
    return Compensated(model.name, experiment.name, kind, tables, with_tables, runs)


def as_dict(found: Compensated) -> dict[str, Any]:
    """Return the result as plain values, without the tables."""
    return dict(
        finite(
            {
                'schema': 1,
                'model': found.source,
                'on': found.variant.name,
                'experiment': found.experiment,
                'kind': found.kind,
                'gain': {axis: found.gain(axis) for axis in found.axes},
                'gain_over_velocity_feedforward': {
                    axis: found.gain(axis, CASES[1]) for axis in found.axes
                },
                'runs': {
                    case: {axis: runs[axis].figures() for axis in found.axes}
                    for case, runs in found.runs.items()
                },
            }
        )
    )


def write(found: Compensated, folder: Path) -> None:
    """Write tables, the model that names them, picture and JSON into a folder."""
    comment = f'made from {found.source} for {found.experiment}; current_a: A, peak of the sine'
    (folder / FILES[0]).write_text(table_text(found.tables, comment), 'utf-8')
    settings = {name: dict(values) for name, values in found.variant.node_settings.items()}
    settings['pmac']['compensation'] = FILES[0]
    text = replace(found.variant, node_settings=settings).text
    assert yaml.safe_load(text)
    (folder / FILES[1]).write_text(text, 'utf-8')
    draw(found, folder / FILES[2])
    (folder / FILES[3]).write_text(as_json(as_dict(found)) + '\n', 'utf-8')


def draw(found: Compensated, file: Path) -> None:
    """Draw the following error of each axis that moves, in every case, and the tables below."""
    axes = found.axes
    figure, panels = plt.subplots(2, len(axes), figsize=(4.6 * len(axes), 6.0), squeeze=False)
    for column, axis in enumerate(axes):
        upper, lower = panels[0][column], panels[1][column]
        first = found.runs[CASES[0]][axis].response
        factor, unit = scaled_unit(first.following_error, first.unit)
        for case, colour in zip(CASES, COLOURS, strict=True):
            run = found.runs[case][axis].response
            upper.plot(
                run.servo_time, run.following_error * factor, color=colour, lw=0.9, label=case
            )
        upper.set_title(
            f'{found.variant.titles[axis]}: {100.0 * found.gain(axis):.1f} % smaller RMS'
        )
        upper.set_ylabel(f'following error [{unit}]')
        upper.set_xlabel('time [s]')
        upper.legend(fontsize=8)
        for table in found.tables:
            if table.axis == axis:
                lower.plot(table.at, table.current, lw=0.9, label=table.over)
        lower.set_xlabel('position, speed or time of the table')
        lower.set_ylabel('current [A]')
        lower.legend(fontsize=8)
        for panel in (upper, lower):
            panel.grid(alpha=0.3)
    figure.tight_layout()
    save_picture(figure, file)
