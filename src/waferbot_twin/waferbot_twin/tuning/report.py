# SPDX-License-Identifier: Apache-2.0
"""What tuning and feedforward gave, as tables, files and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from waferbot_twin.html_page import save_picture
from waferbot_twin.plain_values import finite
from waferbot_twin.plot import COMMAND_COLOUR, ERROR_COLOUR, MEASURED_COLOUR, scaled_unit
from waferbot_twin.recording.writer import as_json
from waferbot_twin.tuning.loop import Loop
from waferbot_twin.tuning.tune import Row, Tuned

FILES = ('tuned.yaml', 'margins.csv', 'bode.png', 'nichols.png', 'tune.json')
BEFORE, AFTER = COMMAND_COLOUR, MEASURED_COLOUR

NICHOLS_DB = (-40.0, 40.0)


def margin_table(tuned: Tuned) -> pd.DataFrame:
    """
    Return the margins, a row for each machine, pose and set of gains (`before`, `after`).

    Columns: `machine`, `gains`, the pose by axis (m, rad), `stable`, `gain_db`, `phase_deg`, `delay_s`,
    `crossover_hz`, `bandwidth_hz` (closed loop, -3 dB), `sensitivity`.
    """
    rows = []
    for row in tuned.rows:
        for gains, loop in (('before', row.before), ('after', row.after)):
            rows.append({'machine': row.machine, 'gains': gains, **row.pose, **_figures(loop)})
    return pd.DataFrame(rows)


def _figures(loop: Loop) -> dict[str, Any]:
    found = asdict(loop.margins)
    names = ('gain_db', 'phase_deg', 'delay_s', 'crossover_hz', 'sensitivity')
    return {
        'stable': loop.stable,
        **{name: found[name] for name in names},
        'bandwidth_hz': loop.bandwidth_hz,
    }


def as_dict(tuned: Tuned) -> dict[str, Any]:
    """Return the result as plain values."""
    runs = tuned.runs
    result = {
        'schema': 1,
        'model': tuned.design.variant.name,
        'axis': tuned.axis,
        'required': asdict(tuned.design.required),
        'met': tuned.met,
        'tuning': asdict(tuned.tuning),
        'gains': {'before': tuned.before, 'after': tuned.after},
        'margins': margin_table(tuned).to_dict('records'),
        'experiment': tuned.experiment,
        'runs': None
        if runs is None
        else {'before': runs[0].figures(), 'after': runs[1].figures()},
    }
    return dict(finite(result))


def write(tuned: Tuned, folder: Path) -> None:
    """Write model, table, pictures and JSON into a folder."""
    (folder / FILES[0]).write_text(tuned.variant.text, 'utf-8')
    margin_table(tuned).to_csv(folder / FILES[1], index=False)
    draw_bode(tuned, folder / FILES[2])
    draw_nichols(tuned, folder / FILES[3])
    (folder / FILES[4]).write_text(as_json(as_dict(tuned)) + '\n', 'utf-8')


def draw_bode(tuned: Tuned, file: Path) -> None:
    """Draw the open loops, |L| and angle, of all poses and machines; the runs below if there are any."""
    count = 2 if tuned.runs is None else 3
    figure, panels = plt.subplots(count, 1, figsize=(8.0, 2.9 * count), squeeze=False)
    magnitude, phase = panels[0, 0], panels[1, 0]
    for gains, colour in (('before', BEFORE), ('after', AFTER)):
        for number, row in enumerate(tuned.rows):
            loop: Loop = getattr(row, gains)
            label = gains if number == 0 else None
            level_db = 20.0 * np.log10(np.abs(loop.response))
            magnitude.semilogx(loop.frequency_hz, level_db, color=colour, lw=0.9, label=label)
            phase.semilogx(loop.frequency_hz, _angle(loop), color=colour, lw=0.9)
    magnitude.axhline(0.0, color='black', lw=0.6)
    magnitude.set_ylabel('|L| [dB]')
    magnitude.set_ylim(-60.0, 60.0)
    magnitude.set_title(_title(tuned))
    magnitude.legend(loc='lower left', fontsize=8)
    phase.axhline(-180.0, color='black', lw=0.6)
    phase.set_ylabel('angle of L [°]')
    phase.set_xlabel('frequency [Hz]')
    if tuned.runs is not None:
        _draw_runs(panels[2, 0], tuned)
    for panel in panels[:2, 0]:
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, place: f'{value:g}'))
        panel.grid(alpha=0.3, which='both')
    figure.tight_layout()
    save_picture(figure, file)


def _draw_runs(panel: Axes, tuned: Tuned) -> None:
    assert tuned.runs is not None
    for run, colour, label in zip(tuned.runs, (BEFORE, AFTER), ('before', 'after'), strict=True):
        response = run.response
        factor, unit = scaled_unit(response.commanded, response.unit)
        panel.plot(
            response.encoder_time, response.position * factor, color=colour, lw=1.0, label=label
        )
    panel.step(
        response.servo_time, response.commanded * factor, color=ERROR_COLOUR, lw=0.7,
        where='post', label='commanded',
    )  # fmt: skip
    panel.set_ylabel(f'position [{unit}]')
    panel.set_xlabel('time [s]')
    panel.legend(loc='upper right', fontsize=8)
    panel.grid(alpha=0.3)


def draw_nichols(tuned: Tuned, file: Path) -> None:
    """Draw the open loops, dB over degrees, with the closed loop's gain and the required margins."""
    figure, panel = plt.subplots(figsize=(7.0, 6.0))
    _closed_loop_curves(panel)
    for gains, colour in (('before', BEFORE), ('after', AFTER)):
        for number, row in enumerate(tuned.rows):
            _nichols_curve(panel, row, gains, colour, gains if number == 0 else None)
    required = tuned.design.required
    box = plt.Rectangle(
        (-180.0 - required.phase_deg, -required.gain_db),
        2.0 * required.phase_deg,
        2.0 * required.gain_db,
        color=ERROR_COLOUR,
        alpha=0.15,
        label=f'{required.gain_db:g} dB, {required.phase_deg:g}°',
    )
    panel.add_patch(box)
    panel.plot([-180.0], [0.0], '+', color=ERROR_COLOUR)
    panel.set_xlim(-360.0, 0.0)
    panel.set_ylim(*NICHOLS_DB)
    panel.set_xticks(np.arange(-360, 1, 45))
    panel.set_xlabel('angle of L [°]')
    panel.set_ylabel('|L| [dB]')
    panel.set_title(_title(tuned))
    panel.legend(loc='upper left', fontsize=8)
    panel.grid(alpha=0.3)
    figure.tight_layout()
    save_picture(figure, file)


