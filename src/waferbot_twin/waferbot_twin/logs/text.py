# SPDX-License-Identifier: Apache-2.0
"""
Logs as text: plain CSV, PMAC gather tables, exports of a drive's scope.

The header of such files depends on program and version, so none is relied on: data begin at the
first line that is numbers only, as many as the most lines have; the line before names the columns
if it has as many cells, or that of the header that begins with `Name` (TwinCAT Scope). A line that
does not fit is left out, and reported with its number.

Two forms are no tables of numbers: lines of names and values by turns (halscope of LinuxCNC), and
lists with a row for each value, in which a column says whose it is (`read_list`).
"""

from __future__ import annotations

import codecs
import gzip
import re
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.columns import Table
from waferbot_twin.logs.findings import Finding, rows_text

DELIMITERS = (';', '\t', '|', ',', 'space')
"""Tried in this order; the one that gives the most numbers is taken."""

GZIP = b'\x1f\x8b'
"""How a file begins that gzip has packed; it is unpacked, whatever it is called."""

_SAMPLE_LINES = 400
_MISSING = ('', 'nan', '-nan', 'na', 'n/a', 'null', 'none', '-', '--', '#n/a')


def read_text(path: Path, options: Mapping[str, Any] | None = None) -> Table:
    """
    Read a text log with the options of a mapping (`delimiter`, `decimal`, `header_rows`, ...).

    Raises `UserError` if the file cannot be read or holds no rows of numbers.
    """
    options = options or {}
    lines, last_is_whole = lines_of(path, options.get('encoding'))
    comment = options.get('comment', '#')
    decimal = options.get('decimal', '.')
    skipped = int(options.get('header_rows', 0))
    body = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if number > skipped
        and line.strip()
        and not (comment and line.lstrip().startswith(comment))
    ]
    file = str(path)
    if (named := _named_values(body, decimal)) is not None:
        return _with_named_period(_of_named_values(*named, decimal, file), lines)
    delimiter = options.get('delimiter') or _delimiter(body, decimal, file)
    rows = [(number, _cells(line, delimiter)) for number, line in body]
    begin, width = _begin(rows, decimal, file)
    header = _header(rows, begin, width)
    if header is None and skipped:
        cells = _cells(lines[skipped - 1].lstrip(comment or ''), delimiter)
        header = cells if len(cells) == width else None
    # An empty last cell is a missing value where other lines have one there.
    whole = [
        (number, _cells(line, delimiter, width) if len(cells) < width else cells)
        for (number, cells), (_, line) in zip(rows[begin:], body[begin:], strict=True)
    ]
    table = _numbers(whole, width, decimal, file)
    if not last_is_whole and len(table.values) and table.number[-1] == len(lines):
        table = _without_last(table)
    table.names = [cell.strip() for cell in header] if header else [''] * width
    return table


def read_list(path: Path, options: Mapping[str, Any], columns: Sequence[str | int]) -> Table:
    """
    Read a text that has a row for each value; `columns` say what a value is of, as texts.

    In other columns whatever is no number is NaN; a number may stand in brackets, as the times of
    candump do. Raises `UserError` as `read_text`.
    """
    lines, last_is_whole = lines_of(path, options.get('encoding'))
    comment, decimal = options.get('comment', '#'), options.get('decimal', '.')
    skipped = int(options.get('header_rows', 0))
    body = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if number > skipped
        and line.strip()
        and not (comment and line.lstrip().startswith(comment))
    ]
    file = str(path)
    delimiter = options.get('delimiter') or _widest([line for _, line in body])
    rows = [(number, _cells(line, delimiter)) for number, line in body]
    widths = Counter(len(cells) for _, cells in rows if len(cells) > 1)
    if not widths:
        raise UserError(f'{file}: no line of several cells found; say options.delimiter')
    width = max(widths, key=lambda cells: (widths[cells], cells))
    values = [[_bracketed(cell, decimal) for cell in cells] for _, cells in rows]
    begin = next(
        (place for place, row in enumerate(values) if len(row) == width and any(map(_is, row))), 0
    )
    header = _header(rows, begin, width)
    kept = [place for place in range(begin, len(rows)) if len(rows[place][1]) == width]
    table = Table(
        file,
        [cell.strip() for cell in header] if header else [''] * width,
        np.array([values[place] for place in kept], float),
        'line',
        np.array([rows[place][0] for place in kept], np.int64),
        np.arange(len(kept)),
    )
    broken = [place for place in range(begin, len(rows)) if len(rows[place][1]) != width]
    if broken:
        where = rows_text(np.array(broken), lambda place: f'{file}, line {rows[place][0]}')
        reason = f'not {width} cells (cut off, or another part of the file)'
        table.findings.append(Finding(where, reason))
    for name in columns:
        place = table.place(name)
        table.texts = {**table.texts, place: [rows[row][1][place] for row in kept]}
    if not last_is_whole and len(table.number) and table.number[-1] == len(lines):
        table = _without_last(table)
    return table


