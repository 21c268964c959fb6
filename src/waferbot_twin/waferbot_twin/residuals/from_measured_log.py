# SPDX-License-Identifier: Apache-2.0
"""
Records from measured logs: what `waferbot import` wrote, text and arrays, recordings of joint states.

Nothing is resampled that was measured as a position: every reading stands in the row of the ticks that
is nearest to its time, with the rest of its time beside it (`Record.late_s`), and the rows between are
empty. Half a step is added to readings that were rounded down (`logs.counting`). What drives an axis is
needed at every tick, and is its mean there (`Signal.means`): held, or straight from sample to sample.
Where the drive is not known, in a gap or outside of its log, readings are left out.

What drives an axis is, the first that the log has of

    current            A, the part that makes force
    force (torque)     N, Nm at the axis: F / (k r), with the nominal force per ampere k and the ratio
                       r of the transmission. A drive's force is nearly always its own estimate from
                       its current; one that was measured acts on the model in this way just as well.
    current command    A, as if the amplifier did at once what it is told
    drive command      share of full scale or V, likewise: what the described controller says that the
                       drive makes of it, or share of the peak current of an amplifier that is known

Commanded positions stand at servo ticks. Where the model knows the controller, they begin with a cycle
of it: what the log tells of the cycles, the instants at which the commanded position changes, is kept.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.timing import Timing
from waferbot_twin.controllers.law import cycle_hz
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.logs.alignment import SAME_CLOCK, Skew, clock_ratio, common_skew
from waferbot_twin.logs.counting import AVERAGE, FLOOR, ROUND, counted, told_by_both
from waferbot_twin.logs.kinds import DRIVES
from waferbot_twin.logs.measured import LINEAR, ZERO_ORDER, MeasuredLog, Signal
from waferbot_twin.logs.pauses import Clock, with_short_pauses
from waferbot_twin.residuals.drive_path import no_path, with_signal
from waferbot_twin.residuals.plant_block import OBSERVER_HZ, PlantBlock
from waferbot_twin.residuals.record import Array, Record

TICKS_PER_READING = 4
LEAST_TICKS_HZ = 2000.0
"""
Ticks of a machine alone: for each reading, and in a second at least. Of a real axis that sticks and
slides (EMPS, 1 kHz) residuals differ by 0.4 % of their RMS from those with 16.
"""

TICKS_PER_ROW = 2
"""Ticks from row to row of readings: what a cause changes is found with half as many (`quick`)."""

UNKNOWN_RESOLUTION = 1e-6
"""Share of its path that a position is taken to be resolved to if the log does not show its steps."""

COMMANDS = ('drive_command', 'current_command')
"""What comes nearest to the output of a controller."""

USED = ('position', 'motor_position', 'commanded_position', *DRIVES)
"""Kinds of signals that a record is made of."""

SAME_CYCLE, SAME_RATE = 1e-3, 1e-6
"""Shares of a cycle, and of a rate, that are rounding."""

SLOWER = 1.5
"""Cycles of a controller from sample to sample from which on a log is slower than it."""

FASTER = 0.6
"""Cycles from sample to sample up to which a log is faster than the controller."""

BEHIND = 0.25
"""Share of a step behind a cycle at which a value is that of the cycle, however times are rounded."""

FEW_SAMPLES = 2
"""Samples that a command may lack at the ends of a log."""

BRIDGED_S = 0.05
"""A commanded position goes straight over gaps up to this long, s; over longer ones nobody knows it."""

LEAST_CHANGES, IN_STEP = 16, 0.7
"""Changes of a command, and how far they agree (0 to 1), that tell when a controller acts."""

SPEED_OVER_S = 0.02
"""Over which a speed is taken: steps of a coarse encoder are none."""

NEAR_HALF = 0.2
"""Share of a sample by which a skew may miss half a sample and still be that of another hold."""

LENGTH = {'m': 'slides', 'rad': 'turns'}
"""What an axis does whose position has this unit."""


def drive_of(log: MeasuredLog, axis: str) -> Signal | None:
    """Return what tells best what drives an axis, None if nothing does."""
    return next((found for kind in DRIVES if (found := log.get(axis, kind))), None)


def amperes_per_unit(variant: Variant, drive: Signal) -> float:
    """Return the motor current (A) per unit of what drives an axis; raises `UserError`."""
    if drive.kind == 'force':
        return 1.0 / places.force_per_ampere(variant, drive.axis)
    if drive.kind != 'drive_command':
        return 1.0
    controller = variant.description.controllers.get(drive.axis)
    output = 'V' if drive.unit == 'V' else 'share'
    if controller is not None and controller.output == output:
        return places.amperes_per_output(variant, drive.axis)
    if output == 'share' and variant.copley.get(drive.axis):
        return places.peak_current(variant, drive.axis)
    what = 'in V' if output == 'V' else 'a share of the peak current of an amplifier'
    raise UserError(
        f'{drive.name} is {what} and the model {variant.name} does not say what that makes: map it as '
        f'current_command, with its scale in A, or describe its controller with output: {output}'
    )


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
    log: MeasuredLog,
    variant: Variant,
    late_s: Mapping[str, float] | None = None,
    without_commanded: Collection[str] = (),
) -> Record:
    """
    Return the record of a measured log.

    `late_s` says of each axis how much later than the position its drive stands in the log (s); it is
    moved by that. Commanded positions of the axes `without_commanded` are not used. Ticks begin at the
    first time at which something is known. Raises `UserError` if log and model have no axis in common,
    or never both signals at once.
    """
    axes = driven_axes(log, variant)
    commanded = {
        axis: found
        for axis in axes
        if axis not in without_commanded and (found := log.get(axis, 'commanded_position'))
    }
    timing = _timing(log, axes, variant)
    shift_s = {axis: (late_s or {}).get(axis, 0.0) for axis in axes}
    drives = {axis: found for axis in axes if (found := drive_signal(log, variant, axis))}
    spans = {
        axis: (
            max(log[axis, 'position'].time_s[0], drive.time_s[0] - shift_s[axis]),
            min(log[axis, 'position'].time_s[-1], drive.time_s[-1] - shift_s[axis]),
        )
        for axis, drive in drives.items()
    }
    begin_s = min(begin for begin, _ in spans.values())
    if commanded and timing.servo_divider > 1:
        first_s = _first_cycle_s(next(iter(commanded.values())), timing.servo_hz)
        cycles_before = math.ceil((begin_s - first_s) * timing.servo_hz - SAME_CYCLE)
        begin_s = first_s + cycles_before / timing.servo_hz
    end_s = max(end for _, end in spans.values())
    cycles = int((end_s - begin_s) * timing.servo_hz + SAME_CYCLE)
    if cycles < 1:
        raise UserError(
            f'{log.name}: position and drive of {", ".join(axes)} are never known at once'
        )
    ticks = cycles * timing.servo_divider
    edges_s = begin_s + np.arange(ticks + 1) * timing.tick_s
    layout = variant.layout
    current = np.full((ticks, len(layout.axes)), np.nan)
    path = no_path(ticks + 1, len(layout.axes))
    for axis, drive in drives.items():
        place, per_unit = layout.place(axis), amperes_per_unit(variant, drive)
        current[:, place] = drive.means(edges_s + shift_s[axis]) * per_unit
        path = with_signal(path, place, drive, edges_s + shift_s[axis], per_unit)
    rows = ticks // timing.encoder_divider
    encoders = len(layout.encoders)
    reading, after = (np.full((rows, encoders), np.nan) for _ in range(2))
    resolution, half_step = [1.0] * encoders, [0.0] * encoders
    in_steps = [False] * encoders
    known = np.isfinite(current)[:: timing.encoder_divider]
    for axis in axes:
        for signal, place in _positions(log, variant, axis):
            counts = _counts_per_unit(variant, axis, layout.encoders[place], signal.kind)
            half_step[place] = signal.half_step * counts
            row, late = _rows(signal.time_s - begin_s, timing, _delay_rows(variant, place), rows)
            use = np.flatnonzero((row >= 0) & known[row, layout.place(axis)])
            reading[row[use], place] = signal.value[use] * counts + half_step[place]
            after[row[use], place] = late[use]
            in_steps[place] = signal.resolution > 0.0 and signal.counting in (FLOOR, ROUND)
            step = 0.0 if signal.counting == AVERAGE else signal.resolution
            resolution[place] = abs(counts) * (
                step or UNKNOWN_RESOLUTION * float(np.ptp(signal.value))
            )
    cycle_s = begin_s + np.arange(cycles) / timing.servo_hz
    paths = _at_cycles(commanded, cycle_s, places.counts_per_unit(variant), layout.axes, BRIDGED_S)
    known_controllers = _with_known_controller(variant, paths)
    outputs = {
        axis: _output_signal(log, variant, axis)
        for axis in places.described_axes(variant)
        if axis in known_controllers
    }
    amperes = np.array(
        [amperes_per_unit(variant, outputs[a]) if a in outputs else 1.0 for a in layout.axes]
    )
    return Record(
        log.name,
        timing,
        np.full((ticks, 2 * len(layout.axes)), np.nan),
        reading,
        paths,
        _at_cycles(outputs, cycle_s, amperes, layout.axes),
        whole_counts=False,
        current=current,
        path=path,
        late_s=np.nan_to_num(after),
        resolution=tuple(resolution),
        half_step=tuple(half_step),
        counted=tuple(in_steps),
        controlled=known_controllers,
        skew_spread_s=(0.0,) * len(layout.axes),
        layout=layout,
        force_driven=tuple(axis for axis, drive in drives.items() if drive.kind == 'force'),
        told_alone=tuple(axis for axis, drive in drives.items() if drive.kind != 'current'),
    )


def drive_signal(log: MeasuredLog, variant: Variant, axis: str) -> Signal | None:
    """
    Return what tells best what drives an axis, as it goes between samples; None if nothing does.

    A force that is the output of the described controller, or follows from it, is held unless the log
    says otherwise.
    """
    drive = drive_of(log, axis)
    if drive is None or drive.hold or drive.kind != 'force':
        return drive
    controller = variant.description.controllers.get(axis)
    if controller is None or controller.drive_unit == 'A':
        return drive
    return replace(drive, hold=ZERO_ORDER)


def _output_signal(log: MeasuredLog, variant: Variant, axis: str) -> Signal:
    """Return what a log has of the output of an axis' described controller, the nearest to it."""
    unit = variant.description.controllers[axis].output
    force_first = unit in ('N', 'Nm')
    kinds = ('force', *COMMANDS, 'current') if force_first else (*COMMANDS, 'current', 'force')
    there = [signal for kind in kinds if (signal := log.get(axis, kind))]
    exact = [signal for signal in there if signal.unit == {'share': '1'}.get(unit, unit)]
    others = [signal for signal in there if signal.kind != 'drive_command']
    return replace((exact or others or there)[0], hold=ZERO_ORDER)