def _nichols_curve(panel: Axes, row: Row, gains: str, colour: str, label: str | None) -> None:
    loop: Loop = getattr(row, gains)
    angle = np.mod(np.degrees(np.angle(loop.response)), -360.0)
    level_db = 20.0 * np.log10(np.abs(loop.response))
    jumps = np.flatnonzero(np.abs(np.diff(angle)) > 180.0) + 1
    angle, level_db = np.insert(angle, jumps, np.nan), np.insert(level_db, jumps, np.nan)
    panel.plot(angle, level_db, color=colour, lw=0.9, label=label)


def _closed_loop_curves(panel: Axes) -> None:
    """Draw where |L / (1 + L)| is 3, 6 and 12 dB and -3 dB."""
    angle, level_db = np.meshgrid(np.linspace(-359.0, -1.0, 360), np.linspace(*NICHOLS_DB, 300))
    loop = 10.0 ** (level_db / 20.0) * np.exp(1j * np.radians(angle))
    gain_db = 20.0 * np.log10(np.abs(loop / (1.0 + loop)))
    lines = panel.contour(
        angle, level_db, gain_db, levels=[-3.0, 3.0, 6.0, 12.0], colors='#bbbbbb',
        linewidths=0.6, linestyles=':',
    )  # fmt: skip
    panel.clabel(lines, fmt='%g dB', fontsize=7)


def _angle(loop: Loop) -> np.ndarray:
    """Return the angle of L in degrees, -360 to 0, with gaps where it wraps."""
    angle = np.mod(np.degrees(np.angle(loop.response)), -360.0)
    angle[np.flatnonzero(np.abs(np.diff(angle)) > 180.0)] = np.nan
    return np.asarray(angle)


def _title(tuned: Tuned) -> str:
    worst = [row.after.margins for row in tuned.rows]
    gain = min(abs(one.gain_db) for one in worst)
    phase = min(abs(one.phase_deg) for one in worst)
    machines = len({row.machine for row in tuned.rows})
    poses = len(tuned.rows) // machines
    return (
        f'{_axis(tuned)} of {tuned.design.variant.name}: after, at least {gain:.1f} dB and '
        f'{phase:.0f}° ({_several(poses, "pose")}, {_several(machines, "machine")})'
    )


def _axis(tuned: Tuned) -> str:
    return tuned.design.variant.titles[tuned.axis]


def _several(count: int, what: str) -> str:
    return f'{count} {what}' + ('' if count == 1 else 's')


def sentence(tuned: Tuned) -> str:
    """Return in a sentence what was gained and what the margins are."""
    worst = [row.after.margins for row in tuned.rows]
    said = (
        f'{_axis(tuned)}: at least {min(abs(one.gain_db) for one in worst):.1f} dB, '
        f'{min(abs(one.phase_deg) for one in worst):.1f} degrees and '
        f'{1e3 * min(one.delay_s for one in worst):.2f} ms of delay at every pose'
    )
    if not tuned.met:
        said += '; that is less than required: no gains were found that have more'
    if tuned.runs is not None:
        before, after = tuned.runs
        if math.isnan(after.settling_time):
            pair = (before.rms_following_error, after.rms_following_error)
            unit = after.response.unit
            said += f'. RMS following error {pair[0]:.3g} to {pair[1]:.3g} {unit}'
        else:
            said += f'. Settles in {_seconds(after)} instead of {_seconds(before)}'
    return said


def _seconds(run: Any) -> str:
    return f'{run.settling_time:.3f} s' if math.isfinite(run.settling_time) else 'no time'


def lines_of(tuned: Tuned) -> Sequence[Sequence[str]]:
    """Return the printed rows: machine, pose, and for each figure before and after."""
    rows = []
    for row in tuned.rows:
        pose = ', '.join(f'{axis} {value:.3g}' for axis, value in row.pose.items()) or 'home'
        one, other = row.before.margins, row.after.margins
        rows.append(
            [
                row.machine,
                pose,
                f'{"" if row.before.stable else "unstable "}{one.gain_db:+.1f}',
                f'{"" if row.after.stable else "unstable "}{other.gain_db:+.1f}',
                f'{one.phase_deg:+.1f}',
                f'{other.phase_deg:+.1f}',
                f'{1e3 * one.delay_s:.2f}',
                f'{1e3 * other.delay_s:.2f}',
                f'{one.crossover_hz:.1f}',
                f'{other.crossover_hz:.1f}',
            ]
        )
    return rows
