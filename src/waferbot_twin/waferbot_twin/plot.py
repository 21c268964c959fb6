# SPDX-License-Identifier: Apache-2.0
"""
Pictures of a recording: position, following error and current of each axis.

Of a run also what no sensor shows: by how much the payload frame is off its place because parts give,
how much it is tilted, and how warm the windings are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from waferbot_twin.html_page import save_drawing, set_title
from waferbot_twin.models import recorded_titles
from waferbot_twin.recording.reader import Progress, header_of
from waferbot_twin.response import AxisResponse
from waferbot_twin.response_reader import load_responses
from waferbot_twin.thinning import thinned
from waferbot_twin.validity import OUTSIDE, recorded_validity

COMMAND_COLOUR, MEASURED_COLOUR, ERROR_COLOUR = '#999999', '#1f5fa8', '#b5401f'
DIRECTION_COLOURS = ('#b5401f', '#3a9150', '#1f5fa8')
AXIS_COLOURS = (*DIRECTION_COLOURS, '#8a5fa8', '#c58a1f', '#2f9aa0', '#6b6b6b', '#a03060')
OF_PLANT = 3
"""Panels of what the plant tells: error and tilt of the payload, temperatures."""

MOST_DRAWN = 4000
"""Samples of a line, an envelope if there are more: eight for each column of a panel."""

_PREFIXES = ((1.0, ''), (1e3, 'm'), (1e6, 'µ'), (1e9, 'n'))
_WITHOUT_PREFIX = ('A', '1', 'degC')


def scaled_unit(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Return a factor and a unit with SI prefix that bring the largest value above 1."""
    largest = float(np.max(np.abs(values))) if len(values) else 0.0
    if unit in _WITHOUT_PREFIX or largest == 0.0:
        return 1.0, unit
    fitting = [(factor, prefix) for factor, prefix in _PREFIXES if largest * factor >= 1.0]
    factor, prefix = fitting[0] if fitting else _PREFIXES[-1]
    return factor, prefix + unit


def plot_recording(path: Path, file: Path, progress: Progress | None = None) -> None:
    """
    Draw a recording into an image file (`.png`, `.svg`, `.pdf`).

    Of each signal the least and the greatest sample of every stretch are drawn, several for a column of
    the picture: what ten minutes look like, without drawing ten million samples.
    """
    told: list[np.ndarray] = []
    responses = load_responses(path, progress, told.append)
    header = header_of(path)
    run, titles = header.run, recorded_titles(header)
    rows = 4 if told else 3
    columns = max(len(responses), OF_PLANT if told else 1)
    figure, panels = plt.subplots(
        rows,
        columns,
        figsize=(4.6 * columns, 8.0 * rows / 3.0),
        sharex='col',
        squeeze=False,
    )
    for column, response in enumerate(responses):
        panels[0][column].set_title(titles[response.axis])
        _draw_position(panels[0][column], response)
        _draw_error(panels[1][column], response)
        _draw_current(panels[2][column], response)
    for panel in panels[:3, len(responses) :].flat:
        panel.set_axis_off()
    if told:
        tick_hz = header.timing.current_loop_hz
        _draw_plant_state(list(panels[3, :OF_PLANT]), np.concatenate(told), tick_hz, titles)
        for panel in panels[3, OF_PLANT:]:
            panel.set_axis_off()
    for panel in panels[-1]:
        panel.set_xlabel('time [s]')
    title = f'model {run.get("model", "?")}, experiment {run.get("experiment", "?")}'
    set_title(figure, f'{path.name}: {title}')
    _tell_departures(figure, [row for row in recorded_validity(path) if row['outside']])
    save_drawing(figure, file)


