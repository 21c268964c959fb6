# SPDX-License-Identifier: Apache-2.0
"""The tables of chapters 4 and 6 and their figures as one HTML page beside its pictures."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from waferbot_lockstep.contract import AXES
from waferbot_twin.plain_values import significant
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


def write_report(folder: Path, tables: list[Table], runs: Runs, command: str) -> None:
    """Write `index.html` and its pictures into an existing folder."""
    for figure in figures():
        draw(figure, runs, folder / f'{figure.name}.png')
    (folder / 'index.html').write_text(_page(tables, command), encoding='utf-8')


def draw(figure: Figure, runs: Runs, file: Path) -> None:
    """Draw one figure into an image file: the whole record, and beside it the start enlarged."""
    responses = {model: runs[model, figure.axis].response for model in figure.models}
    if figure.errors:
        measured = runs['as_built', figure.axis].response
        rows = [_errors(responses, measured)]
    else:
        rows = [_signal(responses, name) for name in _SIGNALS]
    canvas, panels = plt.subplots(
        len(rows), 2, figsize=(11.0, 1.4 + 2.4 * len(rows)), squeeze=False, sharex='col',
        layout='constrained',
    )  # fmt: skip
    for line, row in zip(panels, rows, strict=True):
        for panel in line:
            _draw_row(panel, row)
        line[0].set_ylabel(row.label)
    panels[0][1].set_xlim(-0.05 * START_S[figure.axis], START_S[figure.axis])
    for panel in panels[-1]:
        panel.set_xlabel('time from the step [s]')
    handles, labels = panels[0][0].get_legend_handles_labels()
    canvas.legend(
        handles, labels, loc='outside upper center', ncols=len(labels), fontsize=9, frameon=False
    )
    canvas.savefig(file, dpi=100, metadata={'Software': 'waferbot'})
    plt.close(canvas)


START_S = {'y_linear': 0.12, 'x_rotate': 0.12, 'y_rotate': 0.3}
"""How much of the step the enlarged half of a figure shows."""


@dataclass(frozen=True)
class _Row:
    """One row of a figure: curves (time, values, model or `commanded`) in the unit of the label."""

    label: str
    curves: list[tuple[np.ndarray, np.ndarray, str]]
    limits: tuple[float, float] | None


_SIGNALS: dict[str, Callable[[AxisResponse], tuple[np.ndarray, np.ndarray]]] = {
    'position': lambda response: (response.encoder_time, response.position),
    'following error': lambda response: (response.servo_time, response.following_error),
    'current': lambda response: (response.tick_time, response.current),
}


def _signal(responses: dict[str, AxisResponse], name: str) -> _Row:
    pick = _SIGNALS[name]
    first = next(iter(responses.values()))
    factor, unit = scaled_unit(pick(first)[1], 'A' if name == 'current' else first.unit)
    curves = []
    if name == 'position':
        curves.append((first.servo_time - _start(first), first.commanded * factor, 'commanded'))
    for model, response in responses.items():
        time, values = pick(response)
        curves.append((time - _start(response), values * factor, model))
    measured = [values for _, values, model in curves if model != 'commanded']
    limits = _current_limits(measured) if name == 'current' else _limits(measured)
    return _Row(f'{name} [{unit}]', curves, limits)


def _errors(responses: dict[str, AxisResponse], measured: AxisResponse) -> _Row:
    measured_time, measured_position = measured.since_start()
    factor, unit = scaled_unit(measured_position, measured.unit)
    curves = []
    for model, response in responses.items():
        time, position = response.since_start()
        error = position - np.interp(time, measured_time, measured_position)
        curves.append((time, error * factor, model))
    return _Row(f'simulated minus measured [{unit}]', curves, None)


def _start(response: AxisResponse) -> float:
    """Return the time of the step, s."""
    step = response.step()
    return step[0] if step is not None else 0.0


def _draw_row(panel: Axes, row: _Row) -> None:
    for time, values, model in row.curves:
        if model == 'commanded':
            panel.step(time, values, where='post', color='#999999', lw=0.8, label='commanded')
        else:
            panel.plot(
                time, values, color=COLOURS[model], lw=1.0, label=NAMES[model],
                ls='--' if model == 'simplified' else '-',
                zorder=2.5 if model == 'as_built' else 2.0,  # a vibration must not hide it
            )  # fmt: skip
    if row.limits is not None:
        panel.set_ylim(*row.limits)
        drawn = np.concatenate([values for _, values, _ in row.curves])
        panel.text(
            0.98, 0.05, f'cut off: {drawn.min():.3g} to {drawn.max():.3g}',
            transform=panel.transAxes, ha='right', fontsize=8, color='#555555',
        )  # fmt: skip
    panel.grid(alpha=0.3)


def _limits(values: list[np.ndarray]) -> tuple[float, float] | None:
    """
    Return limits of four times the first curve if another one goes beyond them.

    So a response that blows up does not press the others flat.
    """
    low, high = float(values[0].min()), float(values[0].max())
    reach = 2.0 * max(high - low, 1e-12)
    middle = 0.5 * (high + low)
    beyond = any(np.max(np.abs(other - middle)) > reach for other in values[1:])
    return (middle - reach, middle + reach) if beyond else None


def _current_limits(values: list[np.ndarray]) -> tuple[float, float] | None:
    """
    Return limits that hold all but 0.5 % of the samples if what they leave out is far away.

    That is the current which velocity feedforward asks for in the servo cycle of the step.
    """
    everything = np.concatenate(values)
    low, high = np.percentile(everything, [0.25, 99.75])
    spread = max(float(high - low), 1e-12)
    if np.ptp(everything) < 2.0 * spread:
        return None
    return float(low) - 0.3 * spread, float(high) + 0.3 * spread


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
