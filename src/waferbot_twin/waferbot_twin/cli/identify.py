# SPDX-License-Identifier: Apache-2.0
"""
Identify named parameters of a model from measured logs, with intervals and what stays open.

  waferbot identify LOG... --parameter bodies.carriage.mass_kg --parameter pmac.y_linear.Ixx30 --out DIR

A parameter is a path into the machine's description, pmac.AXIS.NAME or copley.AXIS.NAME. It may become
ten times larger or smaller, or what PATH=low:high says. DIR gets report.html, report.json and
identified.yaml, a model that every node and engine loads: waferbot run --model DIR/identified.yaml.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot identify`."""
    parser.add_argument('measured', nargs='+', type=Path, metavar='LOG', help='logs to fit')
    parser.add_argument(
        '--parameter', action='append', required=True, metavar='PATH[=low:high]',
        help='a parameter to identify (may be given several times)',
    )  # fmt: skip
    parser.add_argument(
        '--validate', nargs='+', type=Path, default=[], metavar='OTHER',
        help='logs with another motion, in which the gain is measured',
    )  # fmt: skip
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument('--out', type=Path, metavar='DIR', help='write report and model here')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print report.json')


def execute(options: argparse.Namespace) -> int:
    """Identify, write the report, print the table."""
    from waferbot_twin.diagnosis.diagnose import load_records
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.identification.identify import identify
    from waferbot_twin.identification.named_parameters import parse_all
    from waferbot_twin.identification.report import as_dict, remarks, table_rows, write
    from waferbot_twin.models import load_model

    nominal = Variant.of(load_model(options.model))
    parameters = parse_all(options.parameter, nominal)
    records = load_records(options.measured, nominal)
    judging = load_records(options.validate, nominal)
    output = None if options.out is None else OutputFolder(options.out, options.force)
    with progress_bar('identification') as progress:
        result = identify(nominal, records, judging, parameters, progress)
    kept = keep(output, lambda folder: write(result, folder))
    if options.json:
        print_json(as_dict(result))
        return kept.tell('report: {}/report.html')
    table = new_table('parameter', 'unit', 'model', 'identified', '95 % from', 'to')
    for row in table_rows(result):
        table.add_row(*row)
    result_console.print(table)
    for line in remarks(result):
        print(line)
    for item in result.gains:
        print(
            f'{item.log}, {item.axis}: RMS error {item.rms_before:.4g} to {item.rms_after:.4g} '
            f'{item.unit}, {item.improvement_percent:.1f} %'
        )
    return kept.tell('report: {}/report.html')
