# SPDX-License-Identifier: Apache-2.0
"""Tune an axis of a model: the gains, their margins at every pose beside the present ones, the runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from waferbot_lockstep.contract import AXES, USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_plant.assembly import assemble
from waferbot_plant.plant import Machine
from waferbot_pmac.experiments import Experiment
from waferbot_twin.effects.places import described_axes
from waferbot_twin.effects.variant import Variant, with_rigid
from waferbot_twin.tuning.gains import AxisScale, IVariables, Tuning, tuning_of
from waferbot_twin.tuning.loop import Linearised, Loop
from waferbot_twin.tuning.runs import Behaviour, behave
from waferbot_twin.tuning.search import (
    GENERATIONS,
    Design,
    Required,
    for_bandwidth,
    for_experiment,
)

DEFAULT_POSES: Mapping[str, tuple[float, ...]] = {
    'y_linear': (0.0, 0.3),
    'x_rotate': (0.0, np.pi / 4.0, np.pi / 2.0),
}
"""Grid of poses of the machine of the thesis, m and rad: where its experiments go."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Row:
    """The loop of the axis at one pose of one machine, with the present and with the new gains."""

    machine: str
    pose: Mapping[str, float]
    before: Loop
    after: Loop


@dataclass(frozen=True, eq=False)
class Tuned:
    """
    What tuning gave: gains before and after, loops at every pose, and runs if there was an experiment.

    `before` and `after` are the settings of the axis that differ; `met` tells whether the required
    margins are met everywhere.
    """

    axis: str
    design: Design
    tuning: Tuning
    before: IVariables
    after: IVariables
    rows: Sequence[Row]
    experiment: str
    runs: tuple[Behaviour, Behaviour] | None

    @property
    def variant(self) -> Variant:
        """The model with the new gains."""
        return self.design.with_gains(self.after)

    @cached_property
    def met(self) -> bool:
        """Whether every loop is stable and has the required margins."""
        required = self.design.required
        return all(
            row.after.stable and not required.missed(row.after.margins) for row in self.rows
        )


def poses_of(variant: Variant, given: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """
    Return the grid of poses: all combinations of what is given per axis, m or rad.

    By default that of the machine of the thesis, and home for others. Raises `UserError` for an axis
    that the machine does not have.
    """
    axes = variant.description.axes
    for axis in given:
        if axis not in axes:
            raise UserError(f'{variant.name} has no axis {axis!r}; it has {", ".join(axes)}')
    as_shipped = set(axes) == set(AXES) and variant.description.axis_units == USUAL_UNITS
    grid = given or (DEFAULT_POSES if as_shipped else {})
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


def design_of(
    variant: Variant,
    axis: str,
    poses: Sequence[Mapping[str, float]],
    others: Sequence[Variant] = (),
    required: Required | None = None,
    with_notch: bool = False,
    timing: Timing | None = None,
) -> Design:
    """
    Return what is to be tuned: an axis of a model, with margins at `poses` of it and of `others`.

    Raises `UserError` for an axis that has no motor, or no PMAC.
    """
    timing = timing or Timing()
    if axis not in variant.description.axes or axis not in variant.description.motors:
        raise UserError(f'{variant.name} has no axis {axis!r} with a motor')
    if described_axes(variant) or not variant.pmac.get(axis):
        raise UserError(
            f'{variant.name}: nothing is known of a PMAC of {axis} that could be tuned'
        )
    description = with_rigid(variant.description, variant.description.connections)
    rigid = Machine(description, assemble(description), timing)
    machines = [
        Linearised.of(one.name, machine, pose, timing)
        for one in (variant, *others)
        for machine in [one.build(timing)]
        for pose in poses
    ]
    scale = AxisScale.of(rigid, axis)
    return Design(variant, axis, machines, required or Required(), scale, timing, with_notch)


def tune(
    design: Design,
    experiment: Experiment | None,
    measure: str = 'settling_time',
    bandwidth_hz: float | None = None,
    generations: int = GENERATIONS,
    progress: Progress = lambda done, total: None,
) -> Tuned:
    """
    Tune for a bandwidth, or, without one, for the measure of an experiment.

    With both, the experiment is run with the gains before and after. Raises `UserError`.
    """
    present = tuning_of(design.servo({}), design.scale)
    if bandwidth_hz is not None:
        found = for_bandwidth(design, bandwidth_hz, present, generations)
    elif experiment is not None:
        found = for_experiment(design, experiment, measure, present, generations, progress)
    else:
        raise UserError('give a bandwidth or an experiment to tune for')
    if not design.with_notch:
        found = replace(found, notch_hz=0.0)
    return judge(design, found, experiment)


def judge(design: Design, tuning: Tuning, experiment: Experiment | None) -> Tuned:
    """Return margins and runs of a tuning beside those of the present gains."""
    after = design.gains(tuning)
    before = {name: design.variant.i_variable(design.axis, name) for name in after}
    old, new = design.servo({}), design.servo(after)
    rows = [
        Row(one.name, one.pose, one.loop(old, design.axis), one.loop(new, design.axis))
        for one in design.machines
    ]
    runs = None
    if experiment is not None:
        one, other = (
            behave(variant, experiment, design.timing)[design.axis]
            for variant in (design.variant, design.with_gains(after))
        )
        runs = (one, other)
    name = '' if experiment is None else experiment.name
    return Tuned(design.axis, design, tuning, before, after, rows, name, runs)
