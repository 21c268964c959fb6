# SPDX-License-Identifier: Apache-2.0
"""
Compensation tables: currents that the servo adds to its output, by what is commanded.

A table says, for one axis, what current (A, peak of the sine) the machine needs at a commanded
position, at a commanded speed, or at a time of one experiment:

    axis,over,at,current_a
    y_linear,speed_m_s,-0.5,-0.31
    y_linear,speed_m_s,0.5,0.31
    x_rotate,position_rad,0,-12.4
    y_rotate,time_s:wafer_exchange,0.02,0.8

Cogging and gravity are tables over position, friction is one over speed, and the inverse dynamics of a
whole motion, with what the axes do to one another, is one over time. On a Turbo PMAC the first is a
torque compensation table, the second what Ixx68 is the simplest case of, and the third a user-written
phase that writes the output's bias (Ixx29) in every servo cycle.

Between two lines the current is interpolated, before the first and behind the last it is held; two
lines with one `at` are a jump. Several tables of one axis add up. What is commanded decides, not what
was measured: a table changes no stability margin.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.contract import USUAL_UNITS
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.parameters import did_you_mean
from waferbot_pmac.servo import DAC_RANGE, REGISTERS_PER_COUNT
from waferbot_pmac.user_units import Units

COLUMNS = ('axis', 'over', 'at', 'current_a')

TIME = 'time_s'
"""A table over the time of one experiment: `time_s:NAME`."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Table:
    """
    Currents of one axis: `current` (n,), A, at `at` (n,), which never falls.

    `over` is `position_m`, `position_rad`, `speed_m_s`, `speed_rad_s` or `time_s:EXPERIMENT`.
    """

    axis: str
    over: str
    at: Floats
    current: Floats

    @property
    def experiment(self) -> str:
        """The experiment of a table over time, else ''."""
        return self.over.partition(':')[2]


def over_position(unit: str) -> str:
    """Return what a table over position is called for an axis with this unit, `m` or `rad`."""
    return f'position_{unit}'


def over_speed(unit: str) -> str:
    """Return what a table over speed is called for an axis with this unit, `m` or `rad`."""
    return f'speed_{unit}_s'


def load_tables(path_or_text: str | Path, units: Units = USUAL_UNITS) -> tuple[Table, ...]:
    """
    Return the tables of a CSV file, or of its text (what has a line break); none for ''.

    `units` says of each axis whether it is measured in m or in rad. Raises `UserError` with file and
    line for what is wrong in it.
    """
    given = str(path_or_text)
    if not given:
        return ()
    if '\n' in given:
        return parse_tables(given, 'compensation', units)
    return parse_tables(read_text(given), given, units)


def read_text(path: str | Path) -> str:
    """Return the text of a file of tables; raises `UserError`."""
    try:
        return Path(path).read_text('utf-8')
    except (OSError, ValueError) as error:
        raise UserError(f'compensation {str(path)!r} cannot be read: {error}') from error


def parse_tables(text: str, source: str, units: Units = USUAL_UNITS) -> tuple[Table, ...]:
    """Return the tables in the text of a CSV file; raises `UserError` naming `source` and line."""
    reader = csv.reader(io.StringIO(text))
    rows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    header: list[str] = []
    for cells in reader:
        where = f'{source}, line {reader.line_num}'
        if not cells or cells[0].lstrip().startswith('#'):
            continue
        if not header:
            header = [cell.strip() for cell in cells]
            if tuple(header) != COLUMNS:
                raise UserError(
                    f'{where}: the columns are {",".join(header)}; they must be '
                    f'{",".join(COLUMNS)}'
                )
            continue
        if len(cells) != len(COLUMNS):
            raise UserError(f'{where}: {len(cells)} values; there must be {len(COLUMNS)}')
        axis, over = cells[0].strip(), cells[1].strip()
        _check_names(where, axis, over, units)
        at, current = (
            _number(where, name, cell) for name, cell in zip(COLUMNS[2:], cells[2:], strict=True)
        )
        table = rows.setdefault((axis, over), [])
        if table and at < table[-1][0]:
            raise UserError(f'{where}: {at:g} is below {table[-1][0]:g} of the line before')
        table.append((at, current))
    if not header:
        raise UserError(f'{source}: no table; the first line must be {",".join(COLUMNS)}')
    return tuple(
        Table(axis, over, *(np.array(values) for values in zip(*table, strict=True)))
        for (axis, over), table in rows.items()
    )


def _check_names(where: str, axis: str, over: str, units: Units) -> None:
    if axis not in units:
        raise UserError(f'{where}: no axis {axis!r}{did_you_mean(axis, units)}')
    own = (over_position(units[axis]), over_speed(units[axis]))
    known = (*own, f'{TIME}:EXPERIMENT')
    kind, colon, experiment = over.partition(':')
    if over not in own and not (kind == TIME and colon and experiment):
        raise UserError(
            f'{where}: a table of {axis} cannot be over {over!r}{did_you_mean(over, known)} '
            f'(there are: {", ".join(known)})'
        )


def _number(where: str, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(f'{where}: {name} is {cell.strip()!r}; it must be a finite number')
    return value


def table_text(tables: Sequence[Table], comment: str = '') -> str:
    """Return tables as the text of a CSV file; numbers at ten digits, so that they read back alike."""
    lines = [f'# {line}' for line in comment.splitlines()] + [','.join(COLUMNS)]
    for table in tables:
        lines += [
            f'{table.axis},{table.over},{at:.10g},{current:.10g}'
            for at, current in zip(table.at, table.current, strict=True)
        ]
    return '\n'.join(lines) + '\n'


def offsets(
    tables: Sequence[Table],
    experiment: str,
    commanded: Floats,
    parameters: np.ndarray,
    servo_rate_hz: float,
    layout: Layout = SHIPPED,
) -> Floats:
    """
    Return what the servo adds to its output in every cycle, DAC units, (cycles, axes).

    `commanded` (cycles, axes) are the commanded positions in counts, absolute, from the first cycle of
    the experiment on; they are taken as the servo's registers hold them. The speed of a cycle is its
    change, zero in the first. `parameters` are those of the servo.
    """
    result = np.zeros(commanded.shape)
    for table in tables:
        if table.experiment and table.experiment != experiment:
            continue
        place = layout.place(table.axis)
        p = {name: float(parameters[name][0, place]) for name in _SCALES}
        registers = REGISTERS_PER_COUNT * p['Ixx08']
        position = np.floor(commanded[:, place] * registers + 0.5) / registers
        position = position / p['counts_per_unit']
        if table.experiment:
            at = np.arange(len(position)) / servo_rate_hz
        elif table.over.startswith('position_'):
            at = position
        else:
            at = np.diff(position, prepend=position[:1]) * servo_rate_hz
        current = np.interp(at, table.at, table.current)
        result[:, place] += current * DAC_RANGE / p['amplifier_peak_current']
    return result


_SCALES = ('Ixx08', 'counts_per_unit', 'amplifier_peak_current')
