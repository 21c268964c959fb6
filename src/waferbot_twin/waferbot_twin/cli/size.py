# SPDX-License-Identifier: Apache-2.0
"""
Size motors, drives, belts and bearings: what an experiment asks of them, against what they bear.

The experiment counts as a duty cycle that is repeated for ever: RMS and peak force or torque, copper
loss, temperature of the windings in the steady state, I2T, voltage, loads of belts, cables, bearings.
With --fail-above the exit code is 1 if anything is above its limit. --out keeps it, with force over
speed of every motor as a picture.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from waferbot_twin.cli.console import new_table, print_json, result_console
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant

EXAMPLES = (
    'waferbot size --model as_built --experiment wafer_exchange --out sizing',
    'waferbot size --model flexible --experiment step_y_rotate --json',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot size`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE', help='default: as_built'
    )
    parser.add_argument(
        '--experiment', default='wafer_exchange', metavar='NAME|FILE',
        help='the duty cycle (default: wafer_exchange)',
    )  # fmt: skip
    parser.add_argument(
        '--fail-above', action='store_true', help='exit with 1 if anything is above its limit'
    )
    parser.add_argument(
        '--out', type=Path, metavar='DIR', help='a new folder for result and picture'
    )
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run the experiment, print what everything bears."""
    from waferbot_lockstep.timing import Timing
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.sweep import sizing_report
    from waferbot_twin.sweep.sizing import size

    variant = Variant.of(load_model(options.model))
    experiment = load_experiment(options.experiment)
    output = None if options.out is None else OutputFolder(options.out, options.force)
    found = size(variant, experiment, Timing())
    title = f'{experiment.name} on {variant.name}, repeated for ever'
    kept = keep(output, lambda folder: sizing_report.write(found, title, variant.titles, folder))
    result = sizing_report.as_dict(found)
    above = result['above']
    code = kept.tell(f'picture: {{}}/{sizing_report.FILES[1]}') or int(
        bool(above) and options.fail_above
    )
    if options.json:
        print_json(result)
        return code
    table = new_table('part', 'what', 'value', 'unit', 'limit', 'share')
    for column in table.columns[1:5:3]:
        column.justify = 'left'
    for row in found.rows:
        share = f'{100.0 * row.share:.0f} %' if math.isfinite(row.share) else ''
        table.add_row(row.part, row.what, significant(row.value, 4), row.unit, row.limit, share)
    result_console.print(table)
    print(f'above its limit: {", ".join(above)}' if above else 'nothing is above its limit')
    return code
