# SPDX-License-Identifier: Apache-2.0
"""
Check a node of your own against the contract, and say what it does right and wrong.

The node, a PMAC or a Copley in any language, is started anew for each check, with ROS_DOMAIN_ID set; the
kit speaks for all its peers in lock-step. `tolerated` is what does no harm as long as the peers make no
mistakes. The exit code is 1 if anything is wrong. The contract: docs/contract.md.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict

from rich.table import Table

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.node_settings import MACHINE_AXES, MACHINE_ENCODERS
from waferbot_plant.description_file import described_layout
from waferbot_plant.plant import description_source
from waferbot_twin.cli.console import print_json, progress_bar, result_console
from waferbot_twin.engines.with_ros import engine_with_ros

EXAMPLES = (
    'waferbot conform --node pmac ./my_controller --gains gains.txt',
    'waferbot conform --node copley',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot conform`."""
    parser.add_argument(
        '--node', choices=('pmac', 'copley'), required=True, help='whose place it takes'
    )
    parser.add_argument('--axes', metavar='A,B', help='axes it drives (default: all)')
    parser.add_argument(
        '--description',
        metavar='MACHINE',
        help='whose axes there are (default: the shipped machine)',
    )
    parser.add_argument(
        '--check', action='append', default=[], metavar='NAME', help='only this check'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    parser.add_argument(
        'program', nargs=argparse.REMAINDER, metavar='COMMAND ...',
        help='starts the node (default: the one of waferbot)',
    )  # fmt: skip


def execute(options: argparse.Namespace) -> int:
    """Check, and print what was found."""
    kit = engine_with_ros('conformance')
    layout = SHIPPED
    if options.description is not None:
        layout = described_layout(description_source(options.description))
    names = list(layout.axes)
    if options.axes is not None:
        names = [name.strip() for name in options.axes.split(',') if name.strip()]
    if not names or not set(names) <= set(layout.axes):
        raise UserError(f'--axes {options.axes}: give one or more of {", ".join(layout.axes)}')
    unknown = [name for name in options.check if name not in kit.CHECKS]
    if unknown:
        raise UserError(f'--check {unknown[0]}: the checks are {", ".join(kit.CHECKS)}')
    command = [word for word in options.program if word != '--'] or [
        *(sys.executable, '-m', f'waferbot_{options.node}.node'),
        *_told(layout),
    ]
    checks = options.check or list(kit.CHECKS)
    findings = []
    with progress_bar(f'checking {options.node}') as progress:
        for finding in kit.conform(options.node, command, names, checks, layout):
            findings.append(finding)
            progress(len(findings), len(checks))
    if options.json:
        print_json([asdict(finding) for finding in findings])
    else:
        table = Table(title=f'{" ".join(command)} as {options.node}')
        for heading in ('check', 'grade', 'what it did'):
            table.add_column(heading)
        for finding in findings:
            table.add_row(finding.check, finding.grade, finding.text)
        result_console.print(table)
    return 1 if any(finding.grade == kit.WRONG for finding in findings) else 0


def _told(layout: Layout) -> list[str]:
    """Return the arguments by which our node is told the axes of a machine that has its own."""
    if layout == SHIPPED:
        return []
    named = {MACHINE_AXES: layout.axes, MACHINE_ENCODERS: layout.encoders}
    return [
        '--ros-args',
        *(word for name, own in named.items() for word in ('-p', f'{name}:=[{", ".join(own)}]')),
    ]