def _with_known_controller(variant: Variant, paths: Array | None) -> tuple[str, ...]:
    """Return the axes whose commanded position is known throughout, and their controller too."""
    if paths is None:
        return ()
    described = places.described_axes(variant)
    known = described or tuple(
        axis for axis in places.controlled_axes(variant) if variant.copley.get(axis)
    )
    return tuple(axis for axis in known if np.isfinite(paths[:, variant.layout.place(axis)]).all())


def _first_cycle_s(commanded: Signal, servo_hz: float) -> float:
    """
    Return a time at which a controller of that rate computed, s.

    Its cycles begin where the commanded position changes, as the mean over all changes has it: half a
    step before in a log that is faster. Where that tells nothing, with the first sample.
    """
    changed = commanded.time_s[1:][np.diff(commanded.value) != 0.0]
    if servo_hz < FASTER * commanded.rate_hz:
        changed = changed - 0.5 / commanded.rate_hz
    turns = np.exp(2j * np.pi * (changed - commanded.time_s[0]) * servo_hz)
    if len(turns) < LEAST_CHANGES or abs(turns.mean()) < IN_STEP:
        return float(commanded.time_s[0])
    return float(commanded.time_s[0] + np.angle(turns.mean()) / (2.0 * np.pi * servo_hz))