def _tell_departures(figure: Figure, departures: list[dict[str, Any]]) -> None:
    """Write below all panels where the run left the range of its model."""
    if not departures:
        return
    lines = [f'{OUTSIDE}:', *(f'{row["place"]}: {_amount(row)}' for row in departures)]
    height = 0.16 * (len(lines) + 1)
    share = height / (figure.get_figheight() + height)
    figure.set_figheight(figure.get_figheight() + height)
    figure.tight_layout(rect=(0.0, share, 1.0, 0.97))
    figure.text(
        0.01, 0.5 * share, '\n'.join(lines), fontsize=8, color=ERROR_COLOUR, va='center', ha='left'
    )


def _amount(row: dict[str, Any]) -> str:
    return f'{row["what"]} {row["worst"]:.4g} {row["unit"]} at {row["worst_s"]:.3f} s ({row["limits"]})'


def _draw_plant_state(
    panels: Sequence[Axes], told: np.ndarray, tick_hz: float, titles: Mapping[str, str]
) -> None:
    """Draw error and tilt of the payload, and the temperatures of the windings."""
    time_s = told['tick'] / tick_hz
    for panel, name, unit, what in (
        (panels[0], 'payload_error', 'm', 'payload, error from flexibility'),
        (panels[1], 'payload_tilt', 'rad', 'payload, tilt'),
    ):
        factor, scaled = scaled_unit(told[name], unit)
        for place, label in enumerate('xyz'):
            _line(
                panel, time_s, told[name][:, place] * factor, DIRECTION_COLOURS[place], label, 1.0
            )
        panel.set_ylabel(f'{what} [{scaled}]')
    for place, title in enumerate(titles.values()):
        values = told['winding_temperature'][:, place]
        _line(panels[2], time_s, values, AXIS_COLOURS[place], title, 1.0)
    panels[2].set_ylabel('windings [degC]')
    for panel in panels:
        panel.legend(loc='upper right', fontsize=8)
        panel.grid(alpha=0.3)


def _draw_position(panel: Axes, response: AxisResponse) -> None:
    factor, unit = scaled_unit(
        np.concatenate([response.position, response.commanded]), response.unit
    )
    _line(
        panel, response.servo_time, response.commanded * factor, COMMAND_COLOUR, 'commanded',
        held=True,
    )  # fmt: skip
    _line(
        panel, response.encoder_time, response.position * factor, MEASURED_COLOUR, 'encoder', 1.5
    )
    panel.set_ylabel(f'position [{unit}]')
    panel.legend(loc='lower right', fontsize=8)
    panel.grid(alpha=0.3)
    metrics = response.metrics()
    if metrics is not None:
        panel.annotate(
            f'overshoot {metrics.overshoot_percent:.1f} %\nsettling {metrics.settling_time:.3f} s',
            xy=(0.97, 0.35), xycoords='axes fraction', ha='right', fontsize=8,
        )  # fmt: skip


def _draw_error(panel: Axes, response: AxisResponse) -> None:
    if len(response.following_error) == 0:
        panel.text(0.5, 0.5, 'not reported', transform=panel.transAxes, ha='center')
    factor, unit = scaled_unit(response.following_error, response.unit)
    _line(panel, response.following_time, response.following_error * factor, ERROR_COLOUR, '', 1.5)
    panel.set_ylabel(f'following error [{unit}]')
    panel.grid(alpha=0.3)


def _draw_current(panel: Axes, response: AxisResponse) -> None:
    _line(
        panel,
        response.command_time,
        response.current_command,
        COMMAND_COLOUR,
        'command',
        held=True,
    )
    _line(panel, response.tick_time, response.current, MEASURED_COLOUR, 'measured', 0.8)
    panel.set_ylabel('current [A]')
    panel.legend(loc='upper right', fontsize=8)
    panel.grid(alpha=0.3)


def _line(
    panel: Axes,
    time_s: np.ndarray,
    values: np.ndarray,
    colour: str,
    label: str,
    width: float = 1.5,
    held: bool = False,
) -> None:
    """Draw a signal; one that is `held` stands until its next sample."""
    time_s, values = thinned(time_s, values, MOST_DRAWN)
    style = 'steps-post' if held else 'default'
    panel.plot(time_s, values, color=colour, label=label, lw=width, drawstyle=style)
