# SPDX-License-Identifier: Apache-2.0
"""Columns as they stand in a log: numbers, and where each of them is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.logs.findings import Finding


@dataclass(frozen=True, eq=False)
class Column:
    """
    One column: `value` is NaN where the log has no number.

    `number` says where each value is, as `noun` of `file` (line 17, message 3). `sample` counts the
    samples from 0, also those that were left out because their line is broken. `time_s` are times
    that the values bring along (messages), None if they have to come from another column.
    """

    value: NDArray[np.float64]
    file: str
    noun: str
    number: NDArray[np.int64]
    sample: NDArray[np.int64]
    time_s: NDArray[np.float64] | None = None

    def place(self, row: int) -> str:
        """Return where the value of a row is."""
        return f'{self.file}, {self.noun} {self.number[row]}'


class Columns(Protocol):
    """A log from which columns can be taken."""

    findings: list[Finding]

    def column(self, name: str | int) -> Column:
        """Return a column; raises `UserError` if there is none of that name or number."""


@dataclass
class Table:
    """A log whose columns are equally long: `values` (rows, columns); `names` may be empty texts."""

    file: str
    names: list[str]
    values: NDArray[np.float64]
    noun: str
    number: NDArray[np.int64]
    sample: NDArray[np.int64]
    findings: list[Finding] = field(default_factory=list)

    def column(self, name: str | int) -> Column:
        """Return a column by its name in the header, or by its number from 1."""
        place = self._place(name)
        return Column(self.values[:, place], self.file, self.noun, self.number, self.sample)

    def place_of(self) -> Callable[[int], str]:
        """Return the function that says where a row is."""
        return lambda row: f'{self.file}, {self.noun} {self.number[row]}'

    def _place(self, name: str | int) -> int:
        count = self.values.shape[1]
        if isinstance(name, int):
            if name > count:
                raise UserError(f'{self.file}: has no column {name}; it has {count}')
            return name - 1
        wanted = name.strip()
        if wanted in self.names:
            if self.names.count(wanted) > 1:
                raise UserError(
                    f'{self.file}: {self.names.count(wanted)} columns are called {wanted!r}; '
                    'give the number, from 1'
                )
            return self.names.index(wanted)
        folded = [known.casefold() for known in self.names]
        if folded.count(wanted.casefold()) == 1:
            return folded.index(wanted.casefold())
        known = [text for text in self.names if text]
        listed = (
            ', '.join(map(repr, known)) if known else 'none has a name; give the number, from 1'
        )
        raise UserError(
            f'{self.file}: has no column {name!r}{did_you_mean(wanted, known)} '
            f'({count} columns: {listed})'
        )
