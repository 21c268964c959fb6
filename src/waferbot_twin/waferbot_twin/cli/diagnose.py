# SPDX-License-Identifier: Apache-2.0
"""
Find what the simulation of a measured log gets wrong, and why; extend the model; measure the gain.

  waferbot diagnose MEASURED... [--validate OTHER...] [--model NAME|FILE] --out DIR

Causes are found in MEASURED and judged by OTHER, logs with another motion; with a single log its
last part judges. DIR gets report.html (pictures first), report.json and extended.yaml, a model that
every node and engine loads: waferbot run --model DIR/extended.yaml.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, progress_bar, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot diagnose`."""
    parser.add_argument('measured', nargs='+', type=Path, help='logs to find causes in')
    parser.add_argument(
        '--validate', nargs='+', type=Path, default=[], metavar='OTHER', help='logs that judge'
    )
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='a new folder')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument(
        '--without', action='append', default=[], metavar='EFFECT',
        help='leave an effect out of the library',
    )  # fmt: skip
    parser.add_argument(
        '--workers', type=int, default=os.cpu_count() or 1, help='processes (default: all cores)'
    )
    parser.add_argument(
        '--cluster', metavar='ADDRESS', help='send the work to the Dask scheduler at this address'
    )
    parser.add_argument('--json', action='store_true', help='print report.json')


def execute(options: argparse.Namespace) -> int:
    """Diagnose, write the report, say the sentence."""
    from waferbot_twin.cli.print_diagnosis import print_diagnosis
    from waferbot_twin.cluster import cluster
    from waferbot_twin.diagnosis.diagnose import diagnose
    from waferbot_twin.diagnosis.report import as_dict, write
    from waferbot_twin.effects import find
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.html_page import prepare_folder
    from waferbot_twin.models import load_model_or_machine
    from waferbot_twin.residuals.load import load_records

    for name in options.without:
        find(name)
    if options.workers < 1:
        raise UserError(f'--workers is {options.workers}; it must be at least 1')
    nominal = Variant.of(load_model_or_machine(options.model))
    finding = load_records(options.measured, nominal)
    judging = load_records(options.validate, nominal)
    prepare_folder(options.out, options.force)
    with cluster(options.cluster) as cores, progress_bar('diagnosis') as bar:
        diagnosis = diagnose(
            nominal,
            finding,
            judging,
            lambda what, done, total: bar(done, total),
            cores or options.workers,
            options.without,
        )
    write(diagnosis, options.out)
    if options.json:
        print_json(as_dict(diagnosis))
        return 0
    print_diagnosis(diagnosis)
    say(f'report: {options.out / "report.html"}')
    return 0
