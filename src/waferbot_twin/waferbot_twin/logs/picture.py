# SPDX-License-Identifier: Apache-2.0
"""Picture of a measured log: what belongs together in one panel, an axis in each column."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt

from waferbot_twin.html_page import save_drawing, set_title
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.thinning import thinned_with_gaps

PANELS = (
    ('position', ('commanded_position', 'position')),
    ('motor position', ('motor_position',)),
    ('following error', ('following_error',)),
    ('velocity', ('velocity',)),
    ('current', ('current_command', 'current', 'direct_current')),
    ('drive command', ('drive_command',)),
    ('force', ('force',)),
    ('voltage', ('voltage_q', 'voltage')),
    ('temperature', ('temperature',)),
)

MOST_DRAWN = 8000
"""Samples of a line, an envelope if there are more: several for each column of the widest picture."""


def plot_log(log: MeasuredLog, file: Path) -> None:
    """Draw a log into an image file (`.png`, `.svg`, `.pdf`); lines are broken where it has gaps."""
    axes = log.axes()
    there = {signal.kind for signal in log.signals}
    rows = [(title, kinds) for title, kinds in PANELS if there.intersection(kinds)]
    figure, panels = plt.subplots(
        len(rows),
        len(axes),
        figsize=(max(7.0, 4.6 * len(axes)), 1.0 + 2.2 * len(rows)),
        sharex='col',
        squeeze=False,
    )
    for column, axis in enumerate(axes):
        for row, (title, kinds) in enumerate(rows):
            panel = panels[row][column]
            signals = [found for kind in kinds if (found := log.get(axis, kind))]
            for signal in signals:
                style = 'steps-post' if signal.held else 'default'
                time_s, value = thinned_with_gaps(signal.time_s, signal.value, MOST_DRAWN)
                label = signal.kind.replace('_', ' ')
                panel.plot(time_s, value, lw=0.9, drawstyle=style, label=label)
            if not signals:
                panel.axis('off')
                continue
            if len(signals) > 1:
                panel.legend(loc='upper right', fontsize=8)
            panel.set_ylabel(f'{title} [{signals[0].unit}]')
            panel.grid(alpha=0.3)
        panels[0][column].set_title(axis)
        panels[-1][column].set_xlabel('time [s]')
    set_title(figure, log.name)
    save_drawing(figure, file)
