# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of the thesis, and what its text says of them, as one HTML page with pictures."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

from waferbot_twin.plain_values import significant
from waferbot_twin.statements import Finding
from waferbot_twin.step_runs import Runs
from waferbot_twin.tables import Table
from waferbot_twin.thesis_figures import MET_COLOUR, MISSED_COLOUR, Figure, draw, figures

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: .5rem 0 2rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #ddd; vertical-align: top; }
th:first-child, td:first-child, td.note { text-align: left; }
td.note { max-width: 28rem; font-size: .85em; }
tr.missed { background: #fde8e4; } img { max-width: 100%; }
table.statements td, table.statements th { text-align: left; }
"""


def write_report(
    folder: Path,
    tables: list[Table],
    statements: Sequence[Finding],
    runs: Runs,
    command: str,
) -> None:
    """Write `index.html` and its pictures into an existing folder."""
    for figure in figures():
        about = _of_axis(_of_figure(statements, figure.number), figure)
        draw(figure, runs, about, folder / figure.file)
    (folder / 'index.html').write_text(_page(tables, statements, command), encoding='utf-8')


def _of_figure(statements: Sequence[Finding], number: str) -> list[Finding]:
    return [finding for finding in statements if finding.statement.figure == number]


def _of_axis(findings: Sequence[Finding], figure: Figure) -> list[Finding]:
    """Return what is said of a figure's axis; of no axis, what is said of the whole."""
    return [
        finding
        for finding in findings
        if finding.statement.about.get('axis', figure.axis) == figure.axis
    ]


def _page(tables: list[Table], statements: Sequence[Finding], command: str) -> str:
    missed = sum(row.met is False for table in tables for row in table.rows)
    demanded = sum(row.met is not None for table in tables for row in table.rows)
    met = sum(finding.met for finding in statements)
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        f'<title>Thesis tables</title><style>{STYLE}</style></head><body>',
        '<h1>Tables and figures of the thesis</h1>',
        f'<p>Made by <code>{html.escape(command)}</code> from runs made for this page. '
        f'{demanded - missed} of {demanded} rows of the tables are met, and {met} of {len(statements)} '
        'statements of the text about its curves; the others are marked. Rings in the pictures are '
        f'where a statement was measured: <span style="color:{MET_COLOUR}">met</span>, '
        f'<span style="color:{MISSED_COLOUR}">not met</span>.</p>',
        '<h2>Figures</h2>',
    ]
    drawn = set()
    for figure in figures():
        caption = html.escape(figure.caption)
        drawn.add(figure.number)
        about = _of_axis(_of_figure(statements, figure.number), figure)
        parts.append(
            f'<h3>{caption}</h3><img src="{figure.file}" alt="{caption}" loading="lazy">'
            + _statements(about)
        )
    others = [finding for finding in statements if finding.statement.figure not in drawn]
    if others:
        parts.append(f'<h3>Without a picture</h3>{_statements(others)}')
    parts.append('<h2>Tables</h2>')
    parts += [_table(table) for table in tables]
    return '\n'.join([*parts, '</body></html>', ''])


def _statements(findings: Sequence[Finding]) -> str:
    """Return the statements about a figure as a table."""
    headings = ('the text says', 'where', 'measured', 'limits', 'ours', 'met')
    lines = []
    for finding in findings:
        said = finding.statement
        cells = (
            said.says,
            said.place,
            finding.means,
            f'{said.demanded} ({said.because})',
            finding.value_text,
            'yes' if finding.met else 'no',
        )
        missed = '' if finding.met else ' class="missed"'
        lines.append(
            f'<tr{missed}>' + ''.join(f'<td>{html.escape(cell)}</td>' for cell in cells) + '</tr>'
        )
    heading = ''.join(f'<th>{name}</th>' for name in headings)
    return f'<table class="statements"><tr>{heading}</tr>{"".join(lines)}</table>'


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
