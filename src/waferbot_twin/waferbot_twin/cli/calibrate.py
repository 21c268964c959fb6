# SPDX-License-Identifier: Apache-2.0
"""
Calibrate machine, tuning values and as-built machine to the tables of the thesis.

Four searches, one after another, each started from the shipped values and repeatable: payload
(Y-Linear and X-Rotate) and y_rotate for the nominal machine and its gains, as_built_payload and
as_built_y_rotate against the measured columns with the shipped machine and gains held, and against
RMS errors, signs of improvements and what the text says of its curves. Prints every row with its
distance from the thesis in tolerances and, with --out, writes:

  calibrated.yaml        the values found
  machine_overlay.yaml   what they set in the machine's description
  pmac.yaml              the I-variables
  as_built_overlay.yaml  the as-built machine's departures
  as_built_pmac.yaml     the I-variables in which its controller differs

--quick searches for a few generations only; --evaluate not at all: it prints what the shipped
values give. --start begins at other values: a calibrated.yaml that --out wrote, or parts of one.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import yaml

from waferbot_twin.cli.console import (
    new_table,
    print_json,
    progress_bar,
    result_console,
)
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

QUICK_GENERATIONS = 3
STAGES = ('payload', 'y_rotate', 'as_built_payload', 'as_built_y_rotate')

EXAMPLES = (
    'waferbot calibrate --evaluate --stage y_rotate',
    'waferbot calibrate --quick --out calibration',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot calibrate`."""
    parser.add_argument(
        '--stage', action='append', choices=STAGES, help='only this one (may be given twice)'
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument('--quick', action='store_true', help='a few generations, about a minute')
    how.add_argument('--evaluate', action='store_true', help='only evaluate, search nothing')
    parser.add_argument(
        '--start', type=Path, metavar='FILE', help='begin at the values of a calibrated.yaml'
    )
    add_workers(parser)
    parser.add_argument('--out', type=Path, metavar='DIR', help='write the result to this folder')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Search, print and write."""
    from waferbot_twin.calibration.search import STAGES as KNOWN
    from waferbot_twin.calibration.search import search
    from waferbot_twin.calibration.values import CALIBRATED, started_from

    output = OutputFolder(options.out, options.force) if options.out else None
    generations = 0 if options.evaluate else QUICK_GENERATIONS if options.quick else None
    start = started_from(options.start or CALIBRATED)
    values = start['payload'] | start['y_rotate']
    as_built = start['as_built_payload'] | start['as_built_y_rotate']
    result: dict[str, Any] = {}
    stages = options.stage or STAGES
    with workers_of(options) as workers:
        for number, name in enumerate(stages, 1):
            stage = KNOWN[name]
            begun_s = time.perf_counter()
            departs = name.startswith('as_built')
            begun_at = as_built if departs else values
            with progress_bar(f'calibrating {name} ({number} of {len(stages)})') as progress:
                found = search(stage, begun_at, generations, progress, workers)
            if departs:
                as_built = found
            else:
                values = found
            evaluation = stage.evaluate(found)
            result[name] = {
                'cost': evaluation.cost,
                'penalties': evaluation.penalties,
                'demands': evaluation.demands,
                'values': {unknown.name: found[unknown.name] for unknown in stage.unknowns},
                'rows': [
                    {**dataclasses.asdict(residual), 'tolerances': residual.tolerances}
                    for residual in evaluation.residuals
                ],
                'run_time_s': time.perf_counter() - begun_s,
            }
    kept = keep(output, lambda folder: _write(folder, values, as_built))
    if options.json:
        print_json(result)
    else:
        for name, stage_result in result.items():
            _print(name, stage_result)
    return kept.tell('written to {}')


def _print(name: str, result: dict[str, Any]) -> None:
    print(f'{name}: cost {result["cost"]:.4g}, {result["run_time_s"]:.1f} s')
    table = new_table('row', 'thesis', 'ours', 'difference %', 'tolerances')
    for row in result['rows']:
        difference = 100.0 * (row['ours'] - row['thesis']) / row['thesis']
        table.add_row(
            f'{row["axis"]}.{row["column"]}.{row["figure"]}',
            significant(row['thesis']),
            significant(row['ours']),
            significant(difference, 3),
            significant(row['tolerances'], 3),
        )
    result_console.print(table)
    for condition, penalty in result['penalties'].items():
        print(f'  {condition}: {"yes" if penalty == 0.0 else f"penalty {penalty:.3g}"}')
    demands = result['demands']
    if demands:
        missed = {name: distance for name, distance in demands.items() if distance > 0.0}
        print(
            f'  {len(demands) - len(missed)} of {len(demands)} signs, RMS errors and statements met'
        )
        for name, distance in missed.items():
            print(f'    not met: {name}, distance {distance:.2g}')
    print()


def _write(folder: Path, values: dict[str, float], as_built: dict[str, float]) -> None:
    from waferbot_twin.calibration.as_built import (
        as_built_machine,
        as_built_overlay,
        as_built_variables,
    )
    from waferbot_twin.calibration.nominal import candidate
    from waferbot_twin.calibration.part_data import machine_overlay
    from waferbot_twin.calibration.search import STAGES as KNOWN

    stages = {
        name: {
            unknown.name: float(
                f'{(as_built if name.startswith("as_built") else values)[unknown.name]:.6g}'
            )
            for unknown in stage.unknowns
        }
        for name, stage in KNOWN.items()
    }
    contents = {
        'calibrated.yaml': stages,
        'machine_overlay.yaml': machine_overlay(values),
        'pmac.yaml': {'/**/pmac': {'ros__parameters': candidate(values).variables}},
        'as_built_overlay.yaml': as_built_overlay(as_built),
        'as_built_pmac.yaml': {
            '/**/pmac': {
                'ros__parameters': as_built_variables(as_built, as_built_machine(as_built))
            }
        },
    }
    for file, content in contents.items():
        (folder / file).write_text(yaml.safe_dump(content, sort_keys=False), 'utf-8')
