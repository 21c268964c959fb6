# SPDX-License-Identifier: Apache-2.0
"""What the thesis printed, read from `thesis_tables.yaml`, and which of it this model does not meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import yaml

from waferbot_lockstep.package_data import package_data
from waferbot_twin.metrics import FIGURES

_TABLES = package_data('waferbot_twin', 'thesis_tables.yaml')
_DEVIATIONS = package_data('waferbot_twin', 'known_deviations.yaml')


@dataclass(frozen=True)
class Tolerance:
    """How far ours may be from the thesis: a share of its value, or an amount in its unit."""

    amount: float
    relative: bool

    def width(self, thesis: float) -> float:
        """Return the allowed distance from a value of the thesis, in its unit."""
        return abs(thesis) * self.amount if self.relative else self.amount

    def admits(self, thesis: float, ours: float) -> bool:
        """Return whether `ours` is near enough; nothing that is not a number is."""
        return abs(ours - thesis) <= self.width(thesis)


def tolerance(column: str, figure: str) -> Tolerance:
    """
    Return the tolerance of a figure of a step in a column: rigid, flexible or measured.

    5 % in the rigid columns (2 percentage points of overshoot), 10 % in the others.
    """
    if column == 'rigid':
        overshoot = figure == 'overshoot_percent'
        return Tolerance(2.0, relative=False) if overshoot else Tolerance(0.05, relative=True)
    return Tolerance(0.10, relative=True)


RMS_TOLERANCE = Tolerance(0.15, relative=True)
"""Of an RMS error (4.2): it sums what all the figures of two curves, 5 and 10 % each, are off by."""

UNCHANGED_PERCENT = 10.0
"""Largest improvement that stands for a printed zero: `do not change`, a tenth as in all statements."""

SIGNIFICANTLY = 1.2
"""What chapter 4 calls significantly more: by more than the 20 % that it calls agreement."""


def improvement_admits(printed_percent: float, ours_percent: float) -> bool:
    """
    Return whether an improvement (6.1) of a figure is that of the thesis: better, worse or unchanged.

    Its size is a quotient of two differences that may both be small, each held by a row of its own; so
    the sign is demanded, and where zero is printed no more than `UNCHANGED_PERCENT` either way.
    """
    if printed_percent == 0.0:
        return abs(ours_percent) <= UNCHANGED_PERCENT
    return ours_percent * printed_percent > 0.0


def run_time_admits(model: str, ratio: float, flexible_ratio: float) -> bool:
    """
    Return whether a model takes its time as chapter 6 says; times over that of the rigid model.

    Flexible components significantly increase it, and the simplified model takes it back in part.
    The ratios themselves are those of a solver that takes smaller steps where a model is stiffer.
    """
    if model == 'flexible':
        return ratio > SIGNIFICANTLY
    return 1.0 < ratio < flexible_ratio


@cache
def thesis() -> dict[str, Any]:
    """Return everything printed, as in the file."""
    return yaml.safe_load(_TABLES.read_text('utf-8'))


@cache
def known_deviations() -> dict[str, dict[str, Any]]:
    """
    Return what this model is known not to meet: row (`axis.column.figure`) to why and how far.

    `percent` is how far, `reason` why; the tests hold it to no more than that.
    """
    return yaml.safe_load(_DEVIATIONS.read_text('utf-8')) or {}


def printed(axis: str, column: str, figure: str) -> float:
    """
    Return a figure of the thesis: corrected where it is a misprint.

    The flexible column of the thesis rounds the peak to two digits; it is taken from the overshoot.
    """
    steps = thesis()['steps'][axis]
    if column == 'flexible' and figure == 'peak':
        return steps['step'] * (1.0 + steps[column]['overshoot_percent']['printed'] / 100.0)
    entry = steps[column][figure]
    return float(entry.get('corrected', entry['printed']))


def rows() -> list[tuple[str, str, str]]:
    """Return (axis, column, figure) of every figure of a step that the thesis prints."""
    return [
        (axis, column, figure)
        for axis in thesis()['steps']
        for column in ('rigid', 'flexible', 'measured')
        for figure in FIGURES
    ]
