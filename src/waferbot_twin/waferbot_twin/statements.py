# SPDX-License-Identifier: Apache-2.0
"""
The statements of the thesis about its curves, each measured on our runs: met or not met.

`thesis_statements.yaml` has them, with where the text says it and limits that come from its words and
digits. A statement is met if the measured value is within its limits; one that cannot be measured (no
such peak, no such line) is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import yaml

from waferbot_lockstep.package_data import package_data
from waferbot_twin.plain_values import significant
from waferbot_twin.statement_quantities import Measured, meaning, measure
from waferbot_twin.step_runs import Runs

_STATEMENTS = package_data('waferbot_twin', 'thesis_statements.yaml')


@dataclass(frozen=True)
class Statement:
    """
    One statement: where it is said, what is measured of which runs, between which limits.

    `says` is in our words; `because` says how the limits follow from the text's.
    """

    name: str
    chapter: int
    figure: str
    section: str
    says: str
    quantity: str
    about: dict[str, Any]
    limits: dict[str, float]
    because: str

    @property
    def least(self) -> float:
        """The lower limit, minus infinity without one."""
        return float(self.limits.get('least', -math.inf))

    @property
    def most(self) -> float:
        """The upper limit, infinity without one."""
        return float(self.limits.get('most', math.inf))

    @property
    def place(self) -> str:
        """Where the text says it."""
        return f'chapter {self.chapter}, {self.section}'

    @property
    def demanded(self) -> str:
        """The limits as text."""
        if self.least == self.most:
            return f'{self.least:g}'
        if math.isinf(self.most):
            return f'>= {self.least:g}'
        if math.isinf(self.least):
            return f'<= {self.most:g}'
        return f'{self.least:g} to {self.most:g}'

    def admits(self, value: float) -> bool:
        """Return whether a value is within the limits; nothing that is not a number is."""
        return self.least <= value <= self.most


@dataclass(frozen=True)
class Finding:
    """A statement and what was measured of it."""

    statement: Statement
    measured: Measured

    @property
    def met(self) -> bool:
        """Whether our runs do what the text says."""
        return self.statement.admits(self.measured.value)

    @property
    def means(self) -> str:
        """What is measured, in words."""
        return meaning(self.statement.quantity)

    @property
    def value_text(self) -> str:
        """The value with its unit."""
        if math.isnan(self.measured.value):
            return 'there is none'
        return f'{significant(self.measured.value)} {self.measured.unit}'.strip()

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        said = self.statement
        return {
            'name': said.name,
            'chapter': said.chapter,
            'figure': said.figure,
            'section': said.section,
            'says': said.says,
            'quantity': said.quantity,
            'means': self.means,
            'about': said.about,
            'limits': said.limits,
            'because': said.because,
            'value': self.measured.value,
            'unit': self.measured.unit,
            'met': self.met,
        }


@cache
def statements() -> tuple[Statement, ...]:
    """Return all statements, in the order of the text's figures."""
    entries = yaml.safe_load(_STATEMENTS.read_text('utf-8'))
    found = [Statement(**entry) for entry in entries]
    return tuple(sorted(found, key=lambda said: [int(part) for part in said.figure.split('.')]))


def findings(runs: Runs) -> list[Finding]:
    """Measure every statement on the runs."""
    return [Finding(said, measure(said.quantity, runs, said.about)) for said in statements()]
