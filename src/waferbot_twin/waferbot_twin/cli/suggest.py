# SPDX-License-Identifier: Apache-2.0
"""
Suggest the experiment that tells causes apart which the logs at hand cannot separate.

REPORT is the folder of a diagnosis. Every experiment of the library and some designed ones are
simulated with each of the causes in the machine; the best is written to DIR/experiment.yaml, which
waferbot run and waferbot synthesize take.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.seeds import add_seed
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder

SHOWN = 12
"""Experiments that are printed; all are in the report."""

EXAMPLES = (
    'waferbot suggest diagnosis --out next',
    'waferbot suggest --rivals coulomb_friction:x_rotate viscous_friction:x_rotate --out apart',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot suggest`."""
    parser.add_argument(
        'report', nargs='?', type=Path, metavar='REPORT', help='the folder of a diagnosis'
    )
    parser.add_argument(
        '--rivals', nargs='+', default=[], metavar='EFFECT:AXIS[,KEY=VALUE...]',
        help='causes to tell apart, in place of a report; values that are not given are typical',
    )  # fmt: skip
    parser.add_argument(
        '--cause', metavar='EFFECT:AXIS', help='which cause of the report (default: the first)'
    )
    parser.add_argument(
        '--model', metavar='NAME|FILE', help='default: that of the report, else rigid'
    )
    parser.add_argument('--noise', type=float, default=1.0, help='level of the noise (default 1)')
    add_seed(parser, 'of the noise')
    parser.add_argument(
        '--without', action='append', default=[],
        choices=('commanded', 'currents', 'command', 'voltages'),
        help='signals that the logs do not have',
    )  # fmt: skip
    parser.add_argument('--out', type=Path, metavar='DIR', help='a new folder for the experiment')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    add_workers(parser)
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Rate the experiments, print the table, write the best."""
    from waferbot_lockstep.timing import Timing
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.residuals.problem import apply_all
    from waferbot_twin.suggestion.report import as_dict, remainder, sentence, table_rows, write
    from waferbot_twin.suggestion.rivals import named, of_report, read_report
    from waferbot_twin.suggestion.separation import Machine
    from waferbot_twin.suggestion.suggest import suggest

    if (options.report is None) == (not options.rivals):
        raise UserError('give either the report of a diagnosis or --rivals')
    if not 0.0 < options.noise <= 100.0:
        raise UserError(f'--noise is {options.noise:g}; it must be above 0 and at most 100')
    report = {} if options.report is None else read_report(options.report)
    variant = Variant.of(load_model(options.model or report.get('model', 'rigid')))
    group = (
        of_report(report, variant, options.cause)
        if options.report is not None
        else named(options.rivals, variant)
    )
    output = None if options.out is None else OutputFolder(options.out, options.force)
    machine = Machine(
        apply_all(variant, group.others),
        options.noise,
        options.seed,
        Timing(),
        tuple(options.without),
    )
    with workers_of(options) as workers, progress_bar('simulating experiments') as progress:
        found = suggest(machine, group.rivals, progress, workers)
    kept = keep(output, lambda folder: write(found, folder))
    what = 'report: {}/report.json' if found.best is None else 'experiment: {}/experiment.yaml'
    if options.json:
        print_json(as_dict(found))
        return kept.tell(what)
    table = new_table(
        'experiment', '2 ln L', 'x detectable', 'length [s]', 'speed [%]', 'current [%]'
    )
    for row in table_rows(found)[:SHOWN]:
        table.add_row(*row)
    result_console.print(table)
    print(remainder(found, SHOWN))
    print(sentence(found))
    return kept.tell(what)
