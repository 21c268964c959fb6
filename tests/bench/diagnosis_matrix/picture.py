# SPDX-License-Identifier: Apache-2.0
"""One picture of the matrix: detection by size, what became of each group, errors, confusions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np

from diagnosis_matrix.cases import GROUPS
from diagnosis_matrix.summary import LARGEST_ERROR, NAMED

RIGHT, NEAR, WRONG, SILENT = '#1f7a4d', '#8bc34a', '#b3261e', '#9e9e9e'
COLOURS = {
    'group': NEAR, 'twin': NEAR, 'later': NEAR, 'one': NEAR, 'some': NEAR,
    'missed': SILENT, 'none': SILENT, 'unexplained': '#c46a1b', 'withdrawn': '#e0a030',
}  # fmt: skip
SHOWN = 18
"""How many confusions and parameters fit."""

LONGEST = 84
"""Characters that fit beside a confusion."""


def draw(found: dict[str, Any], path: Path) -> None:
    """Write the picture."""
    figure, panels = plt.subplots(2, 2, figsize=(15.0, 11.0), layout='constrained')
    _detection(panels[0][0], found)
    _groups(panels[0][1], found)
    _errors(panels[1][0], found)
    _confusions(panels[1][1], found)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _detection(panel: Any, found: dict[str, Any]) -> None:
    for key, colour, label in (('named', RIGHT, 'named right'), ('seen', SILENT, 'seen at all')):
        rows = [row for row in found['detection'] if row['size'] is not None]
        size = np.array([row['size'] for row in rows])
        middle = np.array([100.0 * row[key]['share'] for row in rows])
        low = np.array([100.0 * row[key]['low95'] for row in rows])
        high = np.array([100.0 * row[key]['high95'] for row in rows])
        spread = np.maximum(0.0, np.array([middle - low, high - middle]).reshape(2, -1))
        panel.errorbar(size, middle, spread, color=colour, marker='o', capsize=3, label=label)
    for size, aim in ((3.0, 91.0), (10.0, 98.0)):
        panel.plot(size, aim, marker='_', ms=22, mew=2, color='black')
    panel.plot([], [], marker='_', ms=12, mew=2, color='black', ls='', label='aim')
    panel.set_xscale('log')
    panel.xaxis.set_major_formatter('{x:g}')
    panel.xaxis.set_minor_formatter('')
    panel.set_ylim(0.0, 103.0)
    panel.set_xlabel('size: RMS change over the smallest that any test could detect')
    panel.set_ylabel('single effects [%], 95 % intervals')
    panel.set_title('Detection')
    panel.grid(alpha=0.3)
    panel.legend(loc='lower right')


def _groups(panel: Any, found: dict[str, Any]) -> None:
    names = [name for name in GROUPS if found['groups'][name]['right']['cases']]
    for row, name in enumerate(names):
        group = found['groups'][name]
        cases, left = group['right']['cases'], 0.0
        named = NAMED[GROUPS[name].kind]
        ordered = sorted(group['outcomes'].items(), key=lambda item: item[0] not in named)
        for outcome, count in ordered:
            width = 100.0 * count / cases
            colour = COLOURS.get(outcome, RIGHT if outcome in named else WRONG)
            panel.barh(row, width, left=left, color=colour, edgecolor='white')
            if width > 7.0:
                panel.text(
                    left + 0.5 * width, row, f'{outcome}\n{count}', ha='center', va='center',
                    fontsize=8, color='white',
                )  # fmt: skip
            left += width
    panel.set_yticks(range(len(names)), names)
    panel.invert_yaxis()
    panel.set_xlim(0.0, 100.0)
    panel.set_xlabel('cases [%]')
    panel.set_title('What became of them')


def _errors(panel: Any, found: dict[str, Any]) -> None:
    rows = [row for row in found['parameters'] if row['median_error'] is not None]
    rows = sorted(rows, key=lambda row: -row['median_error'] / LARGEST_ERROR[row['kind']])[:SHOWN]
    for place, row in enumerate(rows):
        limit = LARGEST_ERROR[row['kind']]
        ratio = max(row['median_error'] / limit, 1e-3)
        panel.barh(place, ratio, color=RIGHT if ratio <= 1.0 else WRONG)
    labels = [f'{row["effect"]}: {row["parameter"]} ({row["cases"]})' for row in rows]
    panel.set_yticks(range(len(rows)), labels, fontsize=8)
    panel.invert_yaxis()
    panel.axvline(1.0, color='black', lw=1.0)
    panel.set_xscale('log')
    panel.xaxis.set_major_formatter('{x:g}')
    panel.xaxis.set_minor_formatter('')
    panel.set_xlabel('median error over the aim (in parentheses: cases)')
    panel.set_title('Parameters at 10 x: the largest errors')


def _confusions(panel: Any, found: dict[str, Any]) -> None:
    rows = found['confusions'][:SHOWN]
    panel.barh(range(len(rows)), [row['cases'] for row in rows], color='#f0c4bf')
    for place, row in enumerate(rows):
        text = f'{row["group"]}: {row["truth"]}  →  {row["reported"]}'
        panel.text(
            0.02, place, text if len(text) <= LONGEST else text[: LONGEST - 1] + '…',
            va='center', fontsize=8, transform=panel.get_yaxis_transform(),
        ).set_in_layout(False)  # fmt: skip
    panel.set_yticks([])
    panel.invert_yaxis()
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.set_xlabel('cases')
    panel.set_title('Not right: hidden → reported')
