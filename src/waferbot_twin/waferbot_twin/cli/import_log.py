# SPDX-License-Identifier: Apache-2.0
"""
Import a measured log: text, arrays or a recording become signals in SI units, in a recording.

LOG is a text file (CSV, PMAC gather, a drive's trace export), an array (.npy, .npz, .mat), or a
recording of ROS 2. --map says which column is which signal; recordings with the twin's own topics or
joint states do not need one. What cannot be used is left out and listed, with place and reason.
docs/log_mapping.md has the mapping file, docs/log_formats.md the form of what is written.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

from waferbot_twin.cli.console import print_json, result_console
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.plain_values import significant

EXAMPLES = (
    'waferbot import runs/measured --out logs/measured',
    'waferbot import scope.csv --map scope.yaml --out logs/scope',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot import`."""
    parser.add_argument('log', type=Path, metavar='LOG', help='file or recording folder')
    parser.add_argument(
        '--map', metavar='FILE', dest='mapping', help='mapping file, or the name of a shipped one'
    )
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='folder to write')
    parser.add_argument(
        '--model',
        metavar='NAME|FILE',
        help="settings behind the twin's topics (default: those in the recording)",
    )
    parser.add_argument(
        '--machine', metavar='NAME|FILE', help='machine description: counts, names of joints'
    )
    parser.add_argument(
        '--part', type=int, metavar='N', help='number for $part in the columns of the mapping'
    )
    for end in ('start', 'end'):
        parser.add_argument(
            f'--{end}', type=float, metavar='S',
            help=f"{end} of what is taken, in the log's own time, s (default: by the mapping)",
        )  # fmt: skip
    parser.add_argument('--name', help='name of the log (default: by mapping or file)')
    parser.add_argument('--force', action='store_true', help='replace a recording at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read, write and tell."""
    from waferbot_twin.logs.hold import evidence
    from waferbot_twin.logs.load import import_log

    log = import_log(
        options.log,
        options.out,
        options.mapping,
        options.model,
        options.machine,
        options.part,
        options.name,
        options.force,
        (options.start, options.end),
    )
    spoken = evidence(log)
    if options.json:
        holds = [one.as_dict() for one in spoken]
        print_json({'path': str(options.out), **log.describe(), 'between_samples': holds})
        return 0
    show(log)
    for one in spoken:
        more = f' (say hold: {one.speaks_for} in the mapping, if that is so)' * one.against
        result_console.print(f'  {one}{more}', soft_wrap=True)
    print(options.out)
    return 0


def show(log: MeasuredLog) -> None:
    """Print what a log holds and what was found wrong with it."""
    described = log.describe()
    result_console.print(f'{log.name}: usable {", ".join(described["usable_axes"])}')
    table = Table(box=None, pad_edge=False)
    headings = ('axis', 'kind', 'unit', 'samples', 'rate [Hz]', 'from [s]', 'to [s]', 'lowest',
                'highest', 'step', 'gaps')  # fmt: skip
    for place, heading in enumerate(headings):
        table.add_column(heading, justify='left' if place < 3 else 'right', no_wrap=True)
    for row in described['signals']:
        table.add_row(
            row['axis'],
            row['kind'],
            row['unit'],
            str(row['samples']),
            f'{row["rate_hz"]:.1f}',
            *(significant(row[key]) for key in ('start_s', 'end_s', 'lowest', 'highest')),
            significant(row['resolution']) if row['resolution'] else '-',
            str(row['gaps']),
        )
    result_console.print(table)
    signals = described['signals']
    for what, chosen in (
        ('held between samples', [row for row in signals if row['held']]),
        ('straight between samples', [row for row in signals if not row['held']]),
        ('rounded down', [row for row in signals if row['counting'] == 'floor']),
        ('rounded to the nearest step', [row for row in signals if row['counting'] == 'round']),
        ('averaged counts', [row for row in signals if row['counting'] == 'average']),
    ):
        if chosen:
            names = ', '.join(f'{row["axis"]}.{row["kind"]}' for row in chosen)
            result_console.print(f'  {what}: {names}', soft_wrap=True)
    for finding in log.findings:
        result_console.print(f'  {finding}', soft_wrap=True)