def _at_cycles(
    signals: Mapping[str, Signal],
    cycle_s: Array,
    per_unit: Array,
    axes: Sequence[str],
    bridged_s: float = 0.0,
) -> Array | None:
    """
    Return what axes were told at the controllers' cycles (cycles, axes); None without any signal.

    As `Signal.at` gives it, a little behind each cycle: times of a log are rounded. In a faster log it
    is the first sample of each cycle. What is slower than the cycles was finer where it came from, and
    is taken straight. Ends that lack a few samples stay as the last one; gaps are NaN, but for those up
    to `bridged_s`, which are taken straight.
    """
    if not signals:
        return None
    found = np.full((len(cycle_s), len(axes)), np.nan)
    step_s = cycle_s[1] - cycle_s[0] if len(cycle_s) > 1 else 0.0
    for axis, signal in signals.items():
        own_s = 1.0 / signal.rate_hz
        if own_s > SLOWER * step_s:
            signal = replace(signal, hold=LINEAR)
            value, _ = signal.at(cycle_s)
        else:
            faster = own_s < FASTER * step_s
            value, _ = signal.at(cycle_s + (own_s if faster else BEHIND * min(own_s, step_s)))
        known = np.flatnonzero(np.isfinite(value))
        if len(known):
            few = math.ceil(FEW_SAMPLES * max(own_s / step_s, 1.0)) if step_s else 0
            if known[0] <= few:
                value[: known[0]] = value[known[0]]
            if len(value) - 1 - known[-1] <= few:
                value[known[-1] :] = value[known[-1]]
        for begin_s, end_s in signal.gaps():
            inside = (cycle_s >= begin_s) & (cycle_s < end_s)
            if end_s - begin_s <= bridged_s:
                value[inside] = np.interp(cycle_s[inside], signal.time_s, signal.value)
        found[:, axes.index(axis)] = value * per_unit[axes.index(axis)]
    return found