def _is(number: float) -> bool:
    """Tell whether a number is one."""
    return number == number


def _bracketed(cell: str, decimal: str) -> float:
    """Return a cell as number, also one in brackets; NaN for what is none."""
    number = _number(cell.strip().removeprefix('(').removesuffix(')'), decimal)
    return float('nan') if number is None else number


def _widest(lines: Sequence[str]) -> str:
    """Return the delimiter that the most lines have as often as one another, and most often."""
    sample = lines[:: max(1, len(lines) // _SAMPLE_LINES)]
    best, most = 'space', 0
    for delimiter in DELIMITERS:
        widths = Counter(len(_cells(line, delimiter)) for line in sample)
        count = max((widths[cells] * cells for cells in widths if cells > 1), default=0)
        if count > most:
            best, most = delimiter, count
    return best


def _without_last(table: Table) -> Table:
    """Return a table without its last row, whose line has no end."""
    reason = 'the last line has no end; it may be cut off in a number'
    finding = Finding(table.place_of()(-1), reason)
    return replace(table.rows(slice(None, -1)), findings=[*table.findings, finding])


def _named_values(
    body: list[tuple[int, str]], decimal: str
) -> tuple[list[str], list[tuple[int, list[str]]]] | None:
    """Return names, and rows of values, of lines with both by turns; None if they are not such."""
    rows = [(number, line.split()) for number, line in body]
    first = next((cells for _, cells in rows if _by_turns(cells, decimal)), None)
    if first is None:
        return None
    names = first[::2]
    own = [
        (number, cells[1::2])
        for number, cells in rows
        if cells[::2] == names and len(cells) == len(first)
    ]
    return (names, own) if len(own) >= max(2, len(rows) // 2) else None


def _by_turns(cells: list[str], decimal: str) -> bool:
    """Tell whether cells are names and numbers by turns."""
    if len(cells) < 2 or len(cells) % 2:
        return False
    return all(_number(cell, decimal) is None for cell in cells[::2]) and all(
        (number := _number(cell, decimal)) is not None and _is(number) for cell in cells[1::2]
    )


def _of_named_values(
    names: list[str], rows: list[tuple[int, list[str]]], decimal: str, file: str
) -> Table:
    table = _numbers(rows, len(names), decimal, file)
    table.names = names
    return table


_PERIOD = re.compile(r'sampling period is\s+(\d+)\s*ns', re.IGNORECASE)


def _with_named_period(table: Table, lines: Sequence[str]) -> Table:
    """Return a table with times, if a line of the file says how long a sampling period is."""
    told = next((found for line in lines[:20] if (found := _PERIOD.search(line))), None)
    if told is not None and int(told.group(1)) > 0:
        table.time_s = np.asarray(table.sample * (1e-9 * int(told.group(1))), np.float64)
    return table


def lines_of(path: Path, encoding: str | None = None) -> tuple[list[str], bool]:
    """Return the lines of a text file, packed by gzip or not, and whether the last one is ended."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f'{path}: cannot be read ({error.strerror})') from None
    if data.startswith(GZIP):
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError, zlib.error) as error:
            raise UserError(f'{path}: is a broken .gz file ({error})') from None
    if not data.strip():
        raise UserError(f'{path}: is empty')
    if encoding is None:
        marks = ((codecs.BOM_UTF8, 'utf-8-sig'), (codecs.BOM_UTF16_LE, 'utf-16'),
                 (codecs.BOM_UTF16_BE, 'utf-16'))  # fmt: skip
        encoding = next((name for mark, name in marks if data.startswith(mark)), 'utf-8')
    try:
        text = data.decode(encoding, 'strict')
    except LookupError:
        raise UserError(f'{path}: there is no encoding {encoding!r}') from None
    except UnicodeDecodeError:
        # Numbers are ASCII everywhere; only names and units in the header can come out wrong.
        text = data.decode('latin-1')
    text = text.replace('\r\n', '\n').replace('\r', '\n')
    return text.removesuffix('\n').split('\n'), text.endswith('\n')


def _cells(line: str, delimiter: str, width: int = 0) -> list[str]:
    """Return the cells of a line; an empty one behind the last delimiter is none, but for `width`."""
    if delimiter == 'space':
        return line.split()
    cells = _unquoted(line, delimiter) if '"' in line else line.split(delimiter)
    if len(cells) > 1 and len(cells) != width and not cells[-1].strip():
        cells.pop()
    return cells


def _unquoted(line: str, delimiter: str) -> list[str]:
    import csv

    try:
        return next(csv.reader([line], delimiter=delimiter))
    except csv.Error:  # a cell of more than 128 kB: a quote that was never closed
        return line.split(delimiter)


def _number(cell: str, decimal: str) -> float | None:
    """Return a cell as number, NaN for a missing one, None for what is neither."""
    text = cell.strip()
    if decimal != '.':
        if '.' in text:
            return None
        text = text.replace(decimal, '.')
    try:
        # float() takes 1_000 too, which no logger writes.
        return float(text) if '_' not in text else None
    except ValueError:
        return float('nan') if text.casefold() in _MISSING else None


def _is_numeric(cells: list[str], decimal: str) -> bool:
    """Tell whether cells are numbers, apart from missing ones."""
    values = [_number(cell, decimal) for cell in cells]
    return None not in values and any(value == value for value in values)


def _delimiter(body: list[tuple[int, str]], decimal: str, file: str) -> str:
    """Return the delimiter that turns the most of the text into numbers."""
    step = max(1, len(body) // _SAMPLE_LINES)
    sample = [line for _, line in body[::step]]
    best, most = 'space', 0
    for delimiter in DELIMITERS:
        if delimiter == decimal:
            continue
        rows = [_cells(line, delimiter) for line in sample]
        count = sum(len(cells) for cells in rows if _is_numeric(cells, decimal))
        if count > most:
            best, most = delimiter, count
    if not most:
        other = '.' if decimal == ',' else ','
        raise UserError(
            f'{file}: no line of numbers found; if the decimal sign is {other!r}, say so in '
            'options.decimal'
        )
    return best


def _begin(rows: list[tuple[int, list[str]]], decimal: str, file: str) -> tuple[int, int]:
    """Return the place of the first row of data, and how many cells the rows have."""
    widths = Counter(len(cells) for _, cells in rows if _is_numeric(cells, decimal))
    if not widths:
        raise UserError(f'{file}: no line of numbers found with this delimiter and decimal sign')
    width = max(widths, key=lambda cells: (widths[cells] * cells, cells))
    for place, (_, cells) in enumerate(rows):
        if len(cells) == width and _is_numeric(cells, decimal):
            return place, width
    raise AssertionError('a width that was counted is there')


def _header(rows: list[tuple[int, list[str]]], begin: int, width: int) -> list[str] | None:
    """
    Return the names of the columns: the line before the data, or the one before its units.

    Where a line begins with `Name`, as the first of several that describe each channel, it is that: a
    column headed `Name` has the times of the channel beside it.
    """
    for _, cells in rows[:begin]:
        if len(cells) == width > 1 and cells[0].strip() == 'Name':
            return [
                f'{cells[place + 1].strip()} time'
                if cell.strip() == 'Name' and place + 1 < width
                else cell
                for place, cell in enumerate(cells)
            ]
    for _, cells in reversed(rows[:begin]):
        if len(cells) == width:
            return cells
    return None


def _numbers(rows: list[tuple[int, list[str]]], width: int, decimal: str, file: str) -> Table:
    """Return the rows as numbers; report those that do not fit."""
    values = np.full((len(rows), width), np.nan)
    numbers = np.array([number for number, _ in rows], np.int64)
    whole = np.ones(len(rows), bool)
    bad: dict[int, list[int]] = {}
    for row, (_, cells) in enumerate(rows):
        if len(cells) != width:
            whole[row] = False
            continue
        for place, cell in enumerate(cells):
            value = _number(cell, decimal)
            if value is None:
                bad.setdefault(place, []).append(row)
            else:
                values[row, place] = value
    findings = []

    def place_of(row: int) -> str:
        return f'{file}, line {numbers[row]}'

    broken = np.flatnonzero(~whole)
    if len(broken):
        count = len(rows[broken[0]][1])
        reason = f'{count} cells instead of {width} (cut off, or another part of the file)'
        findings.append(Finding(rows_text(broken, place_of), reason))
    for place, where in sorted(bad.items()):
        cell = rows[where[0]][1][place].strip()[:20]
        reason = f'{cell!r} in column {place + 1} is no number'
        findings.append(Finding(rows_text(np.array(where), place_of), reason))
    sample = np.flatnonzero(whole)
    return Table(file, [], values[whole], 'line', numbers[whole], sample, findings)
