# SPDX-License-Identifier: Apache-2.0
"""
Logs as text: plain CSV, PMAC gather tables, exports of a drive's scope.

The header of such files depends on program and version, so none is relied on: data begin at the
first line that is numbers only, as many as the most lines have; the line before names the columns
if it has as many cells. A line that does not fit is left out, and reported with its number.
"""

from __future__ import annotations

import codecs
import gzip
import zlib
from collections import Counter
from collections.abc import Mapping
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
    delimiter = options.get('delimiter') or _delimiter(body, decimal, file)
    rows = [(number, _cells(line, delimiter)) for number, line in body]
    begin, width = _begin(rows, decimal, file)
    header = _header(rows, begin, width)
    if header is None and skipped:
        cells = _cells(lines[skipped - 1].lstrip(comment or ''), delimiter)
        header = cells if len(cells) == width else None
    table = _numbers(rows[begin:], width, decimal, file)
    if not last_is_whole and len(table.values) and table.number[-1] == len(lines):
        table.findings.append(
            Finding(
                table.place_of()(-1), 'the last line has no end; it may be cut off in a number'
            )
        )
        table.values, table.number = table.values[:-1], table.number[:-1]
        table.sample = table.sample[:-1]
    table.names = [cell.strip() for cell in header] if header else [''] * width
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


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; an empty one behind the last delimiter is none."""
    if delimiter == 'space':
        return line.split()
    if '"' in line:
        cells = _unquoted(line, delimiter)
    else:
        cells = line.split(delimiter)
    if len(cells) > 1 and not cells[-1].strip():
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
    """Return the names of the columns: the line before the data, or the one before its units."""
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