def _timing(log: MeasuredLog, axes: Sequence[str], variant: Variant) -> Timing:
    """
    Return the ticks with which a log is simulated: the twin's own where its controllers are known.

    A machine alone has no clock of its own: a whole multiple of the fastest log is taken, so that a
    slow log is not simulated for nothing. Its encoders are read in every second one. Described
    controllers act in every so many ticks. Raises `UserError` for controllers whose rates do not nest.
    """
    if any(variant.pmac.get(axis) or variant.copley.get(axis) for axis in axes):
        return Timing()
    fastest_hz = max(log[axis, 'position'].rate_hz for axis in axes)
    rows = math.ceil(max(TICKS_PER_READING, LEAST_TICKS_HZ / fastest_hz) / TICKS_PER_ROW)
    ticks = TICKS_PER_ROW * rows
    tick_hz = min(round(ticks * fastest_hz), Timing().current_loop_hz)
    controllers = variant.description.controllers
    if not controllers:
        return Timing(tick_hz, TICKS_PER_ROW, TICKS_PER_ROW)
    servo_hz = cycle_hz(controllers)
    for controller in controllers.values():
        times = servo_hz / controller.rate
        if abs(times - round(times)) > SAME_RATE * times:
            raise UserError(
                f'{variant.name}: the controller of {controller.axis} runs at {controller.rate:g} Hz, '
                f'another at {servo_hz:g} Hz; the faster must be a whole multiple of the slower'
            )
    divider = TICKS_PER_ROW * max(1, math.ceil(tick_hz / (TICKS_PER_ROW * servo_hz) - SAME_RATE))
    return Timing(round(divider * servo_hz), TICKS_PER_ROW, divider)


def aligned_record(log: MeasuredLog, variant: Variant) -> Record:
    """Return the record of a measured log by itself; see `aligned_records`."""
    (record,) = aligned_records([log], variant)
    return record


