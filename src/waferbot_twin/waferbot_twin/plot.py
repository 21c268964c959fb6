# SPDX-License-Identifier: Apache-2.0
"""Pictures of a recording: position, following error and current of each axis."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from waferbot_twin.html_page import save_drawing
from waferbot_twin.recording.reader import Recording
from waferbot_twin.response import AxisResponse, axis_responses

TITLES = {'y_linear': 'Y-Linear', 'x_rotate': 'X-Rotate', 'y_rotate': 'Y-Rotate'}
COMMAND_COLOUR, MEASURED_COLOUR, ERROR_COLOUR = '#999999', '#1f5fa8', '#b5401f'
_PREFIXES = ((1.0, ''), (1e3, 'm'), (1e6, 'µ'), (1e9, 'n'))


def scaled_unit(values: np.ndarray, unit: str) -> tuple[float, str]:
    """Return a factor and a unit with SI prefix that bring the largest value above 1."""
    largest = float(np.max(np.abs(values))) if len(values) else 0.0
    if unit == 'A' or largest == 0.0:
        return 1.0, unit
    fitting = [(factor, prefix) for factor, prefix in _PREFIXES if largest * factor >= 1.0]
    factor, prefix = fitting[0] if fitting else _PREFIXES[-1]
    return factor, prefix + unit


def plot_recording(recording: Recording, file: Path) -> None:
    """Draw a recording into an image file (`.png`, `.svg`, `.pdf`)."""
    responses = axis_responses(recording)
    run = recording.run
    figure, panels = plt.subplots(
        3, len(responses), figsize=(4.6 * len(responses), 8.0), sharex='col', squeeze=False
    )
    for column, response in enumerate(responses):
        _draw_position(panels[0][column], response)
        _draw_error(panels[1][column], response)
        _draw_current(panels[2][column], response)
        panels[2][column].set_xlabel('time [s]')
    title = f'model {run.get("model", "?")}, experiment {run.get("experiment", "?")}'
    figure.suptitle(f'{recording.path.name}: {title}', fontsize=11)
    figure.tight_layout()
    save_drawing(figure, file)


def _draw_position(panel: Axes, response: AxisResponse) -> None:
    factor, unit = scaled_unit(
        np.concatenate([response.position, response.commanded]), response.unit
    )
    panel.step(
        response.servo_time, response.commanded * factor, where='post',
        color=COMMAND_COLOUR, label='commanded',
    )  # fmt: skip
    panel.plot(
        response.encoder_time, response.position * factor, color=MEASURED_COLOUR, label='encoder'
    )
    panel.set_title(TITLES[response.axis])
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
    if len(response.servo_time) == 0:
        panel.text(0.5, 0.5, 'not reported', transform=panel.transAxes, ha='center')
    factor, unit = scaled_unit(response.following_error, response.unit)
    panel.plot(response.servo_time, response.following_error * factor, color=ERROR_COLOUR)
    panel.set_ylabel(f'following error [{unit}]')
    panel.grid(alpha=0.3)


def _draw_current(panel: Axes, response: AxisResponse) -> None:
    panel.step(
        response.command_time, response.current_command, where='post',
        color=COMMAND_COLOUR, label='command',
    )  # fmt: skip
    panel.plot(
        response.tick_time, response.current, color=MEASURED_COLOUR, lw=0.8, label='measured'
    )
    panel.set_ylabel('current [A]')
    panel.legend(loc='upper right', fontsize=8)
    panel.grid(alpha=0.3)
