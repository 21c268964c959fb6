# SPDX-License-Identifier: Apache-2.0
"""
Logs as Apache Parquet, read by `pyarrow`, which is not among what waferbot needs otherwise.

Columns have the names of the file. One of instants is taken in s since 1970, one of durations in s.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.logs.columns import Table
from waferbot_twin.logs.isolated import isolated

_PER_SECOND = {'s': 1.0, 'ms': 1e3, 'us': 1e6, 'ns': 1e9}


def read_parquet(path: Path) -> Table:
    """Read a Parquet file; raises `UserError` if it is none, or if `pyarrow` is not installed."""
    if find_spec('pyarrow') is None:
        raise UserError(
            f'{path}: to read Parquet, install pyarrow: pip install pyarrow '
            '(or export the log as CSV)'
        )
    import pyarrow.parquet  # noqa: F401  here, so that the process that reads need not

    try:
        columns: dict[str, Any] = isolated(lambda: _columns(path))
    # pyarrow raises many kinds of errors on a broken file.
    except Exception as error:
        raise UserError(f'{path}: is no readable Parquet file ({error})') from None
    if not columns:
        raise UserError(f'{path}: has no column of numbers')
    count = len(next(iter(columns.values())))
    values = np.full((count, len(columns)), np.nan)
    texts: dict[int, list[str]] = {}
    for place, column in enumerate(columns.values()):
        if isinstance(column, list):
            texts[place] = column
        else:
            values[:, place] = column
    number = np.arange(1, count + 1)
    return Table(str(path), list(columns), values, 'row', number, number - 1, [], texts)


def _columns(path: Path) -> dict[str, Any]:
    """Return the columns of numbers as arrays, those of texts as lists."""
    import pyarrow
    import pyarrow.parquet

    # Threads do not go well with a process that was forked.
    table = pyarrow.parquet.read_table(path, use_threads=False, pre_buffer=False)
    found: dict[str, Any] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = column.type
        if pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind):
            whole = column.cast(pyarrow.int64()).to_numpy(zero_copy_only=False)
            found[name] = np.asarray(whole, float) / _PER_SECOND[kind.unit]
        elif (
            pyarrow.types.is_integer(kind)
            or pyarrow.types.is_floating(kind)
            or pyarrow.types.is_boolean(kind)
        ):
            found[name] = np.asarray(column.to_numpy(zero_copy_only=False), float)
        elif pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
            found[name] = ['' if cell is None else cell for cell in column.to_pylist()]
    return found
