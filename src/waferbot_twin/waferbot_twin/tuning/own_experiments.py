# SPDX-License-Identifier: Apache-2.0
"""
The shipped experiments for the axes of another machine.

Each axis gets those of the axis of the shipped machine that has its unit (`usual_axis`), in m or rad
where they are in counts, within its stroke; and two move all axes at once. They are files to be changed:
what a machine can bear nobody knows from its description.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from waferbot_lockstep.contract import usual_axis
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED as SHIPPED_LAYOUT
from waferbot_lockstep.marked_yaml import SAFE_DUMPER
from waferbot_pmac.experiments import load_experiment
from waferbot_pmac.experiments.loading import COUNTS
from waferbot_pmac.i_variables import servo_parameters
from waferbot_pmac.user_units import Units
from waferbot_twin.models import SHIPPED, load_model

OF_AN_AXIS = {
    'step': 'Two steps of the position of this axis alone, up and, after it has settled, down again.',
    'full_stroke': 'The whole stroke as fast as the limits of the axis allow, and back.',
    'slow_velocity': 'There and back at a low constant speed, for friction, cogging and backlash.',
    'multisine': 'All frequencies of a band at once while the axis glides, for a frequency response.',
    'random': 'A random position every 20 ms.',
    'swept_sine': 'One frequency after another, for a frequency response.',
}
"""The shipped experiments of one axis by what stands before its name."""

STEPS, STROKES = 'step', 'full_strokes'
"""All axes at once: steps, and the whole strokes."""

STEPS_S, DIGITS = 0.5, 9


def own_experiments(units: Units, strokes: Mapping[str, float]) -> dict[str, str]:
    """
    Return experiments of a machine, their YAML by their name.

    `units` are those of its axes, `strokes` the longest ways, m or rad, of those that are not moved as
    far as the axis of the shipped machine. Raises `UserError` for one of an axis that is not there.
    """
    for axis, stroke in strokes.items():
        if axis not in units:
            raise UserError(
                f'--stroke {axis}: the machine has no such axis; it has {", ".join(units)}'
            )
        if not (math.isfinite(stroke) and stroke != 0.0):
            raise UserError(f'--stroke {axis}={stroke:g}: give how far it may go, m or rad')
    counts = _counts_per_unit()
    found: dict[str, str] = {}
    motions: dict[str, Any] = {}
    there: dict[str, float] = {}
    durations: list[float] = []
    for axis, unit in units.items():
        alike = usual_axis(axis, unit)
        stroke = strokes.get(axis, math.inf)
        for prefix, description in OF_AN_AXIS.items():
            shipped = load_experiment(f'{prefix}_{alike}')
            data = _of_axis(
                shipped.document.data, alike, axis, unit, counts[alike], stroke, prefix
            )
            name = f'{prefix}_{axis}'
            found[name] = _text(data, name, description)
            if prefix == STEPS:
                motions[axis] = {
                    'kind': 'step',
                    'start_s': data['motion'][axis]['start_s'],
                    f'amplitude_{unit}': data['motion'][axis][f'amplitude_{unit}'],
                }
            if prefix == 'full_stroke':
                there |= data['program'][1]['linear']
                durations.append(data['duration_s'])
    found[STEPS] = _text(
        {'duration_s': STEPS_S, 'motion': motions}, STEPS, 'Steps of all axes at once.'
    )
    smooth = {'acceleration_time_s': 0.1, 's_curve_time_s': 0.02}
    program = [
        {'dwell_s': 0.02},
        {'linear': there, **smooth},
        {'dwell_s': 0.2},
        {'linear': dict.fromkeys(there, 0), **smooth},
    ]
    found[STROKES] = _text(
        {'duration_s': max(durations), 'program': program},
        STROKES,
        'All axes at once over their whole strokes, and back.',
    )
    return found


def _counts_per_unit() -> dict[str, float]:
    """Return the counts per m or rad of the axes of the shipped machine, by which its steps are."""
    settings = servo_parameters(load_model(SHIPPED).of_axes('pmac'), SHIPPED)[0]
    return {
        axis: float(settings['counts_per_unit'][SHIPPED_LAYOUT.place(axis)])
        for axis in SHIPPED_LAYOUT.axes
    }


def _of_axis(
    data: Mapping[str, Any],
    alike: str,
    axis: str,
    unit: str,
    counts: float,
    stroke: float,
    prefix: str,
) -> dict[str, Any]:
    """Return an experiment of `alike` as one of another axis; lengths within `stroke`."""
    ways = [
        abs(value) * (1.0 / counts if key.endswith(f'_{COUNTS}') else 1.0)
        for key, value in _numbers(data)
        if key.startswith(('distance_', f'{alike}_'))
    ]
    longest = max(ways, default=0.0)
    within = stroke / longest if longest and abs(stroke) < longest else 1.0
    if prefix == 'full_stroke' and math.isfinite(stroke):
        within = stroke / longest

    def changed(key: str, value: Any) -> tuple[str, Any]:
        if key == alike:
            return axis, value
        name = key
        if key.endswith((f'_{COUNTS}', f'_{COUNTS}_per_s')):
            name = key.replace(f'_{COUNTS}', f'_{unit}')
            value = value / counts
        if name.startswith(f'{alike}_'):
            name = axis + name.removeprefix(alike)
        if key.startswith(('distance_', f'{alike}_')):
            value = value * within
        return name, float(f'{value:.{DIGITS}g}') if isinstance(value, float) else value

    kept = {key: data[key] for key in ('duration_s', 'motion', 'program') if key in data}
    return dict(_everywhere(kept, changed))


def _numbers(node: Any) -> list[tuple[str, float]]:
    """Return all numbers of a document with their keys."""
    if isinstance(node, Mapping):
        own = [
            (key, float(value)) for key, value in node.items() if isinstance(value, int | float)
        ]
        return own + [one for value in node.values() for one in _numbers(value)]
    return [one for value in node for one in _numbers(value)] if isinstance(node, list) else []


def _everywhere(node: Any, changed: Callable[[str, Any], tuple[str, Any]]) -> Any:
    """Return a document in which every key and number is what `changed` makes of it."""
    if isinstance(node, Mapping):
        return dict(
            changed(
                key, _everywhere(value, changed) if isinstance(value, Mapping | list) else value
            )
            for key, value in node.items()
        )
    return [_everywhere(one, changed) for one in node]


def _text(data: Mapping[str, Any], name: str, description: str) -> str:
    """Return an experiment as YAML, and see that it is one."""
    whole = {'name': name, 'description': description, **data}
    text = yaml.dump(whole, Dumper=SAFE_DUMPER, sort_keys=False, width=100)
    load_experiment(text)
    return text
