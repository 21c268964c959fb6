# SPDX-License-Identifier: Apache-2.0
"""
Records from measured logs: what `waferbot import` wrote, text and arrays, recordings of joint states.

Nothing is resampled that was measured as a position: every reading stands in the row of the ticks that
is nearest to its time, with the rest of its time beside it (`Record.late_s`), and the rows between are
empty. What drives an axis is needed at every tick, and is taken there as `Signal.at` gives it: commands
held, everything else straight from sample to sample. Where the drive is not known, in a gap or outside
of its log, readings are left out.

What drives an axis is, the first that the log has of

    current            A, the part that makes force
    force (torque)     N, Nm at the axis: F / (k r), with the nominal force per ampere k and the ratio
                       r of the transmission. A drive's force is nearly always its own estimate from
                       its current; one that was measured acts on the model in this way just as well.
    current command    A, as if the amplifier did at once what it is told
    drive command      share of the amplifier's peak current, likewise
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.alignment import SAME_CLOCK, Skew, clock_ratio, common_skew
from waferbot_twin.logs.kinds import DRIVES
from waferbot_twin.logs.machine import MOTOR_ENCODER, POSITION_ENCODER
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.residuals.plant_block import OBSERVER_HZ, PlantBlock
from waferbot_twin.residuals.record import Array, Record

TICKS_PER_READING = 8
LEAST_TICKS_HZ = 2000.0
"""Ticks of a machine alone: for each reading, and in a second at least."""

UNKNOWN_RESOLUTION = 1e-6
"""Share of its path that a position is taken to be resolved to if the log does not show its steps."""

LENGTH = {'m': 'slides', 'rad': 'turns'}
"""What an axis does whose position has this unit."""


def drive_of(log: MeasuredLog, axis: str) -> Signal | None:
    """Return what tells best what drives an axis, None if nothing does."""
    return next((found for kind in DRIVES if (found := log.get(axis, kind))), None)


def amperes_per_unit(variant: Variant, drive: Signal) -> float:
    """Return the motor current (A) per unit of what drives an axis; raises `UserError`."""
    if drive.kind == 'force':
        return 1.0 / places.force_per_ampere(variant, drive.axis)
    if drive.kind == 'drive_command':
        if not variant.copley.get(drive.axis):
            raise UserError(
                f'{drive.name} is a share of the peak current of an amplifier that the model '
                f'{variant.name} does not have; map it as current_command, with its scale in A'
            )
        return places.peak_current(variant, drive.axis)
    return 1.0


def driven_axes(log: MeasuredLog, variant: Variant) -> tuple[str, ...]:
    """
    Return the axes that log and model have, with position and drive.

    Raises `UserError` if there is none, or if one slides in the log and turns in the model.
    """
    usable = log.usable_axes()
    axes = tuple(axis for axis in places.motor_axes(variant) if axis in usable)
    if not axes:
        raise UserError(
            f'{log.name} has position and drive of {", ".join(usable) or "no axis"}, the model '
            f'{variant.name} has motors on {", ".join(places.motor_axes(variant)) or "no axis"}: '
            'name the axis in the mapping as the description does'
        )
    for axis in axes:
        unit, wanted = log[axis, 'position'].unit, places.length_unit(variant, axis)
        if unit != wanted:
            raise UserError(
                f'{log.name}: {axis} {LENGTH[unit]} (its position is in {unit}), in the model '
                f'{variant.name} it {LENGTH[wanted]}; give the right --model, or name that '
                "machine in the log's mapping"
            )
    return axes


def record_of_measured_log(
    log: MeasuredLog, variant: Variant, late_s: Mapping[str, float] | None = None
) -> Record:
    """
    Return the record of a measured log.

    `late_s` says of each axis how much later than the position its drive stands in the log (s); it is
    moved by that. Ticks begin at the first time at which something is known. Raises `UserError` if log
    and model have no axis in common, or never both signals at once.
    """
    axes = driven_axes(log, variant)
    timing = _timing(log, axes, variant)
    shift_s = {axis: (late_s or {}).get(axis, 0.0) for axis in axes}
    drives = {axis: found for axis in axes if (found := drive_of(log, axis))}
    spans = {
        axis: (
            max(log[axis, 'position'].time_s[0], drive.time_s[0] - shift_s[axis]),
            min(log[axis, 'position'].time_s[-1], drive.time_s[-1] - shift_s[axis]),
        )
        for axis, drive in drives.items()
    }
    begin_s = min(begin for begin, _ in spans.values())
    end_s = max(end for _, end in spans.values())
    cycles = int((end_s - begin_s) * timing.servo_hz)
    if cycles < 1:
        raise UserError(
            f'{log.name}: position and drive of {", ".join(axes)} are never known at once'
        )
    ticks = cycles * timing.servo_divider
    middle_s = begin_s + (np.arange(ticks) + 0.5) * timing.tick_s
    current = np.full((ticks, len(AXES)), np.nan)
    for axis, drive in drives.items():
        values, _ = drive.at(middle_s + shift_s[axis])
        current[:, AXES.index(axis)] = values * amperes_per_unit(variant, drive)
    rows = ticks // timing.encoder_divider
    reading, after = (np.full((rows, len(ENCODERS)), np.nan) for _ in range(2))
    resolution = [1.0] * len(ENCODERS)
    known = np.isfinite(current)[:: timing.encoder_divider]
    for axis in axes:
        for signal, place in _positions(log, variant, axis):
            counts = _counts_per_unit(variant, axis, ENCODERS[place], signal.kind)
            row, late = _rows(signal.time_s - begin_s, timing, _delay_rows(variant, place), rows)
            use = np.flatnonzero((row >= 0) & known[row, AXES.index(axis)])
            reading[row[use], place] = signal.value[use] * counts
            after[row[use], place] = late[use]
            resolution[place] = abs(counts) * (
                signal.resolution or UNKNOWN_RESOLUTION * float(np.ptp(signal.value))
            )
    return Record(
        log.name,
        timing,
        np.full((ticks, 2 * len(AXES)), np.nan),
        reading,
        None,
        None,
        whole_counts=False,
        current=current,
        late_s=np.nan_to_num(after),
        resolution=tuple(resolution),
    )


def _timing(log: MeasuredLog, axes: Sequence[str], variant: Variant) -> Timing:
    """
    Return the ticks with which a log is simulated: the twin's own where its controllers are known.

    A machine alone has no clock of its own: a whole multiple of the fastest log is taken, so that a
    slow log is not simulated for nothing. Its phase cycle is one tick.
    """
    if any(variant.pmac.get(axis) or variant.copley.get(axis) for axis in axes):
        return Timing()
    fastest_hz = max(log[axis, 'position'].rate_hz for axis in axes)
    ticks = max(TICKS_PER_READING, math.ceil(LEAST_TICKS_HZ / fastest_hz))
    return Timing(min(round(ticks * fastest_hz), Timing().current_loop_hz), 1, 1)


def aligned_record(log: MeasuredLog, variant: Variant) -> Record:
    """Return the record of a measured log by itself; see `aligned_records`."""
    (record,) = aligned_records([log], variant)
    return record


def aligned_records(logs: Sequence[MeasuredLog], variant: Variant) -> list[Record]:
    """
    Return the records of measured logs, their channels aligned as far as they tell how.

    How late the drive of an axis stands is found from all logs with that kind of drive together: it
    is the logger's, not the motion's. Notes say what skew was found and taken out, what clock the
    commands run by, and what the rate of a log limits. Raises as `record_of_measured_log`.
    """
    axes_of = [driven_axes(log, variant) for log in logs]
    pairs: dict[tuple[str, str], list[tuple[Signal, Signal]]] = {}
    for log, axes in zip(logs, axes_of, strict=True):
        for axis in axes:
            drive = drive_of(log, axis)
            assert drive is not None
            pairs.setdefault((axis, drive.kind), []).append((log[axis, 'position'], drive))
    skews = {
        (axis, kind): common_skew(
            those, places.electrical_cycle(variant, axis) / places.motor_ratio(variant, axis)
        )
        for (axis, kind), those in pairs.items()
    }
    return [_aligned(log, axes, variant, skews) for log, axes in zip(logs, axes_of, strict=True)]


def _aligned(
    log: MeasuredLog,
    axes: Sequence[str],
    variant: Variant,
    skews: Mapping[tuple[str, str], Skew | None],
) -> Record:
    """Return the record of a log whose skews, by axis and kind of drive, are known."""
    late_s, notes = {}, []
    for axis in axes:
        position, drive = log[axis, 'position'], drive_of(log, axis)
        assert drive is not None
        found = skews[axis, drive.kind]
        pair = f'{log.name}: {drive.name} against its position'
        if found is None:
            notes.append(f'{pair}: this motion does not show which of them is late')
        elif found.significant:
            late_s[axis] = found.late_s
            notes.append(f'{pair}: {found} late, moved by that')
        else:
            notes.append(f'{pair}: {found} late, not significant')
        commanded = log.get(axis, 'commanded_position')
        ratio = clock_ratio(position, commanded) if commanded else None
        if ratio is not None and abs(ratio - 1.0) > SAME_CLOCK:
            notes.append(
                f'{log.name}: {axis} ran {ratio:.3f} times as fast as its commanded position: the time '
                'base of one of them is wrong; the commanded position was not used'
            )
    record = record_of_measured_log(log, variant, late_s)
    limit_hz = PlantBlock(record, variant).observer_hz
    if limit_hz < OBSERVER_HZ:
        notes.append(
            f'{log.name}: its positions come too slowly to show what forces do above {limit_hz:.0f} Hz'
        )
    return replace(record, notes=tuple(notes))


def sized_by(records: Sequence[Record], variant: Variant) -> Variant:
    """
    Return the variant with the usual currents of the logs, for axes without a known amplifier.

    Effects are sized by what a drive can do (`places.rated_force`); where nobody says what that is,
    what it did has to tell.
    """
    usual = {}
    for place, axis in enumerate(AXES):
        parts = [record.current[:, place] for record in records if record.current is not None]
        known = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else ()
        if len(known) and not variant.copley.get(axis):
            usual[axis] = float(np.sqrt(np.mean(np.square(known))))
    return replace(variant, usual_current={axis: value for axis, value in usual.items() if value})


def _positions(log: MeasuredLog, variant: Variant, axis: str) -> list[tuple[Signal, int]]:
    """
    Return what was measured of an axis' position, with the place of the encoder that sees it.

    Raises `UserError` if the model has no encoder for its position.
    """
    encoder, second = POSITION_ENCODER[axis], MOTOR_ENCODER[axis]
    encoders = variant.description.encoders
    if encoder not in encoders:
        raise UserError(
            f'the model {variant.name} has no encoder {encoder}, which sees the position of {axis} '
            f'in {log.name}; add it to the description (its encoders: {", ".join(encoders) or "none"})'
        )
    found = [(log[axis, 'position'], ENCODERS.index(encoder))]
    on_motor = log.get(axis, 'motor_position')
    if on_motor is not None and second != encoder and second in encoders:
        found.append((on_motor, ENCODERS.index(second)))
    return found


def _counts_per_unit(variant: Variant, axis: str, encoder: str, kind: str) -> float:
    """Return counts of an encoder per m or rad of a signal, all connections rigid."""
    part = variant.description.encoders[encoder]
    placing = variant.rigid.placing
    of = places.coordinate(variant, axis)
    if kind == 'motor_position':
        of = places.motor_coordinate(variant, axis)
    return part.counts_per_unit * placing[part.coordinate][1] / placing[of][1]


def _delay_rows(variant: Variant, place: int) -> int:
    """Return by how many rows the model publishes the counts of an encoder late."""
    description = variant.description
    own = description.encoders[ENCODERS[place]].errors.extra_delay
    return int(description.encoder_delay + own)


def _rows(time_s: Array, timing: Timing, delay: int, rows: int) -> tuple[np.ndarray, Array]:
    """
    Return the row of each time and how much later than that row's tick it is, s.

    Rows are those in which the model publishes what it saw at that time; -1 where the log has none, and
    for all but the first of several times in one row.
    """
    row_s = timing.encoder_divider * timing.tick_s
    nearest = np.round(time_s / row_s).astype(np.intp)
    late = time_s - nearest * row_s
    row = nearest + delay
    row[(row < 0) | (row >= rows)] = -1
    row[1:][row[1:] == row[:-1]] = -1
    return row, late
