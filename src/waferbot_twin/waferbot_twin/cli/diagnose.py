# SPDX-License-Identifier: Apache-2.0
"""
Find what the simulation of a measured log gets wrong, and why; extend the model; measure the gain.

Causes and their values are those of all logs. What they gain is measured in OTHER, logs with another
motion, with the causes fitted to MEASURED alone; without OTHER, in the last part of each log. DIR gets
report.html (what was found, how sure, pictures), report.json and extended.yaml, a model that every node
and engine loads: waferbot run --model DIR/extended.yaml.

Exit codes: 0 done, 1 an error; with --fail-on, of what is met the first of
  3  unexplained  something stays unexplained
  4  cause        a cause was found
  5  loss         the extended model's RMS error on an axis of a validation log is more than 1 % larger
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, progress_of_stages
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder

if TYPE_CHECKING:
    import waferbot

CONDITIONS = {'unexplained': 3, 'cause': 4, 'loss': 5}
"""What --fail-on can ask for, and the exit code; 2 is that of a wrong command line."""

LOSS_PERCENT = 1.0
"""Increase of the RMS error from which on it is a loss."""

EXAMPLES = (
    'waferbot synthesize --effect viscous_friction:x_rotate --seed 1 --out logs/day1',
    'waferbot synthesize --effect viscous_friction:x_rotate --seed 2 --out logs/day2',
    'waferbot diagnose logs/day1 --validate logs/day2 --model rigid --out diagnosis',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot diagnose`."""
    parser.add_argument(
        'measured',
        nargs='+',
        type=Path,
        metavar='MEASURED',
        help='estimation data: logs in which causes are sought and fitted',
    )
    parser.add_argument(
        '--validate',
        nargs='+',
        type=Path,
        default=[],
        metavar='OTHER',
        help='validation data: logs that are not used for the fit',
    )
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='a new folder')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument(
        '--without', action='append', default=[], metavar='EFFECT',
        help='leave an effect out of the library',
    )  # fmt: skip
    parser.add_argument(
        '--library', type=Path, metavar='FILE',
        help='with --machine: what waferbot library keeps of earlier logs takes part',
    )  # fmt: skip
    parser.add_argument(
        '--machine', default='', metavar='NAME', help='which machine of it this is'
    )
    add_workers(parser)
    parser.add_argument(
        '--fail-on', action='append', default=[], choices=tuple(CONDITIONS),
        help='exit with another code if this is so (may be given several times; see above)',
    )  # fmt: skip
    parser.add_argument('--json', action='store_true', help='print report.json')


def execute(options: argparse.Namespace) -> int:
    """Diagnose, write the report, say the sentence."""
    import waferbot
    from waferbot_twin.cli.print_diagnosis import print_diagnosis
    from waferbot_twin.diagnosis.report import as_dict, write

    if options.library is not None and not options.machine:
        raise UserError(
            '--library is asked what it knows of one machine: say which with --machine'
        )
    model = waferbot.load_model(options.model)
    logs, validation = waferbot.load_logs(options.measured), waferbot.load_logs(options.validate)
    output = OutputFolder(options.out, options.force)
    with workers_of(options) as workers, progress_of_stages('diagnosis') as progress:
        result = waferbot.diagnose(
            model,
            logs,
            validation,
            without=options.without,
            workers=workers,
            progress=progress,
            library=options.library,
            machine=options.machine,
        )
    kept = keep(output, lambda folder: write(result.details, folder, result.reference))
    if options.json:
        print_json(as_dict(result.details, result.reference))
    else:
        print_diagnosis(result.details)
    return kept.tell('report: {}/report.html') or exit_code(result, options.fail_on)


def exit_code(result: waferbot.Diagnosis, conditions: Sequence[str]) -> int:
    """Return the exit code of the first of `CONDITIONS` that was asked for and is met, else 0."""
    met = {
        'unexplained': bool(len(result.unexplained)),
        'cause': bool(len(result.causes)),
        'loss': bool((result.gains['improvement_percent'] < -LOSS_PERCENT).any()),
    }
    return next((code for name, code in CONDITIONS.items() if name in conditions and met[name]), 0)
