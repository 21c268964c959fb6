# SPDX-License-Identifier: Apache-2.0
"""
Every table of chapters 4 and 6 of the thesis beside this model, from runs made on the spot, and
what the text of chapters 3, 4 and 6 says of its curves, each statement measured on the same runs.

Rows that are not met are marked with `no` and followed by the reason, as are statements. With --html
a page with the tables, a picture of each figure and the statements beside it is written too.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from waferbot_twin.cli.console import (
    new_table,
    print_json,
    progress_bar,
    result_console,
)
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

if TYPE_CHECKING:
    from waferbot_twin.statements import Finding

EXAMPLES = ('waferbot tables --html tables',)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot tables`."""
    parser.add_argument('--html', type=Path, metavar='DIR', help='write a report to this folder')
    parser.add_argument('--force', action='store_true', help='replace what is at --html')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run the steps, make the tables, print them."""
    from waferbot_twin.report import write_report
    from waferbot_twin.statements import findings
    from waferbot_twin.step_runs import Runs
    from waferbot_twin.tables import Table, all_tables

    output = OutputFolder(options.html, options.force, option='--html') if options.html else None
    with progress_bar('steps of every model and axis') as progress:
        runs = Runs(progress)
    tables = all_tables(runs)
    said = findings(runs)
    command = f'waferbot tables --html {options.html}'
    kept = keep(output, lambda folder: write_report(folder, tables, said, runs, command))
    if options.json:
        print_json(
            {
                'tables': [table.as_dict() for table in tables],
                'statements': [finding.as_dict() for finding in said],
            }
        )
        return kept.tell('report: {}/index.html')

    def show(table: Table) -> None:
        columns = list(dict.fromkeys(key for row in table.rows for key in row.cells))
        print(f'Table {table.number}. {table.title}')
        printed = new_table('', *(column.replace(' ', '\n') for column in columns), 'met')
        for row in table.rows:
            cells = [row.cells.get(column) for column in columns]
            texts = [cell if isinstance(cell, str) else significant(cell) for cell in cells]
            printed.add_row(row.name, *texts, {None: '', True: 'yes', False: 'no'}[row.met])
        result_console.print(printed)
        for row in table.rows:
            if row.note:
                print(f'  {row.name}: {row.note}')
        print()

    for table in tables:
        show(table)
    show_statements(said)
    missed = sum(row.met is False for table in tables for row in table.rows)
    demanded = sum(row.met is not None for table in tables for row in table.rows)
    print(f'{demanded - missed} of {demanded} rows met')
    print(f'{sum(finding.met for finding in said)} of {len(said)} statements met')
    return kept.tell('report: {}/index.html')


def show_statements(findings: Sequence[Finding]) -> None:
    """Print what the text says of each figure, with what was measured and the limits."""
    print('What the text says of its curves')
    figure = ''
    for finding in findings:
        said = finding.statement
        if said.figure != figure:
            figure = said.figure
            print(f'Figure {figure}')
        met = 'yes' if finding.met else 'no '
        print(f'  {met}  {said.says}: {finding.value_text} (limits {said.demanded})')
    print()
