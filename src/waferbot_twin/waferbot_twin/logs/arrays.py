# SPDX-License-Identifier: Apache-2.0
"""
Logs as arrays: NumPy's `.npy` and `.npz`, and MATLAB's `.mat` (up to version 7).

Columns of a plain `.npy` are numbered from 1, those of a structured one have names. In `.npz` and
`.mat` a column is written as in MATLAB, counted from 1: `position`, `data(:,3)`, `data(2,:)`,
`runs{2,12}`, `log.current`, and combinations of them.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy.io

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.logs.columns import Column, Table
from waferbot_twin.logs.findings import Finding
from waferbot_twin.logs.isolated import isolated

_STEP = re.compile(r'\.(\w+)|\{(\d+(?:,\d+)*)\}|\(([\d:]+(?:,[\d:]+)*)\)')


def read_npy(path: Path, samples_along: str | None) -> Table:
    """Read a `.npy`; samples run along its longer side if `samples_along` does not say."""
    try:
        with path.open('rb') as file:
            _check_size(file)
            array = np.lib.format.read_array(file, allow_pickle=False)
    # The header is a Python literal: NumPy passes on whatever its parser says of a broken one.
    except Exception as error:
        raise UserError(f'{path}: is no readable .npy file ({error})') from None
    names = list(array.dtype.names or ())
    if names:
        values = np.column_stack([np.ravel(array[name]).astype(float) for name in names])
    else:
        values = _numbers(array, str(path))
        if values.ndim == 1:
            values = values[:, None]
        if values.ndim != 2:
            raise UserError(f'{path}: has {values.ndim} dimensions; a log has two')
        longer = 'columns' if values.shape[1] > values.shape[0] else 'rows'
        if (samples_along or longer) == 'columns':
            values = values.T
    number = np.arange(1, len(values) + 1)
    return Table(str(path), names or [''] * values.shape[1], values, 'sample', number, number - 1)


def _check_size(file: BinaryIO) -> None:
    """
    Hold the size that the header of a `.npy` tells against that of the file, and rewind.

    Otherwise NumPy reserves memory for what the header says before it finds that it lies. Raises
    `ValueError`.
    """
    version = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, kind = read(file)
    told = kind.itemsize * math.prod(shape)
    there = os.fstat(file.fileno()).st_size - file.tell()
    if min(shape, default=0) < 0 or told > there:
        raise ValueError(f'its header tells of {told} bytes, but {there} are there')
    file.seek(0)


@dataclass
class Variables:
    """The variables of a `.npz` or `.mat` file."""

    file: str
    content: dict[str, Any]
    findings: list[Finding] = field(default_factory=list)

    def column(self, name: str | int) -> Column:
        """Return the vector that `name` stands for, in MATLAB's notation."""
        if isinstance(name, int):
            raise UserError(
                f'{self.file}: columns of such a file have names, not numbers ({name})'
            )
        text = name.replace(' ', '')
        match = re.match(r'\w+', text)
        variable = match.group(0) if match else text
        if variable not in self.content:
            known = ', '.join(self.content) or 'none'
            raise UserError(
                f'{self.file}: has no variable {variable!r}{did_you_mean(variable, self.content)} '
                f'(variables: {known})'
            )
        value = self.content[variable]
        rest = text[len(variable) :]
        while rest:
            match = _STEP.match(rest)
            if match is None:
                raise UserError(f'{self.file}: {name!r}: cannot read {rest!r}')
            value = self._part(value, match, name)
            rest = rest[match.end() :]
        vector = _numbers(np.asarray(value), f'{self.file}, {name}').squeeze()
        if vector.ndim == 0:
            vector = vector.reshape(1)
        if vector.ndim != 1:
            shape = ' x '.join(map(str, vector.shape))
            raise UserError(f'{self.file}: {name} is {shape}; say which column, as {name}(:,1)')
        where = f'{self.file}, {name}'
        sample = np.arange(len(vector))
        return Column(vector, where, 'sample', sample + 1, sample)

    def _part(self, value: Any, match: re.Match[str], name: str) -> Any:
        """Return a field, a cell or a slice of a value."""
        field_name, cell, places = match.groups()
        array = np.asarray(value)
        try:
            if field_name is not None:
                found = array[field_name]
                return found.ravel()[0] if found.dtype == object and found.size == 1 else found
            if cell is not None:
                if array.dtype != object:
                    raise UserError(f'{self.file}: {name}: is no cell array; write ( ) for {{ }}')
                index = [int(place) - 1 for place in cell.split(',')]
                return array.ravel('F')[index[0]] if len(index) == 1 else array[tuple(index)]
            slices = [slice(None) if p == ':' else int(p) - 1 for p in places.split(',')]
            return array[tuple(slices)]
        except (IndexError, ValueError):
            shape = ' x '.join(map(str, array.shape))
            raise UserError(f'{self.file}: {name}: {match.group(0)} is not in {shape}') from None


def read_variables(path: Path) -> Variables:
    """Read a `.npz` or `.mat` file; raises `UserError`."""
    try:
        if path.suffix == '.npz':
            with np.load(path, allow_pickle=False) as archive:
                return Variables(str(path), {name: archive[name] for name in archive.files})
        content = isolated(lambda: scipy.io.loadmat(path))
    except NotImplementedError:
        raise UserError(
            f'{path}: is a MATLAB 7.3 file (HDF5); save it in MATLAB with save(..., "-v7")'
        ) from None
    # scipy and zlib raise many kinds of errors on a broken file, and promise none of them.
    except Exception as error:
        raise UserError(f'{path}: is no readable {path.suffix} file ({error})') from None
    return Variables(
        str(path), {name: value for name, value in content.items() if not name.startswith('__')}
    )


def _numbers(array: np.ndarray, where: str) -> np.ndarray:
    """Return an array as floating point; raises `UserError` for what is no number."""
    if array.dtype.kind not in 'fiub':
        raise UserError(f'{where}: holds {array.dtype}, no real numbers')
    return array.astype(float)
