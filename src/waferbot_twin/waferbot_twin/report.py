# SPDX-License-Identifier: Apache-2.0
"""The tables of chapters 4 and 6 and their figures as one HTML page beside its pictures."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from waferbot_lockstep.contract import AXES
from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import significant
from waferbot_twin.plot import TITLES, scaled_unit
from waferbot_twin.response import AxisResponse
from waferbot_twin.tables import Runs, Table

COLOURS = {
    'as_built': '#222222',
    'rigid': '#c46a1b',
    'flexible': '#1f5fa8',
    'simplified': '#3a9150',
    'calculated': '#a02c5a',
}
NAMES = {
    'as_built': 'measured (as-built machine)',
    'rigid': 'rigid',
    'flexible': 'flexible',
    'simplified': 'simplified',
    'calculated': 'flexible, calculated damping',
}
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: .5rem 0 2rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }
th:first-child, td:first-child, td.note { text-align: left; }
td.note { max-width: 28rem; font-size: .85em; }
tr.missed { background: #fde8e4; } img { max-width: 100%; }
"""


@dataclass(frozen=True)
class Figure:
    """A picture of one axis: which models, drawn as responses or as errors to the measured one."""

    name: str
    caption: str
    axis: str
    models: tuple[str, ...]
    errors: bool = False


def figures() -> list[Figure]:
    """Return the figures of chapters 4 and 6, axis by axis."""
    found = []
    for axis in AXES:
        title = TITLES[axis]
        found += [
            Figure(
                f'{axis}_rigid',
                f'{title}: rigid connections, simulated and measured (chapter 4)',
                axis,
                ('as_built', 'rigid'),
            ),
            Figure(
                f'{axis}_calculated_damping',
                f'{title}: flexible connections with calculated damping (chapter 6)',
                axis,
                ('as_built', 'calculated'),
            ),
            Figure(
                f'{axis}_flexible',
                f'{title}: flexible connections with improved damping (chapter 6)',
                axis,
                ('as_built', 'rigid', 'flexible'),
            ),
            Figure(
                f'{axis}_errors',
                f'{title}: error of rigid, flexible and simplified model (chapter 6)',
                axis,
                ('rigid', 'flexible', 'simplified'),
                errors=True,
            ),
        ]
    return found


def write_report(folder: Path, tables: list[Table], runs: Runs, command: str) -> Path:
    """
    Write `index.html` and its pictures into `folder`; returns the page.

    Raises `UserError` if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for figure in figures():
            draw(figure, runs, folder / f'{figure.name}.png')
        page = folder / 'index.html'
        page.write_text(_page(tables, command), encoding='utf-8')
    except OSError as error:
        raise UserError(f'{folder}: {error.strerror}') from error
    return page


def draw(figure: Figure, runs: Runs, file: Path) -> None:
    """Draw one figure into an image file."""
    responses = {model: runs[model, figure.axis].response for model in figure.models}
    if figure.errors:
        canvas, panel = plt.subplots(figsize=(9.0, 3.6))
        measured = runs['as_built', figure.axis].response
        _draw_errors(panel, responses, measured)
        panel.set_xlabel('time from the step [s]')
    else:
        canvas, panels = plt.subplots(3, 1, figsize=(9.0, 8.4), sharex=True)
        for panel, (label, pick) in zip(panels, _SIGNALS.items(), strict=True):
            _draw_signal(panel, responses, label, pick)
        panels[-1].set_xlabel('time from the step [s]')
    canvas.tight_layout()
    canvas.savefig(file, dpi=100, metadata={'Software': 'waferbot'})
    plt.close(canvas)


def _times(response: AxisResponse) -> tuple[float, float]:
    """Return the time of the step, and the unit factor's base: its height."""
    step = response.step()
    return step if step is not None else (0.0, 1.0)


_SIGNALS = {
    'position': lambda response: (response.encoder_time, response.position),
    'following error': lambda response: (response.servo_time, response.following_error),
    'current': lambda response: (response.tick_time, response.current),
}


