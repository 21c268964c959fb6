# SPDX-License-Identifier: Apache-2.0
"""Reads a recording of the twin, or an imported log, as responses of its axes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    SERVO_STATE,
    Topic,
)
from waferbot_lockstep.errors import UserError
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.logs.archive import ATTACHMENT
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.models import recorded_model
from waferbot_twin.recording.reader import (
    Progress,
    Recording,
    header_of,
    merge_by_tick,
    stream_recording,
)
from waferbot_twin.response import AxisResponse, driving_current, responses_of
from waferbot_twin.thinning import Thinned

MOST_CURRENTS = 1 << 17
"""Samples of each current that are kept: 7 s of a recording are kept whole."""


def load_responses(
    path: Path,
    progress: Progress | None = None,
    take_plant_state: Callable[[np.ndarray], None] | None = None,
) -> list[AxisResponse]:
    """
    Return the axes of a recording or of an imported log.

    Of a recording also what the plant told of itself, some messages at a time, to `take_plant_state`.

    A recording is read piece by piece, and of the currents only `MOST_CURRENTS` samples are kept, the
    least and the greatest of each stretch: five minutes take half a gigabyte. Raises `UserError`.
    """
    header = header_of(path)
    if ATTACHMENT in header.attachments:
        return log_responses(load_log(path))
    if 'model.yaml' not in header.attachments:
        raise UserError(
            f'{path} does not hold the model that it was made with, so its units are not known; if it '
            f'was measured, bring it in first: waferbot import {path} --model M --out DIR'
        )
    gathered = _Gathered(header, MOST_CURRENTS)
    return gathered.responses(stream_recording(path, gathered.take, progress, take_plant_state))


def axis_responses(recording: Recording) -> list[AxisResponse]:
    """Return the axes of a recording that was read whole; raises `UserError` if a topic is missing."""
    gathered = _Gathered(recording, sys.maxsize)
    for topic in (*_Gathered.FIELDS, PHASE_CURRENTS):
        gathered.take(topic, recording[topic])
    return gathered.responses(recording)


class _Gathered:
    """What the axes' responses need of a recording that is read piece by piece."""

    FIELDS: ClassVar[Mapping[Topic, tuple[str, ...]]] = {
        ENCODERS_TOPIC: ('counts',),
        SERVO_STATE: ('commanded_position', 'following_error'),
        CURRENT_COMMAND: ('current',),
    }

    def __init__(self, header: Recording, most_currents: int) -> None:
        """Begin with what is known before the first message."""
        model, where = recorded_model(header), str(header.path)
        self._timing = header.timing
        self._units = model.axis_units
        layout = model.layout
        self._servo = servo_parameters(model.of_axes('pmac'), where, layout)[0]
        self._amplifier = amplifier_parameters(
            model.of_axes('copley'), self._timing, where, layout
        )[0]
        self._parts: dict[Topic, list[np.ndarray]] = {topic: [] for topic in self.FIELDS}
        self._currents = [Thinned(most_currents) for _ in layout.axes]
        self._waiting: list[np.ndarray] = []
        self._seen: list[np.ndarray] = []

    def take(self, topic: Topic, records: np.ndarray) -> None:
        """Take what is needed of the next messages of a topic."""
        if len(records) == 0:
            return
        if topic in self._parts:
            names = ['tick', 'valid', *self.FIELDS[topic]]
            kinds = [(name, records.dtype[name]) for name in names]
            part = np.zeros(len(records), kinds)
            for name in names:
                part[name] = records[name]
            self._parts[topic].append(part)
            if topic is ENCODERS_TOPIC:
                self._seen.append(part)
                self._take_currents()
        elif topic is PHASE_CURRENTS:
            self._waiting.append(records)

    def _take_currents(self, at_end: bool = False) -> None:
        """Thin out the currents at whose ticks it is known what the encoders read."""
        newest = int(self._seen[-1]['tick'][-1]) if self._seen else -1
        while self._waiting and (at_end or int(self._waiting[0]['tick'][-1]) <= newest):
            records = self._waiting.pop(0)
            # What was read when these currents flowed, and all that comes later.
            while len(self._seen) > 1 and self._seen[1]['tick'][0] <= records['tick'][0]:
                self._seen.pop(0)
            if not self._seen:
                continue
            seen = np.concatenate(self._seen)
            for axis, thinned in enumerate(self._currents):
                own = records[(records['valid'] >> axis & 1).astype(bool)]
                current = driving_current(
                    own['tick'],
                    own['current'],
                    axis,
                    self._amplifier,
                    (seen['tick'], seen['counts']),
                )
                thinned.add(own['tick'] / self._timing.current_loop_hz, current)

    def responses(self, recording: Recording) -> list[AxisResponse]:
        """Return the axes at the end; raises `UserError` if a topic is missing."""
        self._take_currents(at_end=True)
        for topic in (*self.FIELDS, PHASE_CURRENTS):
            recording[topic]  # raises if it was not recorded
        tables = {}
        for topic in self.FIELDS:
            parts = self._parts.pop(topic) or [recording[topic]]
            tables[topic] = merge_by_tick(np.concatenate(parts), topic)
        state, command = tables[SERVO_STATE], tables[CURRENT_COMMAND]
        return responses_of(
            self._timing,
            self._units,
            self._servo,
            (tables[ENCODERS_TOPIC]['tick'], tables[ENCODERS_TOPIC]['counts']),
            (state['tick'], state['commanded_position'], state['following_error']),
            (command['tick'], command['current']),
            [thinned.samples() for thinned in self._currents],
        )


def log_responses(log: MeasuredLog) -> list[AxisResponse]:
    """
    Return the axes of an imported log of which there is a position.

    A following error that was not logged is commanded minus actual position at the times of the
    latter, where both are known.
    """
    nothing = np.zeros(0)
    responses = []
    for axis in log.axes():
        position = log.get(axis, 'position')
        if position is None:
            continue
        commanded, error, command, current = (
            (nothing, nothing) if signal is None else (signal.time_s, signal.value)
            for signal in (
                log.get(axis, kind)
                for kind in ('commanded_position', 'following_error', 'current_command', 'current')
            )
        )
        told = log.get(axis, 'commanded_position')
        if len(error[0]) == 0 and told is not None:
            wanted, known = told.at(position.time_s)
            error = (position.time_s[known], (wanted - position.value)[known])
        responses.append(
            AxisResponse(
                axis, position.unit, position.time_s, position.value, *commanded, error[1],
                *command, *current, error_time=error[0],
            )
        )  # fmt: skip
    return responses
