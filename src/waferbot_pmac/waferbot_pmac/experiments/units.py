# SPDX-License-Identifier: Apache-2.0
"""Whether an experiment suits a machine: its axes, and their units, m if one slides, rad if it turns."""

from __future__ import annotations

from collections.abc import Iterator

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.marked_yaml import Key
from waferbot_lockstep.parameters import did_you_mean
from waferbot_pmac.experiments.loading import COUNTS, LENGTH_UNITS, Experiment
from waferbot_pmac.user_units import Units


def check_units(experiment: Experiment, units: Units) -> None:
    """
    Check that the machine has the axes, and that every length is in the unit of its axis, or in counts.

    Raises `UserError` with file, line and key for what is not so.
    """
    for path, axis in _axes(experiment):
        if axis not in units:
            raise UserError(
                f'{experiment.document.where(path)}: the machine has no axis {axis}'
                f'{did_you_mean(axis, units)} (it has: {", ".join(units)})'
            )
    for path, axis, unit in _lengths(experiment):
        if unit not in (units[axis], COUNTS):
            raise UserError(
                f'{experiment.document.where(path)}: {axis} is measured in {units[axis]} or {COUNTS}'
            )


def suits(experiment: Experiment, units: Units) -> bool:
    """Tell whether the machine has the axes, with every length in their units, or in counts."""
    return all(axis in units for _, axis in _axes(experiment)) and all(
        unit in (units[axis], COUNTS) for _, axis, unit in _lengths(experiment)
    )


def _axes(experiment: Experiment) -> Iterator[tuple[Key, str]]:
    """Yield key and axis of every motion and target."""
    for axis in experiment.motion:
        yield ('motion', axis), axis
    if experiment.program:
        yield from ((path, axis) for path, axis, _ in _lengths(experiment))


def _lengths(experiment: Experiment) -> Iterator[tuple[Key, str, str]]:
    """Yield key, axis and unit of every position, distance, amplitude and speed."""
    for axis, motions in experiment.motion.items():
        for motion in motions:
            for key in motion.values:
                unit = _unit(key.removesuffix('_per_s'))
                if unit:
                    yield (*motion.path, key), axis, unit
    for place, statement in enumerate(experiment.program):
        for mode in ('linear', 'rapid'):
            for key in statement.get(mode, {}):
                unit = _unit(key)
                yield ('program', place, mode, key), key.removesuffix(f'_{unit}'), unit


def _unit(key: str) -> str:
    """Return the unit at the end of a key, '' if it is no length."""
    return next((unit for unit in LENGTH_UNITS if key.endswith(f'_{unit}')), '')
