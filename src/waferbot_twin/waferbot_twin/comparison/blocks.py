# SPDX-License-Identifier: Apache-2.0
"""
Each block of a model alone on a measured log: what it makes of what was measured at its inputs.

    block         driven by                                    compared
    plant         currents or forces; held to the positions    positions
    controller    commanded and measured positions             its output
    amplifier     commands, currents, positions                voltages of the lines
    windings      voltages, motion                             currents of the lines
    current loop  commands, motion                             currents

The blocks are those of the diagnosis (`residuals`). A plant that is only driven soon is nowhere near
the machine, so an observer holds it to the readings: its simulated position is the prediction of the
next reading, its residual the innovation.

An imported log has no lines, and its positions are no counts at the ticks of a PMAC. Where it tells
what a PMAC was given in every servo cycle, the counts are those at its samples, straight between them;
that is exact if all of them were logged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.comparison.log_time import beginning_s, when_read_s
from waferbot_twin.comparison.traces import Array, Trace, trace
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.metrics import rms
from waferbot_twin.residuals.controller_block import ControllerBlock, controller_block
from waferbot_twin.residuals.drive_block import (
    AmplifierBlock,
    CurrentLoopBlock,
    WindingsBlock,
    driven_currents,
)
from waferbot_twin.residuals.from_measured_log import with_short_pauses_of
from waferbot_twin.residuals.load import load_record
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import (
    AMPLIFIER,
    CONTROLLER,
    CURRENT_LOOP,
    PLANT,
    WINDINGS,
)
from waferbot_twin.residuals.record import Record, read_exactly
from waferbot_twin.response import driving_current

NODE_OF_BLOCK = {
    PLANT: 'plant',
    CONTROLLER: 'pmac',
    AMPLIFIER: 'copley',
    WINDINGS: 'copley',
    CURRENT_LOOP: 'copley',
}
"""The node whose part a block is; windings and current loop go with the drive."""

LINES = 2
"""Line currents that are measured of each motor."""

BEHIND = 0.25
"""Share of a cycle behind its beginning at which a held value is that of the cycle."""

ROUNDING = 1e-6
"""By how much of a row, or of a count, one that is whole may miss it."""

SAME_RATE = 1e-3
"""Relative difference of rates that is rounding."""


@dataclass(frozen=True)
class Replayed:
    """What the blocks of a model made of a log, and what a reader should know of it."""

    traces: tuple[Trace, ...]
    notes: tuple[str, ...]


def replay_blocks(path: Path, variant: Variant, node: str | None = None) -> Replayed:
    """
    Replay the blocks of a model that a measured log has the signals for; those of one node if given.

    `path` is an imported log or a recording with the contract's topics. Raises `UserError` if no block
    can be replayed.
    """
    record = load_record(path, variant)
    log, clock = None, None
    if record.is_imported:
        log, clock = with_short_pauses_of(load_log(path, machine=variant.machine_text), variant)
    wanted = [block for block in NODE_OF_BLOCK if node in (None, NODE_OF_BLOCK[block])]
    begin_s = 0.0 if log is None else beginning_s(record, log, variant)
    traces, notes = [], list(record.notes)
    if PLANT in wanted:
        traces += _shifted(_plant(record, variant), begin_s)
    if CONTROLLER in wanted and record.has_controller:
        traces += _shifted(_controller(record, variant), begin_s)
    if record.terminals is not None:
        for block in (AMPLIFIER, WINDINGS, CURRENT_LOOP):
            if block in wanted:
                traces += _drive(record, variant, block)
    elif log is not None and not places.described_axes(variant):
        found, why = _of_imported(log, variant, wanted)
        traces, notes = traces + found, notes + why
    if not traces:
        what = 'no block of the model' if node is None else f'no block of node {node}'
        raise UserError(
            f'{path}: {what} {variant.name} can be replayed: the log lacks its inputs or its output'
            + ''.join(f'; {note}' for note in notes)
        )
    if clock is not None:
        traces = [replace(one, time_s=clock.logged_s(one.time_s)) for one in traces]
    return Replayed(tuple(traces), tuple(dict.fromkeys(notes)))


def _shifted(traces: Iterable[Trace], begin_s: float) -> list[Trace]:
    """Return traces of a record with the times of the log that it is of."""
    return [replace(one, time_s=one.time_s + begin_s) for one in traces]


def _plant(record: Record, variant: Variant) -> list[Trace]:
    block = PlantBlock(record, variant)
    found = []
    for channel, left in zip(block.channels, block.innovations(variant), strict=True):
        encoder = variant.description.encoders[channel]
        unit = 'rad' if variant.description.revolute[encoder.coordinate] else 'm'
        measured = block.measured(channel) / encoder.counts_per_unit
        axis = record.layout.axis_of(channel)
        own = record.layout.encoders_of(axis)
        on_motor = len(own) > 1 and channel == own[-1]
        # A sample may be the mean of several readings: its time is the middle of theirs.
        row = block.times_s(channel) * record.timing.encoder_hz
        rows = np.floor(row + ROUNDING).astype(np.intp)
        read_s = when_read_s(record, variant, record.layout.encoder_place(channel), rows)
        found += trace(
            axis,
            'motor_position' if on_motor else 'position',
            unit,
            PLANT,
            read_s + (row - rows) / record.timing.encoder_hz,
            measured,
            measured - left / encoder.counts_per_unit,
        )
    return found


def _controller(record: Record, variant: Variant) -> list[Trace]:
    """Return the outputs of controllers: current commands of a PMAC, else in the law's own unit."""
    assert record.command is not None
    block = controller_block(record, variant)
    described = places.described_axes(variant)
    found = []
    for axis, left in zip(block.channels, block.residuals(variant), strict=True):
        time_s = block.times_s(axis)
        cycles = np.round(time_s * record.timing.servo_hz).astype(np.intp)
        factor, unit, kind = 1.0, 'A', 'current_command'
        if axis in described:
            output = variant.description.controllers[axis].output
            factor = 1.0 / places.amperes_per_output(variant, axis)
            unit, kind = {'share': '1'}.get(output, output), 'controller_output'
        measured = record.command[cycles, record.layout.place(axis)] * factor
        found += trace(axis, kind, unit, CONTROLLER, time_s, measured, measured - left * factor)
    return found


