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

from waferbot_lockstep.contract import AXES, axes_mask
from waferbot_lockstep.errors import UserError
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
    parser.add_argument(
        '--axes', default=','.join(AXES), metavar='A,B', help='axes it drives (default: all)'
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
    names = [name.strip() for name in options.axes.split(',') if name.strip()]
    if not names or not set(names) <= set(AXES):
        raise UserError(f'--axes {options.axes}: give one or more of {", ".join(AXES)}')
    unknown = [name for name in options.check if name not in kit.CHECKS]
    if unknown:
        raise UserError(f'--check {unknown[0]}: the checks are {", ".join(kit.CHECKS)}')
    command = [word for word in options.program if word != '--'] or [
        *(sys.executable, '-m', f'waferbot_{options.node}.node')
    ]
    checks = options.check or list(kit.CHECKS)
    findings = []
    with progress_bar(f'checking {options.node}') as progress:
        for finding in kit.conform(options.node, command, axes_mask(names), checks):
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
