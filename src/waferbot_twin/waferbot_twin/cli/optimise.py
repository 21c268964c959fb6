# SPDX-License-Identifier: Apache-2.0
"""
Look for the parameters of a model for which a measure of an experiment is smallest, within limits.

Differential evolution with a fixed seed. FILE gets the model with the best values. Exit code 1 if no
point keeps the limits.

With several --minimise the Pareto front: points of which none can be better in one measure without
being worse in another; by NSGA-II, which needs pymoo. DIR gets points.parquet (all points that were
run), front.png, front.json, and the model of every point of the front.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

if TYPE_CHECKING:
    from waferbot_twin.sweep.evaluation import Task
    from waferbot_twin.sweep.limits import Limit
    from waferbot_twin.sweep.variation import Variation

EXAMPLES = (
    'waferbot optimise --model rigid --vary pmac.y_linear.Ixx31=1000:3000 '
    '--vary pmac.y_linear.Ixx32=0:3000 --experiment step_y_linear '
    '--minimise settling_time.y_linear --limit "overshoot_percent.y_linear<30" --generations 4 '
    '--out optimised.yaml',
    'waferbot optimise --model rigid --vary pmac.y_rotate.Ixx30=2000:8000 '
    '--vary pmac.y_rotate.Ixx31=2000:8000 --experiment step_y_rotate '
    '--minimise rms_following_error.y_rotate --minimise peak_current_a.y_rotate '
    '--limit "overshoot_percent.y_rotate<40" --generations 4 --out front',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot optimise`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE', help='default: as_built'
    )
    parser.add_argument(
        '--vary', action='append', required=True, metavar='PATH=LOW:HIGH',
        help='a parameter and its range, by the paths of identify',
    )  # fmt: skip
    parser.add_argument('--experiment', default='step', metavar='NAME|FILE', help='default: step')
    parser.add_argument(
        '--minimise', action='append', required=True, metavar='FIGURE.AXIS',
        help='a measure, as in sweep; several of them: their Pareto front',
    )  # fmt: skip
    parser.add_argument(
        '--limit', action='append', default=[], metavar='FIGURE.AXIS<VALUE',
        help='a measure that may not be above this',
    )  # fmt: skip
    parser.add_argument(
        '--generations', type=int, default=20, metavar='N',
        help='8 candidates for each parameter a generation, of a front at least 40 (default: 20)',
    )  # fmt: skip
    add_workers(parser)
    parser.add_argument(
        '--out', type=Path, metavar='FILE|DIR',
        help='a new file .yaml: the model; with several --minimise a new folder',
    )  # fmt: skip
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Search, print the best point or the front, write its models."""
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.sweep.evaluation import Task, check_measures
    from waferbot_twin.sweep.limits import parse_limits
    from waferbot_twin.sweep.variation import parse_variations

    if not 1 <= options.generations <= 1000:
        raise UserError(f'--generations is {options.generations}; it must be 1 to 1000')
    variant = Variant.of(load_model(options.model))
    variations = parse_variations(options.vary, variant)
    measures = check_measures(options.minimise, variant)
    limits = parse_limits(options.limit, variant)
    load_experiment(options.experiment)
    task = Task(variant, tuple(one.path for one in variations), options.experiment, measures)
    return (_best if len(measures) == 1 else _front)(options, task, variations, limits)


def _best(
    options: argparse.Namespace,
    task: Task,
    variations: Sequence[Variation],
    limits: Sequence[Limit],
) -> int:
    from waferbot_lockstep.atomic_files import write_text
    from waferbot_twin.sweep.optimise import optimise

    if options.out is not None and options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    with workers_of(options) as workers, progress_bar('optimising') as progress:
        best = optimise(task, variations, limits, options.generations, workers, progress)
    if options.out is not None:
        try:
            write_text(options.out, best.variant.text)
        except OSError as error:
            raise UserError(f'--out {options.out} cannot be written: {error.strerror}') from error
    result = {
        'schema': 1, 'point': best.point, 'measures': best.measures, 'before': best.before,
        'limits_kept': best.kept, 'runs': best.runs,
    }  # fmt: skip
    if options.json:
        print_json(result)
    else:
        table = new_table('', 'before', 'best')
        for one in variations:
            table.add_row(one.path, f'{one.parameter.start:.6g}', f'{best.point[one.path]:.6g}')
        for name, value in best.measures.items():
            table.add_row(name, significant(best.before[name], 4), significant(value, 4))
        result_console.print(table)
        print(_in_all(best.runs, best.kept))
    if options.out is not None:
        say(f'wrote {options.out}')
    return 0 if best.kept else 1


def _front(
    options: argparse.Namespace,
    task: Task,
    variations: Sequence[Variation],
    limits: Sequence[Limit],
) -> int:
    from waferbot_twin.sweep.front_report import FILES, summary, write
    from waferbot_twin.sweep.pareto import pareto_front
    from waferbot_twin.sweep.report import check_writable

    output = None
    if options.out is not None:
        check_writable()
        output = OutputFolder(options.out, options.force)
    with workers_of(options) as workers, progress_bar('optimising') as progress:
        found = pareto_front(task, variations, limits, options.generations, workers, progress)
    kept = keep(output, lambda folder: write(found, folder))
    if options.json:
        print_json(summary(found))
    else:
        names = [*found.paths, *found.measures]
        table = new_table('', *(name.replace('.', '.\n') for name in names))
        starts = [f'{one.parameter.start:.6g}' for one in variations]
        table.add_row(
            'before', *starts, *(significant(found.before[name], 4) for name in found.measures)
        )
        for number, (_, row) in enumerate(found.front.iterrows(), 1):
            points = [f'{row[path]:.6g}' for path in found.paths]
            table.add_row(
                str(number), *points, *(significant(row[name], 4) for name in found.measures)
            )
        result_console.print(table)
        print(_in_all(len(found.points), bool(found.variants)))
    told = kept.tell(f'picture: {{0}}/{FILES[1]}; all points: {{0}}/{FILES[0]}')
    return told or (0 if found.variants else 1)


def _in_all(runs: int, kept: bool) -> str:
    return f'{runs} runs' + ('' if kept else '; no point keeps the limits')