def _draw_signal(panel: Axes, responses: dict[str, AxisResponse], label: str, pick) -> None:
    first = next(iter(responses.values()))
    unit = 'A' if label == 'current' else first.unit
    factor, unit = scaled_unit(pick(first)[1], unit)
    start_s, _ = _times(first)
    if label == 'position':
        panel.step(
            first.servo_time - start_s, first.commanded * factor, where='post',
            color='#999999', lw=0.8, label='commanded',
        )  # fmt: skip
    for model, response in responses.items():
        time, values = pick(response)
        panel.plot(
            time - _times(response)[0], values * factor,
            color=COLOURS[model], lw=1.0, label=NAMES[model],
        )  # fmt: skip
    _limit(panel, [pick(response)[1] * factor for response in responses.values()])
    panel.set_ylabel(f'{label} [{unit}]')
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, loc='upper right')


def _limit(panel: Axes, values: list[np.ndarray]) -> None:
    """Keep a response that blows up from pressing the others flat: four times the first one."""
    low, high = float(values[0].min()), float(values[0].max())
    reach = 4.0 * max(high - low, 1e-12)
    middle = 0.5 * (high + low)
    if any(np.max(np.abs(other - middle)) > reach for other in values[1:]):
        panel.set_ylim(middle - reach, middle + reach)


def _draw_errors(panel: Axes, responses: dict[str, AxisResponse], measured: AxisResponse) -> None:
    measured_time, measured_position = measured.since_start()
    factor, unit = scaled_unit(measured_position, measured.unit)
    for model, response in responses.items():
        time, position = response.since_start()
        error = position - np.interp(time, measured_time, measured_position)
        panel.plot(
            time, error * factor, color=COLOURS[model], lw=1.0, label=NAMES[model],
            ls='--' if model == 'simplified' else '-',
        )  # fmt: skip
    panel.set_ylabel(f'simulated minus measured [{unit}]')
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, loc='upper right')


def _page(tables: list[Table], command: str) -> str:
    missed = sum(row.met is False for table in tables for row in table.rows)
    demanded = sum(row.met is not None for table in tables for row in table.rows)
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        f'<title>Thesis tables</title><style>{STYLE}</style></head><body>',
        '<h1>Tables and figures of chapters 4 and 6</h1>',
        f'<p>Made by <code>{html.escape(command)}</code> from runs made for this page. '
        f'{demanded - missed} of {demanded} rows are met; the others are marked, with the reason.</p>',
        '<h2>Figures</h2>',
    ]
    for figure in figures():
        caption = html.escape(figure.caption)
        parts.append(
            f'<h3>{caption}</h3><img src="{figure.name}.png" alt="{caption}" loading="lazy">'
        )
    parts.append('<h2>Tables</h2>')
    parts += [_table(table) for table in tables]
    return '\n'.join([*parts, '</body></html>', ''])


def _table(table: Table) -> str:
    columns = list(dict.fromkeys(key for row in table.rows for key in row.cells))
    headings = ''.join(f'<th>{html.escape(name)}</th>' for name in ['', *columns, 'met', ''])
    lines = []
    for row in table.rows:
        cells = [_cell(row.cells.get(column)) for column in columns]
        met = {None: '', True: 'yes', False: 'no'}[row.met]
        missed = ' class="missed"' if row.met is False else ''
        lines.append(
            f'<tr{missed}><td>{html.escape(row.name)}</td>'
            + ''.join(f'<td>{html.escape(cell)}</td>' for cell in [*cells, met])
            + f'<td class="note">{html.escape(row.note)}</td></tr>'
        )
    return (
        f'<h3>Table {html.escape(table.number)}. {html.escape(table.title)}</h3>'
        f'<table><tr>{headings}</tr>{"".join(lines)}</table>'
    )


def _cell(value: float | str | None) -> str:
    return value if isinstance(value, str) else significant(value)
