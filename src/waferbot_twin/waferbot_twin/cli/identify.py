# SPDX-License-Identifier: Apache-2.0
"""
Identify parameters of a machine from measured logs, with intervals and what stays open.

With --method simulation (the default) each --parameter is a path into the machine's description,
pmac.AXIS.NAME or copley.AXIS.NAME, and may become ten times larger or smaller, or what PATH=low:high
says. DIR gets report.html, report.json and identified.yaml, a model that every node and engine loads:
waferbot run --model DIR/identified.yaml; of a machine alone, a description.

With --method least-squares no parameter is named and no model is needed: mass or inertia, viscous and
Coulomb friction and offset of each axis by inverse dynamics. --model only says the force per ampere
where the log has a current and no force. DIR gets report.html and report.json.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.cli.keeping import keep
from waferbot_twin.cli.workers import add_workers, workers_of
from waferbot_twin.output_folder import OutputFolder

if TYPE_CHECKING:
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.identification.least_squares import Options

SIMULATION, LEAST_SQUARES = 'simulation', 'least-squares'
TERMS = ('direction', 'rise')

EXAMPLES = (
    'waferbot run --experiment random_y_linear --engine inprocess --duration 1 --out logs/motion',
    'waferbot identify logs/motion --parameter bodies.carriage.mass_kg --out identified',
    'waferbot identify logs/motion --method least-squares --out friction',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot identify`."""
    parser.add_argument('measured', nargs='+', type=Path, metavar='LOG', help='logs to fit')
    parser.add_argument(
        '--method', choices=(SIMULATION, LEAST_SQUARES), default=SIMULATION,
        help='simulation: named parameters (default); least-squares: inverse dynamics',
    )  # fmt: skip
    parser.add_argument(
        '--parameter', action='append', default=[], metavar='PATH[=low:high]',
        help='a parameter to identify (may be given several times)',
    )  # fmt: skip
    parser.add_argument(
        '--library', type=Path, metavar='FILE',
        help='ranges of parameters without one, as waferbot library keeps them',
    )  # fmt: skip
    parser.add_argument(
        '--machine', default='', metavar='NAME',
        help='which machine of the library this is: what is known of it takes part, as readings do',
    )  # fmt: skip
    parser.add_argument(
        '--validate', nargs='+', type=Path, default=[], metavar='OTHER',
        help='logs with another motion, in which the gain, or the error, is measured',
    )  # fmt: skip
    parser.add_argument(
        '--model', metavar='NAME|FILE',
        help='a model, or the description of a machine alone (default: rigid; for least squares none)',
    )  # fmt: skip
    add_workers(parser)
    of_squares = parser.add_argument_group('with --method least-squares')
    of_squares.add_argument(
        '--with', dest='terms', action='append', default=[], metavar='TERM',
        help='direction: viscous friction by direction; rise: friction that falls or rises from rest '
        'with speed; sine=N,...: sines of the position, N '
        'per turn or per metre (sine=1 is gravity on an axis that turns). May be given several times',
    )  # fmt: skip
    of_squares.add_argument(
        '--cut-off', type=float, metavar='HZ', help='of the filter (default: by the noise)'
    )
    of_squares.add_argument(
        '--dead-zone', type=float, default=0.0, metavar='SPEED',
        help='m/s or rad/s below which samples are left out (default: by the noise)',
    )  # fmt: skip
    of_squares.add_argument(
        '--late', dest='late_ms', type=float, metavar='MS',
        help='how late the drive stands against the position (default: found from the logs)',
    )  # fmt: skip
    of_squares.add_argument(
        '--map', dest='mapping', metavar='FILE', help='mapping of logs that are not imported yet'
    )
    parser.add_argument('--out', type=Path, metavar='DIR', help='write report and model here')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print report.json')


def execute(options: argparse.Namespace) -> int:
    """Identify, write the report, print the table."""
    if options.method == LEAST_SQUARES:
        for name in ('library', 'machine', 'cluster'):
            if getattr(options, name):
                raise UserError(f'--{name} belongs to --method simulation')
        if options.parameter:
            raise UserError(
                '--method least-squares names its parameters itself; leave --parameter out'
            )
        return _least_squares(options)
    if not options.parameter:
        raise UserError(
            'name what to identify: --parameter PATH, or give --method least-squares, which needs '
            'no names'
        )
    for name, value in (
        ('--with', options.terms), ('--cut-off', options.cut_off),
        ('--dead-zone', options.dead_zone), ('--late', options.late_ms is not None),
        ('--map', options.mapping),
    ):  # fmt: skip
        if value:
            raise UserError(f'{name} belongs to --method least-squares')
    return _simulation(options)


