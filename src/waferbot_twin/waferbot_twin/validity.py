# SPDX-License-Identifier: Apache-2.0
"""
Where a run leaves the range in which its model holds: the plant's parts, and the currents.

What the plant's parts bear is watched as `waferbot_plant.validity` says. Of each axis' current:

| amount | range |
|---|---|
| current command, A, peak of sine | below what the controller can command, Ixx69, and the drive's peak |
| I2T accumulator, A2 s, (3.3) | below its set point (3.2), where only the continuous current is left |

Every engine makes the same of the same messages. What came of it is in the recording's metadata, as
`KEY`, and is read from there.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from waferbot_lockstep.timing import Timing
from waferbot_plant.loads import Loads, fields
from waferbot_plant.plant import Machine, load_machine
from waferbot_plant.validity import Check, Extremes, Watch
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.checked_json import NUMBER, TEXT, checked_json
from waferbot_twin.models import Model
from waferbot_twin.recording.reader import recording_file

KEY = 'validity'
"""Name of what came of the checks in a recording's metadata."""

OUTSIDE = 'outside of the range of the model'
"""What a departure is called in what is printed."""

DAC_RANGE = 32768.0

_TOLD = {
    'type': 'array',
    'items': {
        'type': 'object',
        'required': [
            *('place', 'what', 'unit', 'limits', 'worst', 'worst_s', 'first_s', 'outside', 'text')
        ],
        'properties': {
            **dict.fromkeys(('place', 'what', 'unit', 'limits', 'text'), TEXT),
            **dict.fromkeys(('worst', 'worst_s'), NUMBER),
            'first_s': {'type': ['number', 'null']},
            'outside': {'type': 'boolean'},
        },
    },
}


class Validity:
    """Keeps the extremes of all that is watched in a run of a model."""

    def __init__(self, model: Model, timing: Timing, machine: Machine | None = None) -> None:
        """Find what can be watched; `machine` is the model's, if it is loaded already."""
        self._timing = timing
        machine = machine or _machine_of(model, timing)
        self._watch = Watch(machine)
        self._axes = machine.layout.axes
        servo = servo_parameters(model.of_axes('pmac'), str(model.path), machine.layout)[0]
        copley = model.of_axes('copley')
        self._commands = []
        for place, axis in enumerate(self._axes):
            limit = (
                float(servo['Ixx69'][place] * servo['amplifier_peak_current'][place]) / DAC_RANGE
            )
            limit = min(limit, float(copley[axis].get('peak_current', np.inf)))
            self._commands.append(
                Extremes(
                    Check(
                        axis,
                        'current command',
                        'A',
                        -np.inf,
                        float(np.nextafter(limit, 0.0)),  # one that stands at the limit is limited
                        'the command is limited, the loop is open there',
                    )
                )
            )
        self._i2t: list[Extremes | None] = [None] * len(self._axes)

    def note_loads(self, loads: Loads) -> None:
        """Take in what the plant tells of its parts."""
        self._watch.note(loads)

    def note_commands(self, tick: np.ndarray, current: np.ndarray) -> None:
        """Take in current commands (n, axes), A, at ticks (n,)."""
        magnitude = np.abs(current)
        for place, extremes in enumerate(self._commands):
            extremes.note(tick, magnitude[:, place], magnitude[:, place])

    def note_command(self, tick: int, valid: int, current: Sequence[float]) -> None:
        """Take in one command (axes,), of the axes in `valid`; cheap where it is nothing new."""
        for place, extremes in enumerate(self._commands):
            value = abs(current[place])
            if valid >> place & 1 and (value > extremes.high or value < extremes.low):
                extremes.note(np.array([tick]), np.array([value]), np.array([value]))

    def note_amplifiers(
        self, tick: np.ndarray, valid: np.ndarray, accumulator: np.ndarray, setpoint: np.ndarray
    ) -> None:
        """Take in I2T accumulators and set points (n, axes), A2 s, of the axes in `valid` (n,)."""
        for place, axis in enumerate(self._axes):
            own = np.flatnonzero(np.asarray(valid) >> place & 1)
            if len(own) == 0:
                continue
            found = self._i2t[place]
            if found is None:
                limit = float(setpoint[own[0], place])
                found = self._i2t[place] = Extremes(
                    Check(
                        axis,
                        'I2T accumulator',
                        'A2 s',
                        -np.inf,
                        float(np.nextafter(limit, 0.0)),
                        'the drive limits the current to the continuous one',
                    )
                )
            values = accumulator[own, place]
            found.note(np.asarray(tick)[own], values, values)

    def extremes(self) -> list[Extremes]:
        """Return what came of every check that anything was noted for."""
        own = [found for found in (*self._commands, *self._i2t) if found is not None]
        return self._watch.extremes() + [found for found in own if found.low_tick >= 0]

    def departures(self) -> tuple[str, ...]:
        """Return, as one line each, what left its range: place, amount, times."""
        return tuple(found.text(self._timing) for found in self.extremes() if found.outside)

    def after(self, failure: str) -> str:
        """Return why a run failed, with what had left its range before, '' if it did not fail."""
        left = ', '.join(found.amount_text() for found in self.extremes() if found.outside)
        return f'{failure}; {OUTSIDE}: {left}' if failure and left else failure

    def told(self) -> dict[str, str]:
        """Return what goes into the metadata of a recording."""
        return {KEY: json.dumps([told(found, self._timing) for found in self.extremes()])}


def _machine_of(model: Model, timing: Timing) -> Machine:
    plant = model.parameters['plant']
    return load_machine(model.description, damping=plant.get('damping', 'improved'), timing=timing)


def told(found: Extremes, timing: Timing) -> dict[str, Any]:
    """Return a check's extremes as plain values; within range `text` is empty, `first_s` None."""
    worst, tick = found.worst
    return {
        'place': found.check.place,
        'what': found.check.what,
        'unit': found.check.unit,
        'limits': found.check.limits,
        'worst': worst,
        'worst_s': timing.seconds(tick),
        'first_s': timing.seconds(found.first_tick) if found.outside else None,
        'outside': found.outside,
        'text': found.text(timing) if found.outside else '',
    }


def recorded_validity(path: Path) -> list[dict[str, Any]]:
    """
    Return what the metadata of a recording, folder or file, tell of its checks, as `told` gives it.

    Empty where it tells nothing: a log that was imported, a recording that was cut off or is older.
    Raises `UserError` for metadata that are damaged.
    """
    file = recording_file(path)
    try:
        with file.open('rb') as stream:
            summaries = [
                dict(record.metadata)
                for record in make_reader(stream).iter_metadata()
                if record.name == 'waferbot'
            ]
    except (McapError, OSError, ValueError):
        return []
    text = summaries[0].get(KEY, '[]') if summaries else '[]'
    found: list[dict[str, Any]] = checked_json(text, _TOLD, f'{file}: {KEY}')
    return found


def loads_of(tick: int, values: Sequence[float]) -> Loads:
    """Return the loads of one message."""
    return Loads(np.array([tick]), *fields(np.array([values]))[:5])