def aligned_records(
    logs: Sequence[MeasuredLog], variant: Variant, moved: bool = True
) -> list[Record]:
    """
    Return the records of measured logs, their channels aligned as far as they tell how.

    How late the drive of an axis stands is found from all logs with that kind of drive together: it
    is the logger's, not the motion's. Notes say what skew was found and taken out, what clock the
    commands run by, and what the rate of a log limits. Where drives are not `moved`, a skew is left to
    whoever looks for causes: what a model lacks may look like one, and one like what a model lacks.
    Raises as `record_of_measured_log`.
    """
    short = [with_short_pauses_of(log, variant) for log in logs]
    logs = [log for log, _ in short]
    axes_of = [driven_axes(log, variant) for log in logs]
    pairs: dict[tuple[str, str], list[tuple[Signal, Signal]]] = {}
    for log, axes in zip(logs, axes_of, strict=True):
        for axis in axes:
            drive = drive_signal(log, variant, axis)
            assert drive is not None
            pairs.setdefault((axis, drive.kind), []).append((log[axis, 'position'], drive))
    alignments = {
        (axis, kind): _alignment(those, places.cycle_of_axis(variant, axis))
        for (axis, kind), those in pairs.items()
    }
    records = [
        _aligned(log, axes, variant, alignments, moved)
        for log, axes in zip(logs, axes_of, strict=True)
    ]
    return [
        replace(record, notes=(f'{record.name}: {clock}', *record.notes)) if str(clock) else record
        for record, (_, clock) in zip(records, short, strict=True)
    ]


def with_short_pauses_of(log: MeasuredLog, variant: Variant) -> tuple[MeasuredLog, Clock]:
    """
    Return what a record is made of, without long pauses: signals that tell how the axes were moved.

    Pauses are shortened by whole cycles of the controllers. Raises `UserError` as `driven_axes`.
    """
    axes = driven_axes(log, variant)
    used = [one for one in log.signals if one.axis in axes and one.kind in USED]
    cycle_s = 1.0 / _timing(log, axes, variant).servo_hz
    short, clock = with_short_pauses(used, cycle_s)
    return replace(log, signals=tuple(short)), clock


@dataclass(frozen=True)
class _Alignment:
    """How late the drive of an axis stands, None if no motion shows it; `as_held` if it was told so."""

    skew: Skew | None
    as_held: bool = False


def _alignment(pairs: Sequence[tuple[Signal, Signal]], cycle: float) -> _Alignment:
    """
    Return how late drives stand behind positions, in all logs together.

    A drive that was taken straight from sample to sample, and is early by half a sample, is one that
    holds its output, if it is not early when it is taken as held.
    """
    found = common_skew(pairs, cycle)
    if found is not None and all(_as_if_held(drive, found) for _, drive in pairs):
        held = [(position, replace(drive, hold=ZERO_ORDER)) for position, drive in pairs]
        of_held = common_skew(held, cycle)
        if of_held is not None and not of_held.significant:
            return _Alignment(of_held, as_held=True)
    return _Alignment(found)


def _aligned(
    log: MeasuredLog,
    axes: Sequence[str],
    variant: Variant,
    alignments: Mapping[tuple[str, str], _Alignment],
    moved: bool,
) -> Record:
    """Return the record of a log whose alignments, by axis and kind of drive, are known."""
    late_s, notes, without = {}, [], []
    spread_s = [0.0] * len(variant.layout.axes)
    for axis in axes:
        position, drive = log[axis, 'position'], drive_signal(log, variant, axis)
        assert drive is not None
        alignment = alignments[axis, drive.kind]
        found = alignment.skew
        pair = f'{log.name}: {drive.name} against its position'
        if alignment.as_held:
            log = log.with_signal(replace(drive, hold=ZERO_ORDER))
            notes.append(
                f'{pair}: early by half a sample, as a drive that holds its output: taken as held '
                '(hold: linear in the mapping, if not)'
            )
        if moved and found is None:
            notes.append(f'{pair}: this motion does not show which of them is late')
        if moved and found is not None:
            notes.append(
                f'{pair}: {found}, {"moved by that" if found.significant else "not significant"}'
            )
        if found is not None and found.significant:
            if moved:
                late_s[axis] = found.late_s
            if drive.hold != log[axis, drive.kind].hold and _half_a_sample(drive, found.late_s):
                notes.append(
                    f'{pair}: taken as held, as the output of the described controller; straight '
                    'between samples it would be half a sample less late (hold: linear in the mapping, '
                    'if it is so)'
                )
        spread_s[variant.layout.place(axis)] = _spread_s(drive, found if moved else None)
        commanded = log.get(axis, 'commanded_position')
        ratio = clock_ratio(position, commanded) if commanded else None
        if ratio is not None and abs(ratio - 1.0) > SAME_CLOCK:
            without.append(axis)
            notes.append(
                f'{log.name}: {axis} ran {ratio:.3f} times as fast as its commanded position: the time '
                'base of one of them is wrong; the commanded position was not used'
            )
    counted_log, how = _with_counting(log, variant, axes)
    record = record_of_measured_log(counted_log, variant, late_s, without)
    limit_hz = PlantBlock(record, variant).observer_hz
    if limit_hz < OBSERVER_HZ:
        notes.append(
            f'{log.name}: its positions come too slowly to show what forces do above {limit_hz:.0f} Hz'
        )
    notes += [*how, *_of_commands(record, variant, axes)]
    return replace(record, skew_spread_s=tuple(spread_s), notes=tuple(notes))