_DRIVES: dict[str, Callable[[Record, Variant], AmplifierBlock | WindingsBlock | CurrentLoopBlock]]
_DRIVES = {AMPLIFIER: AmplifierBlock, WINDINGS: WindingsBlock, CURRENT_LOOP: CurrentLoopBlock}


def _drive(record: Record, variant: Variant, name: str) -> list[Trace]:
    """Return voltages or currents of lines 1 and 2, means over servo cycles."""
    terminals = record.terminals
    assert terminals is not None
    has_voltage = terminals.voltage is not None
    if has_voltage == (name == CURRENT_LOOP) or (name != WINDINGS and record.command is None):
        return []
    block = _DRIVES[name](record, variant)
    of_voltage = name == AMPLIFIER
    values = terminals.current
    if of_voltage and terminals.voltage is not None:
        by_axis = terminals.voltage.reshape(record.ticks, len(record.layout.axes), -1)
        against_mean = (by_axis - by_axis.mean(axis=2, keepdims=True))[:, :, :LINES]
        values = against_mean.reshape(record.ticks, -1)
    means = _cycle_means(values, record.timing)
    found = []
    for channel, left in zip(block.channels, block.residuals(variant), strict=True):
        axis, line = channel.split(' line ')
        time_s = block.times_s(channel)
        cycles = np.floor(time_s * record.timing.servo_hz).astype(np.intp)
        measured = means[cycles, LINES * record.layout.place(axis) + int(line) - 1]
        kind = f'{"voltage" if of_voltage else "current"}_line_{line}'
        unit = 'V' if of_voltage else 'A'
        found += trace(axis, kind, unit, name, time_s, measured, measured - left)
    return found


def _cycle_means(values: Array, timing: Timing) -> Array:
    """Return the means (cycles, k) over servo cycles of values (ticks, k)."""
    cycles = len(values) // timing.servo_divider
    whole = values[: cycles * timing.servo_divider]
    return np.asarray(whole.reshape(cycles, timing.servo_divider, -1).mean(axis=1))


def _of_imported(
    log: MeasuredLog, variant: Variant, wanted: Iterable[str]
) -> tuple[list[Trace], list[str]]:
    """Return what PMAC and Copley make of an imported log, and why not where they cannot."""
    timing = Timing()
    axes, notes = [], []
    for axis in places.controlled_axes(variant):
        if not variant.pmac.get(axis) or log.get(axis, 'position') is None:
            continue
        lacking = [
            kind for kind in ('commanded_position', 'current_command') if not log.get(axis, kind)
        ]
        if lacking:
            notes.append(
                f'{log.name}: without {" and ".join(lacking)} of {axis}, PMAC and Copley of that axis '
                'are not replayed'
            )
        elif abs(log[axis, 'current_command'].rate_hz / timing.servo_hz - 1.0) > SAME_RATE:
            rate_hz = log[axis, 'current_command'].rate_hz
            notes.append(
                f'{log.name}: {axis} was logged at {rate_hz:.6g} Hz; its PMAC and Copley are replayed '
                f'only if every servo cycle was, {timing.servo_hz:.6g} Hz'
            )
        else:
            axes.append(axis)
    if not axes:
        return [], notes
    found: list[Trace] = []
    best = None
    for late in (True, False):
        record, begin_s = _cycles_of(log, variant, axes, timing, late)
        block = ControllerBlock(record, variant)
        left = block.residuals(variant)
        size = sum(rms(one) for one in left)
        if best is None or size < best[0]:
            best = (size, record, begin_s)
    assert best is not None
    _, record, begin_s = best
    if CONTROLLER in wanted:
        found += _shifted(_controller(record, variant), begin_s)
    if CURRENT_LOOP in wanted:
        found += _shifted(_currents(record, variant, log, begin_s), begin_s)
    return found, notes


