# SPDX-License-Identifier: Apache-2.0
"""
Vary parameters of a model over a grid or a sample, run an experiment at every point, and measure.

Method saltelli gives sensitivities as well: what share of a measure's variance each parameter explains.
On all cores; what is done is kept beside DIR, so that a sweep that was broken off goes on when it is
started again. DIR gets sweep.parquet, sweep.png and sweep.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.seeds import add_seed
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

METHODS = ('grid', 'sobol', 'saltelli')

EXAMPLES = (
    'waferbot sweep --model rigid --vary pmac.y_rotate.Ixx30=3000:7000:3 '
    '--vary pmac.y_rotate.Ixx31=2500:4500:3 --experiment step_y_rotate '
    '--measure settling_time.y_rotate --out sweep',
    'waferbot sweep --model rigid --method saltelli --samples 16 '
    '--vary bodies.carriage.mass_kg=4:6 --vary bodies.counterweight.mass_kg=35:45 '
    '--experiment step_y_linear --measure overshoot_percent.y_linear',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot sweep`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE', help='default: as_built'
    )
    parser.add_argument(
        '--vary', action='append', default=[], required=True, metavar='PATH=LOW:HIGH[:N]',
        help='a parameter, by the paths of identify; N values in a grid (default 5)',
    )  # fmt: skip
    parser.add_argument('--experiment', default='step', metavar='NAME|FILE', help='default: step')
    parser.add_argument(
        '--measure', action='append', default=[], required=True, metavar='FIGURE.AXIS',
        help='settling_time, overshoot_percent, rms_following_error, peak_following_error, '
        'rms_current_a, peak_current_a, winding_temperature_degc, or load_percent.PART (see size)',
    )  # fmt: skip
    parser.add_argument('--method', choices=METHODS, default='grid', help='default: grid')
    parser.add_argument(
        '--samples', type=int, default=128, metavar='N',
        help='points of sobol; of saltelli N x (parameters + 2) (default: 128)',
    )  # fmt: skip
    add_seed(parser, 'of the points')
    add_workers(parser)
    parser.add_argument('--out', type=Path, metavar='DIR', help='a new folder for the result')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run the points, write the table, print what came out."""
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.sweep import report, sweep
    from waferbot_twin.sweep.evaluation import Task, check_measures
    from waferbot_twin.sweep.sensitivity import sensitivities
    from waferbot_twin.sweep.variation import MOST_POINTS, parse_variations, points

    if not 1 <= options.samples <= MOST_POINTS:
        raise UserError(f'--samples is {options.samples}; it must be 1 to {MOST_POINTS}')
    variant = Variant.of(load_model(options.model))
    variations = parse_variations(options.vary, variant)
    measures = check_measures(options.measure, variant)
    load_experiment(options.experiment)
    made = points(variations, options.method, options.samples, options.seed)
    paths = tuple(one.path for one in variations)
    task = Task(variant, paths, options.experiment, measures)
    if options.out is not None:
        report.check_writable()
    output = None if options.out is None else OutputFolder(options.out, options.force)
    parts = None if options.out is None else sweep.parts_folder(options.out)
    with workers_of(options) as workers, progress_bar(f'{len(made)} points') as progress:
        table = sweep.run(task, made, workers, parts, progress)
    found = None
    if options.method == 'saltelli':
        try:
            found = sensitivities(variations, table, measures, options.seed)
        except UserError as error:
            say(f'waferbot: {error}')
    kept = keep(output, lambda folder: report.write(table, measures, found, folder))
    if parts is not None and kept.as_asked:
        sweep.forget(parts)
    result = report.summary(table, measures, found)
    if options.json:
        print_json(result)
    else:
        _print(result, paths)
    return kept.tell(f'table: {{0}}/{report.FILES[0]}; picture: {{0}}/{report.FILES[1]}')


def _print(result: dict[str, object], paths: tuple[str, ...]) -> None:
    from waferbot_twin.sweep import report

    table = new_table('measure', 'least', 'median', 'largest', 'numbers', 'least at')
    table.columns[-1].justify, table.columns[-1].no_wrap = 'left', False
    measures = result['measures']
    assert isinstance(measures, dict)
    for name, row in measures.items():
        if row is None:
            table.add_row(name, '-', '-', '-', '0', '')
            continue
        at = ', '.join(f'{path} {row["least_at"][path]:.5g}' for path in paths)
        numbers = (significant(row[key], 4) for key in ('least', 'median', 'largest'))
        table.add_row(name, *numbers, str(row['numbers']), at)
    result_console.print(table)
    rows = result['sensitivities']
    if isinstance(rows, list):
        table = new_table('parameter', 'measure', 'first order', 'total')
        for row in rows:
            table.add_row(
                row['parameter'],
                row['measure'],
                f'{row["first"]:.3f} ± {row["first_95"]:.3f}',
                f'{row["total"]:.3f} ± {row["total_95"]:.3f}',
            )
        result_console.print('', table)
    print(f'{result["points"]} points, {result["failed"]} of them failed')
    errors = result['errors']
    assert isinstance(errors, list)
    if errors:
        others = (
            f' ({len(errors) - 1} other reasons: {report.FILES[2]})' if len(errors) > 1 else ''
        )
        print(f'failed: {errors[0]}{others}')
