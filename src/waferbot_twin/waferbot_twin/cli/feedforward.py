# SPDX-License-Identifier: Apache-2.0
"""
Compensation tables for the PMAC: what current a motion needs, by inverse dynamics of a model.

--kind tables gives the machine's own: gravity and cogging over position, friction over speed, with
Ixx35 for the inertia. --kind motion gives everything that this one experiment needs, over its time. The
experiment is run on a machine (--on) without and with them. DIR gets compensation.csv, model.yaml,
which takes it, feedforward.png and feedforward.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_twin.cli.console import new_table, print_json, result_console
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

KINDS = ('tables', 'motion')

EXAMPLES = (
    'waferbot feedforward --model as_built --experiment wafer_exchange --out compensated',
    'waferbot feedforward --model flexible --on as_built --experiment full_stroke_x_rotate '
    '--kind motion',
    'waferbot run --engine inprocess --model compensated/model.yaml --experiment wafer_exchange '
    '--out runs/compensated',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot feedforward`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE',
        help='where the tables come from, e.g. what a diagnosis extended (default: as_built)',
    )  # fmt: skip
    parser.add_argument(
        '--on', metavar='NAME|FILE', help='the machine that they are tried on (default: the model)'
    )
    parser.add_argument(
        '--experiment', default='wafer_exchange', metavar='NAME|FILE',
        help='a motion without steps (default: wafer_exchange)',
    )  # fmt: skip
    parser.add_argument('--kind', choices=KINDS, default='tables', help='default: tables')
    parser.add_argument('--out', type=Path, metavar='DIR', help='a new folder for the result')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Make the tables, run without and with them, print the gain, write the result."""
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.tuning import compensate as compensation

    output = None if options.out is None else OutputFolder(options.out, options.force)
    experiment = load_experiment(options.experiment)
    model = Variant.of(load_model(options.model))
    on = model if options.on is None else Variant.of(load_model(options.on))
    found = compensation.compensate(model, on, experiment, options.kind)
    kept = keep(output, lambda folder: compensation.write(found, folder))
    if options.json:
        print_json(compensation.as_dict(found))
    else:
        table = new_table('RMS following error', *compensation.CASES, 'unit', 'smaller by')
        for axis in found.axes:
            runs = [found.runs[case][axis] for case in compensation.CASES]
            table.add_row(
                axis,
                *(significant(run.rms_following_error, 3) for run in runs),
                runs[0].response.unit,
                f'{100.0 * found.gain(axis):.1f} %',
            )
        result_console.print(table)
    return kept.tell(
        f'tables: {{0}}/{compensation.FILES[0]}; model: {{0}}/{compensation.FILES[1]}'
    )