def _simulation(options: argparse.Namespace) -> int:
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.identification.identify import identify
    from waferbot_twin.identification.named_parameters import parse_all
    from waferbot_twin.identification.report import as_dict, remarks, table_rows, write
    from waferbot_twin.library.known import read_known
    from waferbot_twin.models import load_model_or_machine
    from waferbot_twin.residuals.load import load_records

    nominal = Variant.of(load_model_or_machine(options.model or 'rigid'))
    known = read_known(options.library, options.machine)
    parameters = parse_all(_with_priors(options, nominal), nominal)
    records = load_records([*options.measured, *options.validate], nominal)
    records, judging = records[: len(options.measured)], records[len(options.measured) :]
    output = None if options.out is None else OutputFolder(options.out, options.force)
    with workers_of(options) as workers, progress_bar('identification') as progress:
        result = identify(nominal, records, judging, parameters, progress, known, workers)
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
            f'{item.log}, {result.nominal.titles[item.axis]}: RMS error {item.rms_before:.4g} to '
            f'{item.rms_after:.4g} {item.unit}, {item.improvement_percent:.1f} %'
        )
    return kept.tell('report: {}/report.html')


def _with_priors(options: argparse.Namespace, nominal: Variant) -> list[str]:
    """Return the parameters as they are named, with the library's range where none was given."""
    if options.library is None:
        return list(options.parameter)
    from waferbot_twin.identification.named_parameters import at_path
    from waferbot_twin.library.entries import load
    from waferbot_twin.library.ranges import prior

    entries = load(options.library)
    texts = []
    for text in options.parameter:
        known = None if '=' in text else prior(entries, at_path(text.strip(), nominal))
        if known is None:
            texts.append(text)
            continue
        say(f'{text}: {known[0]:.5g} to {known[1]:.5g}, by {options.library}')
        texts.append(f'{text}={known[0]!r}:{known[1]!r}')
    return texts


def _least_squares(options: argparse.Namespace) -> int:
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.identification.least_squares import identify_by_least_squares
    from waferbot_twin.identification.least_squares_report import (
        as_dict,
        errors_in_words,
        remarks,
        table_rows,
        write,
    )
    from waferbot_twin.logs.load import load_log
    from waferbot_twin.logs.names import names_of
    from waferbot_twin.models import load_model_or_machine

    chosen = _options(options)
    variant = Variant.of(load_model_or_machine(options.model)) if options.model else None
    machine = variant.machine_text if variant is not None else None
    paths = [*options.measured, *options.validate]
    every = [
        load_log(path, options.mapping, machine=machine, name=name)
        for path, name in zip(paths, names_of(paths), strict=True)
    ]
    logs, judges = every[: len(options.measured)], every[len(options.measured) :]
    output = None if options.out is None else OutputFolder(options.out, options.force)
    result = identify_by_least_squares(logs, judges, variant, chosen)
    kept = keep(output, lambda folder: write(result, folder))
    if options.json:
        print_json(as_dict(result))
        return kept.tell('report: {}/report.html')
    table = new_table('axis', 'coefficient', 'value', '95 % from', 'to', 'unit')
    table.columns[1].justify = 'left'
    for row in table_rows(result):
        table.add_row(*row)
    result_console.print(table)
    for line in (*errors_in_words(result), *remarks(result)):
        print(line)
    return kept.tell('report: {}/report.html')


def _options(options: argparse.Namespace) -> Options:
    """Return what was chosen for least squares; raises `UserError`."""
    from waferbot_lockstep.parameters import did_you_mean
    from waferbot_twin.identification.least_squares import Options

    if options.cut_off is not None and not (
        math.isfinite(options.cut_off) and options.cut_off > 0.0
    ):
        raise UserError(f'--cut-off is {options.cut_off:g} Hz; it must be above 0')
    if not (math.isfinite(options.dead_zone) and options.dead_zone >= 0.0):
        raise UserError(f'--dead-zone is {options.dead_zone:g}; it must be a speed, at least 0')
    if options.late_ms is not None and not math.isfinite(options.late_ms):
        raise UserError(f'--late is {options.late_ms:g} ms; it must be a time')
    orders: list[float] = []
    for term in options.terms:
        name, given, numbers = term.partition('=')
        if name == 'sine' and given:
            try:
                orders += [float(number) for number in numbers.split(',')]
            except ValueError:
                raise UserError(f'--with {term}: {numbers!r} is no list of numbers') from None
        elif term not in TERMS:
            raise UserError(
                f'--with {term}: no such term{did_you_mean(name, TERMS)} '
                f'(there are: {", ".join(TERMS)}, sine=N,...)'
            )
    if any(not (math.isfinite(order) and order > 0.0) for order in orders):
        raise UserError('--with sine: orders must be above 0')
    return Options(
        'direction' in options.terms,
        'rise' in options.terms,
        tuple(dict.fromkeys(orders)),
        options.cut_off,
        options.dead_zone,
        None if options.late_ms is None else 1e-3 * options.late_ms,
    )
