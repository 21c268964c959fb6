# SPDX-License-Identifier: Apache-2.0
"""
Figures of a recording or an imported log: step response and following error of each axis.

Delay, rise, peak, overshoot, peak time and settling (5 %) are those of chapter 4 of the thesis and
count from the step. With --rise main-peak the rise ends at the arrival that leads to the highest
peak, as in chapter 6 for Y-Linear.

Of a recorded run also what the parts of the machine had to bear, beside the range in which the model
holds (docs/mechanism.md), and when it first left it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console
from waferbot_twin.metrics import FIGURES, RISE_RULES, rms
from waferbot_twin.models import recorded_titles
from waferbot_twin.plain_values import significant
from waferbot_twin.recording.reader import header_of
from waferbot_twin.response import AxisResponse
from waferbot_twin.response_reader import load_responses
from waferbot_twin.titles import with_titles
from waferbot_twin.validity import recorded_validity

EXAMPLES = (
    'waferbot metrics runs/step',
    'waferbot metrics runs/step --rise main-peak --json',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot metrics`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording folder or .mcap file'
    )
    parser.add_argument('--rise', choices=RISE_RULES, default='first', help='default: first')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read the recording and print its figures."""
    with progress_bar(f'reading {options.recording.name}') as progress:
        responses = load_responses(options.recording, progress)
    result = {response.axis: figures(response, options.rise) for response in responses}
    bearing = recorded_validity(options.recording)
    if options.json:
        print_json({**result, 'loads': bearing})
        return 0
    titles = recorded_titles(header_of(options.recording))
    table = new_table(
        'figure', *(f'{titles[axis]} [{row["unit"]}]' for axis, row in result.items())
    )
    names = {
        'step': 'step',
        **{key: f'{name.lower()}{_unit(key)}' for key, name in FIGURES.items()},
        'rms_following_error': 'RMS following error',
        'peak_following_error': 'peak following error',
        'peak_current': 'peak current [A]',
    }
    for key, name in names.items():
        table.add_row(name, *(significant(row.get(key)) for row in result.values()))
    result_console.print(table)
    if bearing:
        result_console.print(load_table(bearing, titles))
    return 0


def load_table(bearing: list[dict[str, Any]], titles: Mapping[str, str]) -> Table:
    """Return what parts had to bear, nearest to its limit or farthest beyond, as a table."""
    table = new_table('part', 'worst', 'at [s]', 'range', 'left at [s]')
    for row in bearing:
        table.add_row(
            f'{with_titles(row["place"], titles)}: {row["what"]}',
            f'{significant(row["worst"])} {row["unit"]}',
            f'{row["worst_s"]:.3f}',
            row['limits'],
            '' if row['first_s'] is None else f'{row["first_s"]:.3f}',
        )
    return table


def figures(response: AxisResponse, rise: str) -> dict[str, Any]:
    """Return the figures of one axis; those of a step only if there is one, None for what lacks."""
    metrics = response.metrics(rise)
    return {
        'unit': response.unit,
        **(asdict(metrics) if metrics else {}),
        'rms_following_error': rms(response.following_error)
        if len(response.following_error)
        else None,
        'peak_following_error': _peak(response.following_error),
        'peak_current': _peak(response.current),
    }


def _peak(values: np.ndarray) -> float | None:
    """Return the largest absolute value; None of none, as a PMAC that is not ours reports nothing."""
    return float(np.max(np.abs(values))) if len(values) else None


def _unit(figure: str) -> str:
    return ' [s]' if figure.endswith('time') else ' [%]' if figure.endswith('percent') else ''
