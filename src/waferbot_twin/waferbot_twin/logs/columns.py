# SPDX-License-Identifier: Apache-2.0
"""Columns as they stand in a log: numbers, and where each of them is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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


@dataclass(frozen=True)
class Where:
    """Which rows of a table belong to a signal: those in which `column` says `text`."""

    column: str | int
    text: str


class Columns(Protocol):
    """A log from which columns can be taken."""

    findings: list[Finding]

    def column(self, name: str | int) -> Column:
        """Return a column; raises `UserError` if there is none of that name or number."""


@dataclass
class Table:
    """
    A log whose columns are equally long: `values` (rows, columns); `names` may be empty texts.

    `texts` has the cells of columns that say which signal a row is of, by the place of the column.
    `time_s` are the times of the rows if the log says them elsewhere than in a column.
    """

    file: str
    names: list[str]
    values: NDArray[np.float64]
    noun: str
    number: NDArray[np.int64]
    sample: NDArray[np.int64]
    findings: list[Finding] = field(default_factory=list)
    texts: Mapping[int, Sequence[str]] = field(default_factory=dict)
    time_s: NDArray[np.float64] | None = None

    def column(self, name: str | int) -> Column:
        """Return a column by its name in the header, or by its number from 1."""
        values = self.values[:, self.place(name)]
        return Column(values, self.file, self.noun, self.number, self.sample, self.time_s)

    def rows(self, keep: NDArray[np.bool_] | slice) -> Table:
        """Return some of the rows."""
        return replace(
            self,
            values=self.values[keep],
            number=self.number[keep],
            sample=self.sample[keep],
            texts={place: list(np.asarray(cells)[keep]) for place, cells in self.texts.items()},
            time_s=None if self.time_s is None else self.time_s[keep],
        )

    def where(self, choice: Where) -> Table:
        """
        Return the rows in which a column says something: a text, or a number of the same value.

        Samples are counted anew. Raises `UserError` if there is no such row.
        """
        place = self.place(choice.column)
        cells = self.texts.get(place, [])
        keep = np.array([_same(cell, choice.text) for cell in cells], np.bool_)
        if not keep.any():
            known = sorted({cell.strip() for cell in cells})
            raise UserError(
                f'{self.file}: no row has {choice.text!r} in column {choice.column!r} '
                f'(there: {", ".join(known[:12]) or "no text"})'
            )
        chosen = self.rows(keep)
        return replace(chosen, sample=np.arange(len(chosen.number)))

    def place_of(self) -> Callable[[int], str]:
        """Return the function that says where a row is."""
        return lambda row: f'{self.file}, {self.noun} {self.number[row]}'

    def place(self, name: str | int) -> int:
        """Return the place of a column, from 0; raises `UserError` if there is none."""
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


def _same(cell: str, text: str) -> bool:
    """Tell whether a cell says a text; 1.0 says 1."""
    if cell.strip() == text:
        return True
    try:
        return float(cell) == float(text)
    except ValueError:
        return False