def _spread_s(drive: Signal, found: Skew | None) -> float:
    """
    Return the standard deviation of what is not known of a drive's time against its position, s.

    What a drive does between two of its samples is not in a log: it may be as late as half a step either
    way, any time as probable as another. That of a skew that was taken out is beside it.
    """
    error_s = found.standard_error_s if found is not None else 0.0
    return math.hypot(error_s, 1.0 / (math.sqrt(12.0) * drive.rate_hz))


def _as_if_held(drive: Signal, found: Skew) -> bool:
    """Return whether a drive that was taken straight is early by half a sample, and nobody said how."""
    unsaid = not drive.held and not drive.hold
    return unsaid and found.significant and _half_a_sample(drive, -found.late_s)


def _half_a_sample(drive: Signal, time_s: float) -> bool:
    """Return whether a time is half a sample of a drive, as near as a skew is known."""
    return abs(time_s * drive.rate_hz - 0.5) < NEAR_HALF


def _with_counting(
    log: MeasuredLog, variant: Variant, axes: Sequence[str]
) -> tuple[MeasuredLog, list[str]]:
    """
    Return the log with what is known of how its encoders count, and notes of what they told.

    First what the log says, then the description, then the encoders of an axis beside each other.
    """
    notes: list[str] = []
    changed: dict[tuple[str, str], Signal] = {}
    for axis in axes:
        pair = []
        for signal, place in _positions(log, variant, axis):
            name = variant.layout.encoders[place]
            up = _counts_per_unit(variant, axis, name, signal.kind) > 0.0
            own = variant.base.description.encoders[name].counting
            if not signal.counting and own:
                signal = counted(signal, own, up, [])
            pair.append((signal, up))
        if len(pair) == 2 and not any(signal.counting for signal, _ in pair):
            (position, first), (motor, second) = pair
            ratio = _motion_ratio(variant, axis)
            how = told_by_both(position, motor, ratio, (first, second))
            if how:
                pair = [(counted(signal, how, up, []), up) for signal, up in pair]
                does = 'rounded down' if how == FLOOR else 'rounded to the nearest step'
                notes.append(f'{log.name}: both encoders of {axis} are {does}, as they differ')
        changed.update({(axis, signal.kind): signal for signal, _ in pair})
    for signal in changed.values():
        log = log.with_signal(signal)
    return log, notes


def _motion_ratio(variant: Variant, axis: str) -> float:
    """Return the motion of an axis' motor per motion of the axis, all connections rigid, signed."""
    placing = variant.base.rigid.placing
    motor = placing[places.motor_coordinate(variant, axis)][1]
    return float(motor / placing[places.coordinate(variant, axis)][1])


def _of_commands(record: Record, variant: Variant, axes: Sequence[str]) -> list[str]:
    """Return notes of what the commands in a record do not allow to ask."""
    notes = []
    for axis in axes:
        if record.path_commanded(axis) is None:
            notes.append(
                f'{record.name}: {axis} has no commanded position throughout, so nothing tells what it '
                'did by command and what by chance: the answer is weaker'
            )
        elif axis not in record.controlled:
            notes.append(
                f'{record.name}: the model has no controller of {axis}, so its loop is not closed: the '
                'answer is weaker (describe it in section controllers: docs/controllers.md)'
            )
        elif places.described_axes(variant):
            servo_hz = variant.description.controllers[axis].rate
            encoder = places.encoder_places(variant)[record.layout.place(axis)]
            own_s = float(np.median(np.diff(_times_s(record, encoder))))
            if own_s * servo_hz > SLOWER:
                notes.append(
                    f'{record.name}: {axis} was logged every {1e3 * own_s:.3g} ms, its controller acts '
                    f'every {1e3 / servo_hz:.3g} ms: its loop is closed, but it is not looked at alone'
                )
    return notes


