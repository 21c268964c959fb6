# SPDX-License-Identifier: Apache-2.0
"""From columns and a mapping to a measured log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.checks import check_signals
from waferbot_twin.logs.columns import Column, Columns, Table
from waferbot_twin.logs.counting import AVERAGE, counted
from waferbot_twin.logs.findings import Finding, rows_text, unique
from waferbot_twin.logs.hold import with_hold
from waferbot_twin.logs.kinds import DRIVES
from waferbot_twin.logs.mapping import LogMapping, SignalSource, TimeSource
from waferbot_twin.logs.measured import MeasuredLog, Signal
from waferbot_twin.logs.repeated_rows import without_repeated_rows
from waferbot_twin.logs.timebase import in_order, median_step_s, unwrap
from waferbot_twin.logs.units import COUNT_UNITS, TIME_UNITS

FEWEST_SAMPLES = 16
"""A signal with fewer samples is left out: nothing can be told from it."""

LATE_S = 1e6
"""Times later than this are those of a calendar clock; time zero is moved to the first sample."""


LATEST_S = 2.0**31 - 1.0
"""The last second of a ROS stamp, in January 2038."""

FIRST_S = 9.4e8
"""The earliest that a calendar clock of a log shows, s since 1970: end of 1999."""

YEAR_S = 365.25 * 86400.0


@dataclass
class Collected:
    """Signals and findings of one log, as they come in."""

    signals: list[Signal]
    findings: list[Finding]
    origin_ns: int = 0


def build(mapping: LogMapping, log: Columns, companion: Columns | None) -> Collected:
    """
    Return the signals that a mapping names.

    A signal that cannot be had is left out and reported; `finish` decides whether enough is left.
    """
    collected = Collected([], [])
    origins: list[float] = []
    made: list[tuple[SignalSource, Signal]] = []
    for source in mapping.signals:
        table = companion if source.in_companion else log
        if table is None:
            continue  # that the companion is not there was reported by whoever looked for it
        try:
            signal = _signal(mapping, source, table, collected.findings)
        except UserError as error:
            collected.findings.append(Finding(f'{source.axis}.{source.kind}', str(error)))
            continue
        if signal is not None:
            made.append((source, signal))
            origins.append(float(signal.time_s[0]))
    for table in (log, companion):
        if table is not None:
            collected.findings[:0] = table.findings
    _check_times(mapping, [signal for _, signal in made])
    shift_s = float(np.floor(min(origins))) if origins and abs(min(origins)) > LATE_S else 0.0
    collected.origin_ns = int(shift_s) * 1_000_000_000
    for _, signal in made:
        windowed = _window(signal, shift_s, mapping.options, collected.findings)
        if windowed is not None:
            collected.signals.append(windowed)
    outside = {
        signal.name: len(signal.time_s) - len(windowed.time_s)
        for (_, signal) in made
        for windowed in collected.signals
        if windowed.name == signal.name and len(windowed.time_s) < len(signal.time_s)
    }
    if outside:
        reason = f'{max(outside.values())} samples are outside start_s and end_s, as wished'
        collected.findings.append(Finding(', '.join(outside), reason, 'note'))
    wish = mapping.options.get('repeated_rows', '')
    at_readings = without_repeated_rows(collected.signals, wish, collected.findings)
    collected.signals = [with_hold(signal, collected.findings) for signal in at_readings]
    return collected


def _check_times(mapping: LogMapping, signals: list[Signal]) -> None:
    """Refuse times that no calendar clock shows; the unit of the time column is wrong then."""
    furthest_s = max((float(np.abs(signal.time_s).max()) for signal in signals), default=0.0)
    if furthest_s > LATEST_S:
        raise UserError(
            f'{mapping.source}: with this unit of time the log goes to {furthest_s:.4g} s, which is '
            f'{furthest_s / YEAR_S:.3g} years; is time.unit right?{_epoch_hint(mapping, furthest_s)}'
        )


def _epoch_hint(mapping: LogMapping, furthest_s: float) -> str:
    """Return in which unit times would be of a calendar clock of our days, in words."""
    for unit, unit_s in TIME_UNITS.items():
        in_unit_s = furthest_s / mapping.time.unit_s * unit_s
        if FIRST_S < in_unit_s <= LATEST_S:
            return f' In {unit} it would be of the year {1970 + int(in_unit_s / YEAR_S)}'
    return ''


def finish(
    collected: Collected, log: MeasuredLog, peak_current: dict[str, float] | None = None
) -> MeasuredLog:
    """
    Return `log` with the signals and findings collected, after the last checks.

    Raises `UserError` if no axis has position and something that drives it.
    """
    findings = [*collected.findings, *_gaps(collected.signals)]
    findings += check_signals(collected.signals, peak_current or {})
    result = MeasuredLog(
        log.name,
        tuple(collected.signals),
        unique(findings),
        log.source,
        log.digest,
        log.mapping,
        collected.origin_ns,
    )
    if not result.usable_axes():
        there = ', '.join(signal.name for signal in result.signals) or 'nothing'
        reasons = ''.join(f'; {finding}' for finding in result.findings)
        raise UserError(
            f'{log.source}: not enough to work with: needs, of one axis, time, position and one of '
            f'{", ".join(DRIVES)}; usable is {there}{reasons}'
        )
    return result


def clean_signal(
    axis: str,
    kind: str,
    unit: str,
    column: Column,
    time_s: NDArray[np.float64],
    findings: list[Finding],
    resolution: float | None = None,
) -> Signal | None:
    """
    Return a signal from values and times as they came; None, and a finding, if too little is left.

    Rows without a number are left out, the others put in order of time.
    """
    rows, remarks = in_order(time_s, column.value[:, None], column.file, column.place)
    findings += remarks
    value = column.value[rows]
    missing = ~np.isfinite(value)
    if missing.any():
        where = rows_text(np.sort(rows[missing]), column.place)
        findings.append(Finding(where, f'{kind} of {axis} is missing or no finite number'))
    rows = rows[~missing]
    if len(rows) < FEWEST_SAMPLES:
        reason = f'{len(rows)} samples; fewer than {FEWEST_SAMPLES} tell nothing'
        findings.append(Finding(f'{axis}.{kind}', reason))
        return None
    value = column.value[rows]
    step = lattice_step(value) if resolution is None else resolution
    return Signal(kind, axis, unit, time_s[rows], value, step)


def lattice_step(value: NDArray[np.float64]) -> float:
    """
    Return the step of which all differences of values are whole multiples, 0 if there is none.

    Found from the data: the smallest difference of two neighbouring levels, refined over the whole
    range. Values with more than a thousandth of a step beside the lattice have none.
    """
    levels = np.unique(value)
    if len(levels) < 3:
        return 0.0
    steps = np.diff(levels)
    # Rounding makes twins of one level; they are nearer than any real step.
    steps = steps[steps > 1e-9 * max(abs(levels[0]), abs(levels[-1]))]
    if len(steps) < 2:
        return 0.0
    smallest = float(steps.min())
    near = steps[steps < 1.5 * smallest]
    step = float(np.median(near))
    counts = np.round(steps / step)
    step = float(steps.sum() / counts.sum())
    off = np.abs(steps / step - np.round(steps / step))
    # Levels that fill their range by chance are no lattice: it must hold for most pairs exactly.
    return step if off.max() < 1e-2 and len(steps) >= 4 else 0.0


def _signal(
    mapping: LogMapping, source: SignalSource, table: Columns, findings: list[Finding]
) -> Signal | None:
    if source.where is not None:
        if not isinstance(table, Table):
            raise UserError(f'{mapping.source}: where belongs to text, JSON and Parquet')
        table = table.where(source.where)
    column = table.column(mapping.column(source.column))
    time_s = _times(mapping, source, table, column, findings) - source.delay_s
    number = source.sign * (source.scale * column.value / source.divide_by + source.offset)
    if source.wraps_at is not None:
        number = unwrap(number, source.wraps_at)
    conversion = source.conversion
    value = conversion.factor * number + conversion.offset
    resolution = source.resolution
    if resolution is None and source.counting == AVERAGE and source.unit == 'counts':
        resolution = 1.0
    if resolution is None and source.unit in COUNT_UNITS:
        resolution = _count(column, source)
        if resolution is None:
            reason = f'{source.kind} is in counts, but most of its values are no whole counts'
            findings.append(Finding(f'{column.file}, column {source.column}', reason, 'note'))
    if resolution is not None:
        resolution *= abs(conversion.factor)
    moved = Column(value, column.file, column.noun, column.number, column.sample)
    signal = clean_signal(
        source.axis, source.kind, source.si_unit, moved, time_s, findings, resolution
    )
    if signal is None:
        return None
    signal = replace(signal, hold=source.hold)
    counting = source.counting or (
        mapping.machine.counting(source.axis, source.kind) if mapping.machine else ''
    )
    up = source.sign * source.scale * source.divide_by * conversion.factor > 0.0
    return counted(signal, counting, up, findings) if counting else signal


def _count(column: Column, source: SignalSource) -> float | None:
    """Return the step of a column in counts, if its values are whole multiples of one."""
    numbers = source.scale * column.value / source.divide_by
    numbers = numbers[np.isfinite(numbers)]
    whole = np.mean(np.abs(numbers - np.round(numbers)) < 1e-6) if len(numbers) else 0.0
    return 1.0 if whole > 0.99 and source.unit == 'counts' else None


def _times(
    mapping: LogMapping,
    source: SignalSource,
    table: Columns,
    column: Column,
    findings: list[Finding],
) -> NDArray[np.float64]:
    """Return the time of every row of a column, s; raises `UserError` if nothing tells it."""
    time = source.time or mapping.time
    if time.column is not None:
        return _time_column(mapping, time, table, column, findings)
    if time.sample_time_s is not None:
        if column.time_s is not None:
            findings += _expected(column.time_s, time.sample_time_s, column.file)
        return np.asarray(column.sample * time.sample_time_s, np.float64)
    if column.time_s is not None:
        return column.time_s
    raise UserError(
        f'{mapping.source}: nothing tells the time of column {source.column!r}: give time.column '
        'with its unit, or time.sample_time_s'
    )


def _time_column(
    mapping: LogMapping,
    time: TimeSource,
    table: Columns,
    column: Column,
    findings: list[Finding],
) -> NDArray[np.float64]:
    assert time.column is not None
    name = mapping.column(time.column)
    clock = table.column(name)
    if len(clock.value) != len(column.value):
        raise UserError(
            f'{column.file}: {len(column.value)} samples, but {len(clock.value)} in the time column '
            f'{name!r}'
        )
    number = clock.value if time.wraps_at is None else unwrap(clock.value, time.wraps_at)
    time_s = number * time.unit_s
    if time.sample_time_s is not None:
        findings += _expected(time_s, time.sample_time_s, clock.file)
    return time_s


def _expected(time_s: NDArray[np.float64], sample_time_s: float, file: str) -> list[Finding]:
    """Compare the times that a log has with the sample time that the mapping says."""
    finite = time_s[np.isfinite(time_s)]
    if len(finite) < 3:
        return []
    step = float(np.median(np.abs(np.diff(finite))))
    if abs(step / sample_time_s - 1.0) <= 0.01:
        return []
    reason = (
        f'samples are {step:.6g} s apart by the times in the log, but the mapping says '
        f'{sample_time_s:.6g} s; the log was believed'
    )
    return [Finding(file, reason, 'suspect')]


def _window(
    signal: Signal, shift_s: float, options: Any, findings: list[Finding]
) -> Signal | None:
    """Return the part of a signal between `start_s` and `end_s`, with time zero moved."""
    time_s = signal.time_s - shift_s if shift_s else signal.time_s
    start_s, end_s = options.get('start_s', -np.inf), options.get('end_s', np.inf)
    inside = (time_s >= start_s) & (time_s <= end_s)
    if np.count_nonzero(inside) < FEWEST_SAMPLES:
        reason = (
            f'only {np.count_nonzero(inside)} samples between start_s and end_s; the signal goes '
            f'from {time_s[0]:.6g} to {time_s[-1]:.6g} s'
        )
        findings.append(Finding(signal.name, reason))
        return None
    return replace(signal, time_s=time_s[inside], value=signal.value[inside])


def _gaps(signals: list[Signal]) -> list[Finding]:
    """Report gaps in time; signals that share them share the remark."""
    names: dict[str, list[str]] = {}
    for signal in signals:
        gaps = signal.gaps()
        if gaps:
            longest = max(gaps, key=lambda gap: gap[1] - gap[0])
            reason = (
                f'{len(gaps)} gaps in time (steps over {signal.gap_s:.4g} s, usual '
                f'{median_step_s(signal.time_s):.4g} s), the longest from {longest[0]:.6g} to '
                f'{longest[1]:.6g} s; nothing was filled in'
            )
            names.setdefault(reason, []).append(signal.name)
    return [Finding(', '.join(which), reason, 'note') for reason, which in names.items()]
