# SPDX-License-Identifier: Apache-2.0
"""
Compare two recordings of the same motion: simulated against measured.

Figures of each axis' step beside each other with their percent difference (4.1), and the RMS error
of the whole response (4.2). With --before, a recording of an earlier model, also how much better
the first one does, the performance improvement (6.1).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console
from waferbot_twin.metrics import (
    FIGURES,
    RISE_RULES,
    percent_difference,
    performance_improvement,
)
from waferbot_twin.plain_values import significant
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.response import AxisResponse, axis_responses, rms_difference

EXAMPLES = (
    'waferbot run --experiment step_x_rotate --model rigid --engine inprocess --out runs/rigid',
    'waferbot run --experiment step_x_rotate --model flexible --engine inprocess --out runs/flexible',
    'waferbot compare runs/flexible runs/rigid',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot compare`."""
    parser.add_argument('simulated', type=Path, metavar='A', help='recording: the simulation')
    parser.add_argument('measured', type=Path, metavar='B', help='recording: the reference')
    parser.add_argument(
        '--before', type=Path, metavar='DIR', help='recording: the simulation before a change'
    )
    parser.add_argument('--rise', choices=RISE_RULES, default='first', help='default: first')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read, compare and print."""
    paths = [options.simulated, options.measured]
    paths += [options.before] if options.before else []
    recordings = [
        {response.axis: response for response in axis_responses(read_recording(path))}
        for path in paths
    ]
    result = {
        axis: compared
        for axis in recordings[0]
        if (compared := compare([recording[axis] for recording in recordings], options.rise))
    }
    if not result:
        raise UserError(f'no axis moves in both {options.simulated} and {options.measured}')
    if options.json:
        print_json(result)
        return 0
    for axis, rows in result.items():
        table = new_table(axis, *(key.replace('_', '\n') for key in next(iter(rows.values()))))
        for name, row in rows.items():
            table.add_row(name, *(significant(value) for value in row.values()))
        result_console.print(table, '')
    return 0


def compare(responses: list[AxisResponse], rise: str) -> dict[str, dict[str, Any]]:
    """
    Return the rows of one axis: simulated, measured and, where given, the simulation before.

    Empty if the axis does not move in the first two.
    """
    if any(not response.moves() for response in responses[:2]):
        return {}
    rows: dict[str, dict[str, Any]] = {}
    found = [response.metrics(rise) for response in responses]
    if all(found):
        for key, name in FIGURES.items():
            values = [getattr(metrics, key) for metrics in found]
            difference = percent_difference(values[0], values[1])
            rows[name] = {
                'simulated': values[0],
                'measured': values[1],
                'difference_percent': difference,
            }
            if len(values) > 2:
                before = percent_difference(values[2], values[1])
                rows[name] |= {
                    'before_percent': before,
                    'improvement_percent': performance_improvement(before, difference),
                }
    error = rms_difference(responses[0], responses[1])
    rows['RMS error'] = {'simulated': error, 'measured': None, 'difference_percent': None}
    if found[1] is not None:
        rows['RMS error']['difference_percent'] = 100.0 * error / abs(found[1].step)
    if len(responses) > 2:
        before = rms_difference(responses[2], responses[1])
        rows['RMS error'] |= {
            'before_percent': 100.0 * before / abs(found[1].step) if found[1] else None,
            'improvement_percent': performance_improvement(before, error),
        }
    return rows