def _times_s(record: Record, place: int) -> Array:
    """Return the times of an encoder's readings in a record, s."""
    rows = np.flatnonzero(np.isfinite(record.reading[:, place]))
    return np.asarray(rows / record.timing.encoder_hz)


def _skew_text(found: Skew) -> str:
    return f'{1e3 * found.late_s:.2f} ± {2e3 * found.standard_error_s:.2f} ms'


def sized_by(records: Sequence[Record], variant: Variant) -> Variant:
    """
    Return the variant with the usual currents of the logs, for axes of unknown drives.

    Effects are sized by what a drive can do (`places.rated_force`); where nobody says what that is,
    what it did has to tell. Where all logs have a force, nothing shows what windings do; where none has
    a measured current, nothing shows how fast a drive is. How fast the axes of imported logs are, these
    show themselves.
    """
    usual, fastest = {}, {}
    for axis in places.motor_axes(variant):
        place = variant.layout.place(axis)
        fastest[axis] = max((_largest_speed(one, variant, axis) for one in records), default=0.0)
        parts = [record.current[:, place] for record in records if record.current is not None]
        known = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else ()
        unlimited = math.isinf(places.described_limit(variant, axis))
        if len(known) and not variant.copley.get(axis) and unlimited:
            usual[axis] = float(np.sqrt(np.mean(np.square(known))))
    brought_in = {
        axis
        for record in records
        for axis, spread in zip(record.layout.axes, record.skew_spread_s, strict=True)
        if spread > 0.0
    }
    by_force, told_alone = (
        frozenset(variant.description.motors).intersection(*axes)
        for axes in (
            [record.force_driven for record in records],
            [record.told_alone for record in records],
        )
    )
    return replace(
        variant,
        usual_current={axis: value for axis, value in usual.items() if value},
        usual_speed={axis: value for axis, value in fastest.items() if value},
        force_driven=by_force,
        told_alone=told_alone,
        brought_in=frozenset(brought_in),
    )


def _largest_speed(record: Record, variant: Variant, axis: str) -> float:
    """Return the largest speed of an axis in an imported log, m/s or rad/s; 0 in others."""
    encoder = places.position_encoder(variant, axis)
    if not record.is_imported or encoder not in record.layout.encoders:
        return 0.0
    reading = record.reading[:, record.layout.encoder_place(encoder)]
    rows = np.flatnonzero(np.isfinite(reading))
    if len(rows) < 2:
        return 0.0
    rate_hz = record.timing.encoder_hz
    apart = max(1, round(SPEED_OVER_S * rate_hz / float(np.median(np.diff(rows)))))
    if len(rows) <= apart:
        return 0.0
    way = np.abs(reading[rows[apart:]] - reading[rows[:-apart]])
    speed = float(np.max(way * rate_hz / (rows[apart:] - rows[:-apart])))
    return speed / abs(places.axis_counts(variant, axis))


def _positions(log: MeasuredLog, variant: Variant, axis: str) -> list[tuple[Signal, int]]:
    """
    Return what was measured of an axis' position, with the place of the encoder that sees it.

    Raises `UserError` if the model has no encoder for its position.
    """
    layout = variant.layout
    own = layout.encoders_of(axis)
    encoder, second = own[0], own[-1]
    encoders = variant.description.encoders
    if encoder not in encoders:
        raise UserError(
            f'the model {variant.name} has no encoder {encoder}, which sees the position of {axis} '
            f'in {log.name}; add it to the description (its encoders: {", ".join(encoders) or "none"})'
        )
    found = [(log[axis, 'position'], layout.encoder_place(encoder))]
    on_motor = log.get(axis, 'motor_position')
    if on_motor is not None and second != encoder and second in encoders:
        found.append((on_motor, layout.encoder_place(second)))
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
    own = description.encoders[variant.layout.encoders[place]].errors.extra_delay
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
