# SPDX-License-Identifier: Apache-2.0
"""Records from what was logged: recordings with the contract's topics, and runs of the twin itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.contract import (
    CURRENT_COMMAND,
    ENCODERS_TOPIC,
    PHASE_CURRENTS,
    PHASE_VOLTAGES,
    SERVO_STATE,
)
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.commutation import electrical_angle
from waferbot_twin.effects.variant import Variant
from waferbot_twin.engines.inprocess import Signals
from waferbot_twin.recording.reader import Recording, read_recording
from waferbot_twin.residuals.drive_block import driven_currents
from waferbot_twin.residuals.record import Array, Record, Terminals, mean_over_ticks, read_exactly


def record_of_signals(name: str, signals: Signals) -> Record:
    """Return what an in-process run would have logged."""
    return Record(
        name,
        signals.timing,
        mean_over_ticks(signals.line_current),
        signals.counts.astype(float),
        np.ascontiguousarray(signals.servo_state[:, : len(signals.layout.axes)]),
        signals.current_command.copy(),
        terminals=Terminals(
            signals.line_current.copy(), signals.voltage.copy(), signals.open_bridges.copy()
        ),
        **read_exactly(signals.layout),
    )


def record_of_recording(path: Path, variant: Variant) -> Record:
    """
    Return the record of a recording that has encoders and currents (or current commands).

    Where currents were not recorded they are those that the model's amplifiers and windings make of the
    commands. Raises `UserError` if commands lack too, or if ticks are missing.
    """
    return record_of(read_recording(path), path, variant)


def record_of(recording: Recording, path: Path, variant: Variant) -> Record:
    """Return the record of a recording that was read from `path`; raises as above."""
    recording.check_machine(variant.layout)
    timing = recording.timing
    encoders = _whole(recording, ENCODERS_TOPIC.name, timing.encoder_divider)
    ticks = len(encoders) * timing.encoder_divider
    command = commanded = terminals = None
    if CURRENT_COMMAND.name in recording.topics:
        command = np.array(
            _whole(recording, CURRENT_COMMAND.name, timing.servo_divider)['current'], float
        )
    if SERVO_STATE.name in recording.topics:
        state = _whole(recording, SERVO_STATE.name, timing.servo_divider)
        commanded = np.array(state['commanded_position'], float)
    if PHASE_CURRENTS.name in recording.topics:
        currents = _whole(recording, PHASE_CURRENTS.name, 1)
        terminals = _terminals(recording, np.array(currents['current'], float))
        line_current = mean_over_ticks(terminals.current)
    elif command is not None:
        line_current = _as_commanded(command, encoders, variant, timing, ticks)
    else:
        raise UserError(f'{path}: neither phase_currents nor current_command was recorded')
    ticks = min(ticks, len(line_current))
    cycles = ticks // timing.servo_divider
    ticks = cycles * timing.servo_divider
    record = Record(
        path.name,
        timing,
        line_current[:ticks],
        np.array(encoders['counts'][: ticks // timing.encoder_divider], float),
        None if commanded is None else np.ascontiguousarray(commanded[:cycles]),
        None if command is None else np.ascontiguousarray(command[:cycles]),
        terminals=None if terminals is None else terminals.part(slice(ticks)),
        **read_exactly(variant.layout),
    )
    if terminals is not None or not variant.copley:
        return record
    return replace(record, line_current=driven_currents(record, variant))


def _terminals(recording: Recording, current: Array) -> Terminals:
    """
    Return what was measured at the amplifiers.

    Voltages that end before the currents are left out; without them the bridges are taken to be on.
    """
    ticks = len(current)
    voltage, off = None, np.zeros(ticks, np.uint8)
    if PHASE_VOLTAGES.name in recording.topics:
        messages = _whole(recording, PHASE_VOLTAGES.name, 1)[:ticks]
        if len(messages) == ticks:
            voltage, off = np.array(messages['voltage'], float), np.array(messages['open'])
    return Terminals(current, voltage, off)


def _whole(recording: Recording, name: str, spacing: int) -> np.ndarray:
    """Return a topic from tick 0 up to its first gap; raises `UserError` if it begins later."""
    array = recording[name]
    if len(array) == 0 or array['tick'][0] != 0:
        raise UserError(f'{recording.path}: topic {name} does not begin at tick 0')
    gaps = np.flatnonzero(np.diff(array['tick'].astype(np.int64)) != spacing)
    return array[: int(gaps[0]) + 1] if len(gaps) else array


def _as_commanded(
    command: Array, encoders: np.ndarray, variant: Variant, timing: Timing, ticks: int
) -> Array:
    """Return the line currents of amplifiers that do at once what they are told."""
    amplifier = amplifier_parameters(variant.copley, timing, variant.name, variant.layout)[0]
    every = np.arange(ticks)
    held = command[np.minimum(every // timing.servo_divider, len(command) - 1)]
    axes = len(variant.layout.axes)
    lines = np.zeros((ticks, 2 * axes))
    for axis in range(axes):
        theta = electrical_angle(every, axis, amplifier, (encoders['tick'], encoders['counts']))
        for line in range(2):
            lines[:, 2 * axis + line] = held[:, axis] * np.sin(theta - 2.0 * np.pi * line / 3.0)
    return lines
