# SPDX-License-Identifier: Apache-2.0
"""
Look for the parameters of a model for which a measure of an experiment is smallest, within limits.

Differential evolution with a fixed seed. FILE gets the model with the best values. Exit code 1 if no
point keeps the limits.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.plain_values import significant

EXAMPLES = (
    'waferbot optimise --model rigid --vary pmac.y_linear.Ixx31=1000:3000 '
    '--vary pmac.y_linear.Ixx32=0:3000 --experiment step_y_linear '
    '--minimise settling_time.y_linear --limit "overshoot_percent.y_linear<30" --generations 4 '
    '--out optimised.yaml',
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
        '--minimise', required=True, metavar='FIGURE.AXIS', help='a measure, as in sweep'
    )
    parser.add_argument(
        '--limit', action='append', default=[], metavar='FIGURE.AXIS<VALUE',
        help='a measure that may not be above this',
    )  # fmt: skip
    parser.add_argument(
        '--generations', type=int, default=20, metavar='N',
        help='8 candidates for each parameter a generation (default: 20)',
    )  # fmt: skip
    parser.add_argument('--out', type=Path, metavar='FILE', help='a new file .yaml: the model')
    parser.add_argument('--force', action='store_true', help='replace the file at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Search, print the best point, write the model."""
    from waferbot_lockstep.atomic_files import write_text
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.sweep.evaluation import Task, check_measures
    from waferbot_twin.sweep.optimise import optimise, parse_limits
    from waferbot_twin.sweep.variation import parse_variations

    if not 1 <= options.generations <= 1000:
        raise UserError(f'--generations is {options.generations}; it must be 1 to 1000')
    if options.out is not None and options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    variant = Variant.of(load_model(options.model))
    variations = parse_variations(options.vary, variant)
    measures = check_measures([options.minimise], variant)
    limits = parse_limits(options.limit, variant)
    load_experiment(options.experiment)
    task = Task(variant, tuple(one.path for one in variations), options.experiment, measures)
    with progress_bar('optimising') as progress:
        best = optimise(task, variations, limits, options.generations, progress)
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
        print(f'{best.runs} runs' + ('' if best.kept else '; no point keeps the limits'))
    if options.out is not None:
        say(f'wrote {options.out}')
    return 0 if best.kept else 1
