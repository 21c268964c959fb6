# SPDX-License-Identifier: Apache-2.0
"""
The library of identified parameters by type of part, in a YAML file that a team keeps in git.

  add REPORT   puts what identify or diagnose found at its end
  list         tells its ranges over machines and time
  show PART    tells its entries of a type of part, and draws them
  start MODEL  writes a model, or a description, with its values of the same types of part: where a new
               machine begins

Without --library it is the one that comes with waferbot, with the damping of the thesis.
"""

from __future__ import annotations

import argparse
import datetime
import math
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console, say
from waferbot_twin.plain_values import significant

FORMATS = ('.png', '.svg', '.pdf')

EXAMPLES = (
    'waferbot library list',
    'waferbot library show linear_guide --plot guides.png',
    'waferbot library start flexible --out new_machine.yaml',
    'waferbot library add identified --library parts.yaml --machine robot_1 --temperature 24',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot library`."""
    parser.add_argument('action', choices=('add', 'list', 'show', 'start'), help='what to do')
    parser.add_argument(
        'what', nargs='?', metavar='REPORT|PART|MODEL',
        help='add: folder of an identification or a diagnosis; show: a type of part; start: a model',
    )  # fmt: skip
    parser.add_argument(
        '--library', type=Path, metavar='FILE', help='YAML (default: the shipped one, to read)'
    )
    parser.add_argument('--machine', default='', metavar='NAME', help='add: of which machine')
    parser.add_argument('--part', metavar='TYPE', help='add: type of part of all of it')
    parser.add_argument('--speed', metavar='TEXT', help='add: at which speed')
    parser.add_argument('--load', metavar='TEXT', help='add: under which load')
    parser.add_argument('--temperature', type=float, metavar='DEGC', help='add: how warm it was')
    parser.add_argument(
        '--date', default='', metavar='YYYY-MM-DD', help='add: when (default: today)'
    )
    parser.add_argument('--plot', type=Path, metavar='FILE', help='show: draw the entries')
    parser.add_argument('--out', type=Path, metavar='FILE', help='start: a new file .yaml')
    parser.add_argument('--force', action='store_true', help='replace the file that is there')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Do what was asked for."""
    from waferbot_twin.library.entries import load, shipped

    if options.action == 'add':
        return _add(options)
    entries = load(options.library or shipped())
    if options.action == 'list':
        return _list(entries, options)
    if options.action == 'start':
        return _start(entries, options)
    return _show(entries, options)


def _add(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from waferbot_lockstep.parameters import did_you_mean
    from waferbot_twin.library.entries import PARTS, add
    from waferbot_twin.library.from_report import read_entries

    if options.what is None or options.library is None:
        raise UserError('give the folder of a report, and --library FILE to add to')
    if options.part is not None and options.part not in PARTS:
        raise UserError(
            f'--part {options.part}: no such type{did_you_mean(options.part, PARTS)} '
            f'(there are: {", ".join(PARTS)})'
        )
    if options.temperature is not None and not math.isfinite(options.temperature):
        raise UserError(f'--temperature is {options.temperature}; it must be a number')
    date = options.date or datetime.date.today().isoformat()
    try:
        datetime.date.fromisoformat(date)
    except ValueError:
        raise UserError(f'--date is {date!r}; write it YYYY-MM-DD') from None
    given = {
        'speed': options.speed, 'load': options.load, 'temperature_degc': options.temperature
    }  # fmt: skip
    conditions = {name: value for name, value in given.items() if value is not None}
    found = read_entries(Path(options.what), options.machine, date, conditions)
    if options.part is not None:
        found = tuple(replace(one, part=options.part) for one in found)
    add(options.library, found)
    if options.json:
        print_json([one.as_data() for one in found])
    for one in found:
        say(f'added {one.part}, {one.parameter}: {one.value:.5g} {one.unit}'.rstrip())
    return 0


def _list(entries: tuple[Any, ...], options: argparse.Namespace) -> int:
    from waferbot_twin.library.ranges import table

    rows = table(entries)
    if options.json:
        print_json(rows.to_dict('records'))
        return 0
    shown = new_table('part', 'parameter', 'low', 'median', 'high', 'unit', 'entries', 'machines')
    for row in rows.itertuples():
        numbers = (significant(value, 4) for value in (row.low, row.median, row.high))
        shown.add_row(
            row.part, row.parameter, *numbers, row.unit, str(row.entries), str(row.machines)
        )
    result_console.print(shown)
    return 0


def _show(entries: tuple[Any, ...], options: argparse.Namespace) -> int:
    from waferbot_lockstep.parameters import did_you_mean
    from waferbot_twin.library.entries import PARTS
    from waferbot_twin.library.ranges import draw

    if options.what not in PARTS:
        hint = did_you_mean(str(options.what), PARTS)
        raise UserError(f'show which part{hint} (there are: {", ".join(PARTS)})')
    if options.plot is not None:
        if options.plot.suffix not in FORMATS:
            raise UserError(f'--plot is {options.plot}; end it in {", ".join(FORMATS)}')
        if options.plot.exists() and not options.force:
            raise UserError(f'--plot {options.plot} exists; choose another name or give --force')
    own = [entry for entry in entries if entry.part == options.what]
    if options.json:
        print_json([entry.as_data() for entry in own])
    else:
        shown = new_table(
            'parameter', 'value', '95 % from', 'to', 'unit', 'machine', 'when', 'origin'
        )
        shown.columns[-1].justify, shown.columns[-1].no_wrap = 'left', False
        for entry in own:
            numbers = (significant(value, 4) for value in (entry.value, entry.low, entry.high))
            shown.add_row(
                entry.parameter, *numbers, entry.unit, entry.machine, entry.date, entry.origin
            )
        result_console.print(shown)
    if options.plot is not None:
        draw(own, options.plot)
        say(f'drew {options.plot}')
    return 0


def _start(entries: tuple[Any, ...], options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from waferbot_lockstep.atomic_files import write_text
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.library.start import with_starting_values
    from waferbot_twin.models import load_model_or_machine

    if options.what is None or options.out is None:
        raise UserError('give a model or a description, and --out FILE to write')
    if options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    changed, starts = with_starting_values(
        Variant.of(load_model_or_machine(options.what)), entries
    )
    if not starts:
        raise UserError(f'the library has nothing that {options.what} does not have')
    try:
        write_text(options.out, changed.text)
    except OSError as error:
        raise UserError(f'--out {options.out} cannot be written: {error.strerror}') from error
    if options.json:
        print_json([asdict(one) for one in starts])
    else:
        shown = new_table('parameter', 'before', 'now', 'unit', 'entries')
        for one in starts:
            numbers = (significant(value, 4) for value in (one.before, one.value))
            shown.add_row(one.path, *numbers, one.unit, str(one.entries))
        result_console.print(shown)
    say(f'wrote {options.out}')
    return 0
