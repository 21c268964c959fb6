# SPDX-License-Identifier: Apache-2.0
"""Files of a sizing: force over speed of every motor, the share of its limit that each part bears."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from waferbot_twin.html_page import save_picture, set_title
from waferbot_twin.plain_values import finite
from waferbot_twin.sweep.sizing import Duty, Row, Sizing, largest_shares

FILES = ('sizing.json', 'sizing.png')

BOUND = 300.0
"""Percent at which a bar ends: a winding without a steady temperature has no end."""


def as_dict(sizing: Sizing) -> dict[str, Any]:
    """Return the rows as plain values, and the parts that are above their limit."""
    above = [part for part, share in largest_shares(sizing.rows).items() if share > 1.0]
    return {'rows': [dict(finite(asdict(row))) for row in sizing.rows], 'above': above}


def write(sizing: Sizing, title: str, titles: Mapping[str, str], folder: Path) -> None:
    """Write `FILES`; `titles` are those of the axes."""
    (folder / FILES[0]).write_text(json.dumps(as_dict(sizing), indent=2) + '\n', 'utf-8')
    rows = [row for row in sizing.rows if math.isfinite(row.share) or math.isinf(row.share)]
    panels = max(len(sizing.duties), 1)
    figure = plt.figure(figsize=(max(4.0 * panels, 8.0), 4.0 + 0.3 * len(rows)))
    grid = figure.add_gridspec(2, panels, height_ratios=(3.4, 0.3 * max(len(rows), 1)))
    for place, duty in enumerate(sizing.duties):
        _draw_duty(figure.add_subplot(grid[0, place]), duty, titles.get(duty.axis, duty.axis))
    _draw_shares(figure.add_subplot(grid[1, :]), rows, titles)
    set_title(figure, title)
    save_picture(figure, folder / FILES[1])


def _draw_duty(panel: Axes, duty: Duty, title: str) -> None:
    """Draw force over speed, with what the drive makes for a while and for long."""
    levels = (
        (duty.peak, 'tab:red', '-', 'drive, peak'),
        (duty.continuous, 'tab:red', '--', 'drive, continuous'),
        (duty.effective, 'tab:green', ':', 'RMS of the duty cycle'),
    )
    for level, colour, style, label in levels:
        panel.axhline(level, color=colour, linestyle=style, linewidth=1.2, label=label)
        panel.axhline(-level, color=colour, linestyle=style, linewidth=1.2)
    panel.plot(duty.speed, duty.force, color='tab:blue', linewidth=0.7, label='duty cycle')
    panel.set_title(title, fontsize=10)
    panel.set_xlabel(f'speed of the axis, {duty.speed_unit}')
    what = 'torque' if duty.unit == 'Nm' else 'force'
    panel.set_ylabel(f'{what} of the motor, {duty.unit}')
    panel.legend(fontsize=7)


def _draw_shares(panel: Axes, rows: Sequence[Row], titles: Mapping[str, str]) -> None:
    """Draw the share of its limit that each amount takes, in percent."""
    percent = [min(100.0 * row.share, BOUND) for row in rows]
    names = [f'{titles.get(row.part, row.part.replace("_", " "))}: {row.what}' for row in rows]
    colours = ['tab:red' if row.share > 1.0 else 'tab:blue' for row in rows]
    panel.barh(names, percent, color=colours)
    for place, row in enumerate(rows):
        said = f'{100.0 * row.share:.0f} %' if math.isfinite(row.share) else 'no end'
        panel.text(percent[place], place, f' {said}', va='center', fontsize=8)
    panel.axvline(100.0, color='black', linewidth=1.0)
    panel.set_xlim(0.0, 1.1 * max(100.0, *percent))
    panel.invert_yaxis()
    panel.set_xlabel('share of the limit, %')
    panel.tick_params(axis='y', labelsize=8)
