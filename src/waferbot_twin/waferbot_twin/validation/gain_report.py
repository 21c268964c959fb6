# SPDX-License-Identifier: Apache-2.0
"""Tables and pictures of what a changed model gains over the nominal one."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from waferbot_twin.envelope import draw_signal
from waferbot_twin.plain_values import significant, with_prefix
from waferbot_twin.plot import scaled_unit
from waferbot_twin.validation.gain import AxisGain

HARDLY_PERCENT = 1.0
"""Change of the RMS error below which it is as it was."""

BEFORE, AFTER, MEASURED = '#c46a1b', '#1f5fa8', '#222222'


def draw_gains(gains: Sequence[AxisGain], titles: Mapping[str, str]) -> Figure:
    """Draw positions and errors of both models for every axis of the first validation log."""
    log = gains[0].log if gains else ''
    items = [item for item in gains if item.log == log]
    figure, panels = plt.subplots(
        2, max(1, len(items)), figsize=(12.0, 5.4), squeeze=False, layout='constrained',
        sharex='col',
    )  # fmt: skip
    for column, item in enumerate(items):
        factor, unit = scaled_unit(item.measured - item.measured[0], item.unit)
        for error, colour, label in (
            (item.error_before, BEFORE, 'nominal model'),
            (item.error_after, AFTER, 'extended model'),
        ):
            simulated = (item.measured + error) * factor
            panels[0][column].plot(item.time_s, simulated, color=colour, lw=1.0, label=label)
        panels[0][column].plot(
            item.time_s, item.measured * factor, color=MEASURED, lw=1.0, ls=':', label='measured'
        )
        panels[0][column].set_title(f'{titles[item.axis]}: {_how_much(item)}')
        panels[0][column].set_ylabel(f'position [{unit}]')
        panels[0][column].legend(fontsize=8, loc='best')
        factor, unit = scaled_unit(item.error_before, item.unit)
        for error, colour, label in (
            (
                item.error_before,
                BEFORE,
                f'nominal, RMS {significant(item.rms_before * factor, 3)} {unit}',
            ),
            (
                item.error_after,
                AFTER,
                f'extended, RMS {significant(item.rms_after * factor, 3)} {unit}',
            ),
        ):
            draw_signal(panels[1][column], item.time_s, error * factor, colour, label)
        panels[1][column].set_ylabel(f'simulated - measured [{unit}]')
        panels[1][column].set_xlabel('time [s]')
        panels[1][column].legend(fontsize=8, loc='best')
        for row in range(2):
            panels[row][column].grid(alpha=0.3)
    figure.suptitle(log, fontsize=10)
    return figure


def _how_much(item: AxisGain) -> str:
    percent = item.improvement_percent
    if abs(percent) < HARDLY_PERCENT:
        return 'as before'
    return f'{change_text(percent)} {"better" if percent > 0.0 else "worse"}'


def change_text(percent: float) -> str:
    """Return how much of an error is gone, or has come, in whole percent; not all where some is left."""
    return 'over 99 %' if 99.5 <= percent < 100.0 else f'{abs(percent):.0f} %'


def gain_table(gains: Sequence[AxisGain], titles: Mapping[str, str]) -> str:
    """Return the gain of every log and axis as a table of HTML."""
    rows = ''
    for item in gains:
        factor, unit = with_prefix(max(item.rms_before, item.rms_after), item.unit)
        rows += (
            f'<tr><td>{html.escape(f"{item.log}, {titles[item.axis]}")}</td>'
            f'<td>{significant(factor * item.rms_before)} {unit}</td>'
            f'<td>{significant(factor * item.rms_after)} {unit}</td>'
            f'<td>{item.improvement_percent:.1f} %</td></tr>'
        )
    return (
        '<table><tr><th>log, axis</th><th>RMS error, nominal</th><th>RMS error, extended</th>'
        f'<th>improvement</th></tr>{rows}</table>'
    )
