# SPDX-License-Identifier: Apache-2.0
"""
What is known of a parameter of a type of part: its range over machines and time, and a prior from it.

The range goes from the lowest to the highest end of an interval, or value where there is none. A prior
is the range, stretched by `STRETCH` of its width (of the value, where there is one value alone) to each
side: the next machine may lie a little outside of what was seen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import pandas as pd

from waferbot_lockstep.errors import UserError
from waferbot_twin.html_page import save_drawing
from waferbot_twin.identification.named_parameters import NamedParameter
from waferbot_twin.library.entries import Entry
from waferbot_twin.library.from_report import parameter_of, part_of

STRETCH = 0.5


def ends_of(entry: Entry) -> tuple[float, float]:
    """Return the interval of an entry, its value twice if it has none."""
    low = entry.value if math.isnan(entry.low) else entry.low
    high = entry.value if math.isnan(entry.high) else entry.high
    return min(low, entry.value), max(high, entry.value)


def table(entries: Sequence[Entry]) -> pd.DataFrame:
    """
    Return a row for each part, parameter and unit: `low`, `median`, `high`, `entries`, `machines`.

    In the order in which they came first: a friction is one thing in N and another in Nm.
    """
    rows = []
    for (part, parameter, unit), group in _groups(entries).items():
        ends = [ends_of(entry) for entry in group]
        rows.append(
            {
                'part': part,
                'parameter': parameter,
                'low': min(low for low, _ in ends),
                'median': float(pd.Series([entry.value for entry in group]).median()),
                'high': max(high for _, high in ends),
                'unit': unit,
                'entries': len(group),
                'machines': len({entry.machine for entry in group}),
            }
        )
    columns = ['part', 'parameter', 'low', 'median', 'high', 'unit', 'entries', 'machines']
    return pd.DataFrame(rows, columns=columns)


def _groups(entries: Sequence[Entry]) -> dict[tuple[str, str, str], list[Entry]]:
    """Return the entries of each part, parameter and unit, in the order in which they came first."""
    groups: dict[tuple[str, str, str], list[Entry]] = {}
    for entry in entries:
        groups.setdefault((entry.part, entry.parameter, entry.unit), []).append(entry)
    return groups


def entries_of(entries: Sequence[Entry], parameter: NamedParameter) -> list[Entry]:
    """
    Return what is known of a parameter of a model.

    Entries of the same path alone if there are some, else those of the same part, parameter and unit.
    """
    return [entry for entry in entries if entry.path == parameter.path] or [
        entry
        for entry in entries
        if entry.part == part_of(parameter.path)
        and entry.parameter == parameter_of(parameter.path)
        and entry.unit == parameter.unit
    ]


def seen(entries: Sequence[Entry], parameter: NamedParameter) -> tuple[float, float] | None:
    """Return the range of a parameter of a model over machines and time; None if nothing is known."""
    known = entries_of(entries, parameter)
    if not known:
        return None
    return min(ends_of(entry)[0] for entry in known), max(ends_of(entry)[1] for entry in known)


def prior(entries: Sequence[Entry], parameter: NamedParameter) -> tuple[float, float] | None:
    """
    Return the range in which a parameter of a model is to be expected; None if nothing is known.

    Known is what `entries_of` says. The model's value is in the range, and the parameter's own bounds
    hold.
    """
    known = seen(entries, parameter)
    if known is None:
        return None
    low, high = known
    reach = STRETCH * ((high - low) or abs(high))
    low, high = (low - reach if low <= reach else low / (1.0 + STRETCH)), high + reach
    low, high = min(low, parameter.start), max(high, parameter.start)
    return max(low, parameter.low), min(high, parameter.high)


def draw(entries: Sequence[Entry], file: Path) -> None:
    """Draw every entry with its interval, in a panel for each parameter; raises `UserError` if none."""
    if not entries:
        raise UserError('there is nothing to draw')
    groups = _groups(entries)
    figure, panels = plt.subplots(
        len(groups), 1, figsize=(8.0, 0.9 * len(groups) + 0.42 * len(entries)), squeeze=False,
        height_ratios=[1.0 + len(group) for group in groups.values()],
    )  # fmt: skip
    for panel, ((part, parameter, unit), group) in zip(panels[:, 0], groups.items(), strict=True):
        for place, entry in enumerate(group):
            low, high = ends_of(entry)
            panel.plot([low, high], [place, place], color='#1f5fa8', lw=2.0)
            panel.plot([entry.value], [place], 'o', color='#1f5fa8')
        labels = [f'{entry.machine} {entry.date}'.strip() for entry in group]
        panel.set_yticks(range(len(group)), labels, fontsize=8)
        panel.set_ylim(len(group) - 0.5, -0.5)
        panel.set_xlim(left=min(0.0, *(ends_of(entry)[0] for entry in group)))
        panel.set_title(f'{part}: {parameter}{f" [{unit}]" if unit else ""}', fontsize=9)
        panel.grid(alpha=0.3, axis='x')
    figure.tight_layout()
    save_drawing(figure, file)