def _cycles_of(
    log: MeasuredLog, variant: Variant, axes: list[str], timing: Timing, late: bool
) -> tuple[Record, float]:
    """
    Return what PMACs were given in each servo cycle and put out, and the time of the first cycle, s.

    Of the stretch in which all of it is known. `late`: positions stand in the log when the axis was
    there, and were seen a phase cycle later; else when they were seen.
    """
    kinds = ('commanded_position', 'current_command', 'position')
    signals = {(axis, kind): log[axis, kind] for axis in axes for kind in kinds}
    begin_s = float(max(log[axis, 'commanded_position'].time_s[0] for axis in axes))
    end_s = float(min(signal.time_s[-1] for signal in signals.values()))
    cycles = max(0, int((end_s - begin_s) * timing.servo_hz))
    cycle_s = np.asarray(begin_s + (np.arange(cycles) + BEHIND) / timing.servo_hz, np.float64)
    servo = servo_parameters(variant.pmac, variant.name, variant.layout)[0]
    layout = variant.layout
    commanded = np.zeros((cycles, len(layout.axes)))
    command = np.full(commanded.shape, np.nan)
    rows = cycles * timing.servo_divider // timing.encoder_divider
    row_s = timing.encoder_divider * timing.tick_s
    read_s = begin_s + np.arange(rows) * row_s - (row_s if late else 0.0)
    reading = np.full((rows, len(layout.encoders)), np.nan)
    whole = np.ones(cycles, bool)
    for axis in axes:
        place = layout.place(axis)
        per_unit = float(servo['counts_per_unit'][place])
        path, known = log[axis, 'commanded_position'].at(cycle_s)
        output, also = log[axis, 'current_command'].at(cycle_s)
        whole &= known & also
        commanded[:, place], command[:, place] = np.nan_to_num(path) * per_unit, output
        encoders = {'position': (int(servo['Ixx03'][place]), per_unit)}
        second = int(servo['Ixx04'][place])
        if second not in (place, encoders['position'][0]):
            own = variant.description.encoders[layout.encoders[second]]
            encoders['motor_position'] = (second, own.counts_per_unit)
        for kind, (encoder, counts) in encoders.items():
            signal = log.get(axis, kind)
            if signal is None:
                command[:, place] = np.nan  # what it differentiates is not known
                continue
            value = np.interp(read_s, signal.time_s, signal.value)
            # Readings are whole counts but for rounding; between them the encoder rounds down.
            reading[:, encoder] = np.floor(value * counts + ROUNDING)
    ends = np.flatnonzero(~whole)
    cycles = int(ends[0]) if len(ends) else cycles
    ticks = cycles * timing.servo_divider
    rows = ticks // timing.encoder_divider
    record = Record(
        log.name,
        timing,
        np.full((ticks, LINES * len(layout.axes)), np.nan),
        reading[:rows],
        commanded[:cycles],
        command[:cycles],
        **{**read_exactly(layout), 'controlled': tuple(axes)},
    )
    return record, begin_s


def _currents(record: Record, variant: Variant, log: MeasuredLog, begin_s: float) -> list[Trace]:
    """Return the currents that amplifiers and windings make of the commands."""
    if record.ticks == 0:
        return []
    timing = record.timing
    settings = amplifier_parameters(variant.copley, timing, variant.name, variant.layout)[0]
    lines = driven_currents(record, variant)
    ticks = np.arange(record.ticks)
    encoder_ticks = np.arange(len(record.reading)) * timing.encoder_divider
    middle_s = (np.arange(record.ticks // timing.servo_divider) + 0.5) / timing.servo_hz
    found = []
    for place, axis in enumerate(record.layout.axes):
        measured = log.get(axis, 'current')
        if measured is None or not np.isfinite(lines[:, LINES * place]).all():
            continue
        encoders = (encoder_ticks, np.nan_to_num(record.reading))
        driving = driving_current(ticks, lines, place, settings, encoders)
        means = _cycle_means(driving[:, None], timing)[:, 0]
        time_s = measured.time_s - begin_s
        simulated = np.interp(time_s, middle_s, means, left=np.nan, right=np.nan)
        found += trace(axis, 'current', 'A', CURRENT_LOOP, time_s, measured.value, simulated)
    return found
