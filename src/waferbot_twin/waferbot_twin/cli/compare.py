# SPDX-License-Identifier: Apache-2.0
"""
Compare two recordings or imported logs of the same motion: simulated against measured.

  waferbot compare A B              simulated A, measured B
  waferbot compare LOG --model M    what the closed loop of M does by the commanded positions of LOG

Figures of each axis' step beside each other with their percent difference (4.1), and the RMS error
of the whole response (4.2). With --before, a recording of an earlier model, also how much better
the first one does, the performance improvement (6.1).

With --out an overlay of all signals that both have: one MCAP with /measured, /simulated and /residual,
aligned by the beginning of the commanded motion, for PlotJuggler and Foxglove, and overlay.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.logs.load import load_log
from waferbot_twin.logs.measured import MeasuredLog
from waferbot_twin.metrics import (
    FIGURES,
    RISE_RULES,
    percent_difference,
    performance_improvement,
)
from waferbot_twin.models import recorded_titles
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant
from waferbot_twin.recording.reader import header_of
from waferbot_twin.response import AxisResponse, rms_difference
from waferbot_twin.response_reader import load_responses, log_responses

EXAMPLES = (
    'waferbot run --experiment step_x_rotate --model rigid --engine inprocess --out runs/rigid',
    'waferbot run --experiment step_x_rotate --model flexible --engine inprocess --out runs/flexible',
    'waferbot compare runs/flexible runs/rigid',
    'waferbot compare logs/measured --model rigid --out overlays/compared',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot compare`."""
    parser.add_argument(
        'simulated', type=Path, metavar='A', help='the simulation; with --model the measured log'
    )
    parser.add_argument('measured', type=Path, metavar='B', nargs='?', help='the reference')
    parser.add_argument(
        '--model', metavar='NAME|FILE', help='run the closed loop of this model for the log A'
    )
    parser.add_argument(
        '--before', type=Path, metavar='DIR', help='recording: the simulation before a change'
    )
    parser.add_argument('--rise', choices=RISE_RULES, default='first', help='default: first')
    parser.add_argument('--out', type=Path, metavar='DIR', help='a new folder for the overlay')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read, compare, print and write the overlay."""
    if (options.measured is None) == (options.model is None):
        raise UserError('give two recordings or logs, or one log and --model')
    if options.out is not None:
        OutputFolder(options.out, options.force)  # nobody waits for what cannot be written
    logs: tuple[MeasuredLog, MeasuredLog] | None = None
    if options.model is not None:
        logs, titles = _simulated_and_measured(options.simulated, options.model)
        read = [log_responses(log) for log in logs]
    else:
        read = [_responses(path) for path in (options.simulated, options.measured)]
        titles = recorded_titles(header_of(options.simulated))
        if options.out is not None:
            logs = (load_log(options.simulated), load_log(options.measured))
    read += [_responses(options.before)] if options.before else []
    recordings = [{response.axis: response for response in responses} for responses in read]
    result = {
        axis: compared
        for axis in recordings[0]
        if all(axis in recording for recording in recordings)
        and (compared := compare([recording[axis] for recording in recordings], options.rise))
    }
    if not result:
        both = f'{options.simulated} and {options.measured or options.model}'
        raise UserError(f'no axis moves in both {both}')
    if options.json:
        print_json(result)
    else:
        _print(result, titles)
    if options.out is not None and logs is not None:
        _write_overlay(*logs, options)
    return 0


def _responses(path: Path) -> list[AxisResponse]:
    with progress_bar(f'reading {path.name}') as progress:
        return load_responses(path, progress)


def _simulated_and_measured(
    path: Path, model: str
) -> tuple[tuple[MeasuredLog, MeasuredLog], Mapping[str, str]]:
    """Return what a model does by the commands of a log, the log, and what the model calls its axes."""
    from waferbot_twin.comparison.pairs import in_closed_loop
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model_or_machine

    variant = Variant.of(load_model_or_machine(model))
    log, simulated = in_closed_loop(path, variant, model)
    return (simulated, log), variant.titles


def _write_overlay(
    simulated: MeasuredLog, measured: MeasuredLog, options: argparse.Namespace
) -> None:
    from waferbot_twin.comparison.overlay import write_overlay
    from waferbot_twin.comparison.pairs import later_s, traces_of

    later = 0.0 if options.model else later_s(simulated, measured)
    traces = traces_of(simulated, measured, later)
    if not traces:
        raise UserError(f'{options.out}: the logs have no signal at the same times; not written')
    about = {
        'simulated': simulated.name,
        'measured': measured.name,
        'simulated_moved_by_s': later,
    }
    write_overlay(traces, about, options.out, options.force)
    say(f'overlay: {options.out}' + (f', A moved by {later:+.6g} s' if later else ''))


def _print(result: dict[str, dict[str, dict[str, Any]]], titles: Mapping[str, str]) -> None:
    for axis, rows in result.items():
        table = new_table(
            titles[axis], *(key.replace('_', '\n') for key in next(iter(rows.values())))
        )
        for name, row in rows.items():
            table.add_row(name, *(significant(value) for value in row.values()))
        result_console.print(table, '')


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
