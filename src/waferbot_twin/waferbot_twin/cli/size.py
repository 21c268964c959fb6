# SPDX-License-Identifier: Apache-2.0
"""
Size motors, drives, belts and bearings: what an experiment asks of them, against what they bear.

The experiment counts as a duty cycle that is repeated for ever: RMS and peak force or torque, copper
loss, temperature of the windings in the steady state, I2T, voltage, loads of belts, cables, bearings.
With --fail-above the exit code is 1 if anything is above its limit.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict

from waferbot_twin.cli.console import new_table, print_json, result_console
from waferbot_twin.plain_values import finite, significant

EXAMPLES = (
    'waferbot size --model as_built --experiment wafer_exchange',
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
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run the experiment, print what everything bears."""
    from waferbot_lockstep.timing import Timing
    from waferbot_pmac.experiments import load_experiment
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model
    from waferbot_twin.sweep.sizing import largest_shares, size

    variant = Variant.of(load_model(options.model))
    rows = size(variant, load_experiment(options.experiment), Timing())
    above = [part for part, share in largest_shares(rows).items() if share > 1.0]
    if options.json:
        print_json({'rows': [dict(finite(asdict(row))) for row in rows], 'above': above})
        return int(bool(above) and options.fail_above)
    table = new_table('part', 'what', 'value', 'unit', 'limit', 'share')
    for column in table.columns[1:5:3]:
        column.justify = 'left'
    for row in rows:
        share = f'{100.0 * row.share:.0f} %' if math.isfinite(row.share) else ''
        table.add_row(row.part, row.what, significant(row.value, 4), row.unit, row.limit, share)
    result_console.print(table)
    print(f'above its limit: {", ".join(above)}' if above else 'nothing is above its limit')
    return int(bool(above) and options.fail_above)
