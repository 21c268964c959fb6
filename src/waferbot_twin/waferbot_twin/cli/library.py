# SPDX-License-Identifier: Apache-2.0
"""
The library of identified parameters by type of part, in a YAML file that a team keeps in git.

  add REPORT   puts what identify or diagnose found at its end
  list         tells its ranges over machines and time
  show PART    tells its entries of a type of part, and draws them
  start MODEL  writes a model, or a description, with its values of the same types of part: where a new
               machine begins
  fit-gearbox TEST
               fits the map of a gearbox's loss, over speed and load, to its test on a bench

Without --library it is the one that comes with waferbot, with the damping of the thesis.
"""

from __future__ import annotations

import argparse
import datetime
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console, say
from waferbot_twin.plain_values import significant

if TYPE_CHECKING:
    from waferbot_twin.library.gearbox_points import Points
    from waferbot_twin.library.loss_map import LossMap

FORMATS = ('.png', '.svg', '.pdf')

EXAMPLES = (
    'waferbot library list',
    'waferbot library show linear_guide --plot guides.png',
    'waferbot library start flexible --out new_machine.yaml',
    'waferbot library add identified --library parts.yaml --machine robot_1 --temperature 24',
    'waferbot library fit-gearbox gearbox_test.csv --ratio 50 --out gearbox_map.yaml',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot library`."""
    parser.add_argument('action', choices=tuple(ACTIONS), help='what to do')
    parser.add_argument(
        'what', nargs='?', metavar='REPORT|PART|MODEL|TEST',
        help='add: folder of an identification or a diagnosis; show: a type of part; start: a model; '
        'fit-gearbox: a text file with the columns speed_rad_s, input_torque_nm, output_torque_nm',
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
    parser.add_argument('--plot', type=Path, metavar='FILE', help='show, fit-gearbox: draw it')
    parser.add_argument('--out', type=Path, metavar='FILE', help='start, fit-gearbox: new .yaml')
    parser.add_argument(
        '--ratio',
        type=float,
        metavar='I',
        help='fit-gearbox: turns of the input per turn of the output',
    )
    parser.add_argument(
        '--speeds', nargs='+', type=float, metavar='RAD_S', help='fit-gearbox: those of the map'
    )
    parser.add_argument(
        '--loads', nargs='+', type=float, metavar='NM', help='fit-gearbox: torques in, of the map'
    )
    parser.add_argument(
        '--coordinate', default='y_rotate_motor', metavar='NAME',
        help='fit-gearbox: that of the input in the description (default: %(default)s)',
    )  # fmt: skip
    parser.add_argument('--force', action='store_true', help='replace the file that is there')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Do what was asked for."""
    return ACTIONS[options.action](options)


def _known(options: argparse.Namespace) -> tuple[Any, ...]:
    """Return the entries of the library that was asked for."""
    from waferbot_twin.library.entries import load, shipped

    return load(options.library or shipped())


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


def _list(options: argparse.Namespace) -> int:
    from waferbot_twin.library.ranges import table

    rows = table(_known(options))
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


def _show(options: argparse.Namespace) -> int:
    from waferbot_lockstep.parameters import did_you_mean
    from waferbot_twin.library.entries import PARTS
    from waferbot_twin.library.ranges import draw

    entries = _known(options)
    if options.what not in PARTS:
        hint = did_you_mean(str(options.what), PARTS)
        raise UserError(f'show which part{hint} (there are: {", ".join(PARTS)})')
    _check_new(options)
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


def _start(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.library.start import with_starting_values
    from waferbot_twin.models import load_model_or_machine

    entries = _known(options)
    if options.what is None or options.out is None:
        raise UserError('give a model or a description, and --out FILE to write')
    _check_new(options)
    changed, starts = with_starting_values(
        Variant.of(load_model_or_machine(options.what)), entries
    )
    if not starts:
        raise UserError(f'the library has nothing that {options.what} does not have')
    _write(options.out, changed.text)
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


def _fit_gearbox(options: argparse.Namespace) -> int:
    from waferbot_twin.library.gearbox_points import read_points
    from waferbot_twin.library.loss_map import fit
    from waferbot_twin.library.loss_map_files import as_yaml, draw

    if options.what is None or options.ratio is None or options.out is None:
        raise UserError('give the file of a test, its --ratio, and --out FILE to write')
    _check_new(options)
    points = read_points(Path(options.what), options.ratio)
    found = fit(points, options.speeds, options.loads)
    origin = (
        f'{Path(options.what).name}: {len(points.loss)} points, residuals of '
        f'{found.rms:.3g} Nm RMS'
    )
    if math.isfinite(found.errors.max()):
        origin += f', standard errors up to {found.errors.max():.2g} Nm'
    _write(options.out, as_yaml(found, 'gearbox_map', options.coordinate, origin))
    _tell_map(points, found, options.json)
    say(f'wrote {options.out}')
    if options.plot is not None:
        draw(points, found, options.plot)
        say(f'drew {options.plot}')
    return 0


def _tell_map(points: Points, found: LossMap, as_json: bool) -> None:
    """Print a fitted map with its errors, and what of it the points do not cover."""
    from waferbot_twin.library.loss_map import by_quarter, empty_cells

    quarters, empty = by_quarter(points, found), empty_cells(points, found)
    if as_json:
        print_json(
            {
                'speed_rad_s': found.speeds.tolist(),
                'load_nm': found.loads.tolist(),
                'torque_nm': found.losses.tolist(),
                'standard_error_nm': found.errors.tolist(),
                'residual_rms_nm': found.rms,
                'residual_in_errors': found.scatter,
                'quarters': {
                    name: {'points': count, 'mean_residual_nm': mean}
                    for name, (count, mean) in quarters.items()
                },
                'cells_without_points': empty,
            }
        )
    else:
        shown = new_table('load [Nm]', *(f'{speed:.4g} rad/s' for speed in found.speeds))
        for load, losses, errors in zip(found.loads, found.losses, found.errors, strict=True):
            cells = (
                f'{loss:.4g}' if math.isnan(error) else f'{loss:.4g} ± {error:.2g}'
                for loss, error in zip(losses, errors, strict=True)
            )
            shown.add_row(significant(float(load), 4), *cells)
        result_console.print(shown)
    say(f'loss in Nm ± its standard error; residuals {found.rms:.3g} Nm RMS')
    for name, (count, mean) in quarters.items():
        say(
            f'{name}: '
            + (f'{count} points, on average {mean:+.2g} Nm off' if count else 'no points')
        )
    for slow, fast, low, high in empty:
        say(f'no point between {slow:.4g} and {fast:.4g} rad/s, {low:.4g} and {high:.4g} Nm')
    say(
        f'constant below {found.speeds[0]:.4g} rad/s and {found.loads[0]:.4g} Nm, and beyond '
        f'{found.speeds[-1]:.4g} rad/s and {found.loads[-1]:.4g} Nm'
    )


def _check_new(options: argparse.Namespace) -> None:
    """Refuse files to write that are there already, and pictures of no known kind."""
    if options.plot is not None and options.plot.suffix not in FORMATS:
        raise UserError(f'--plot is {options.plot}; end it in {", ".join(FORMATS)}')
    for name, path in (('plot', options.plot), ('out', options.out)):
        if path is not None and path.exists() and not options.force:
            raise UserError(f'--{name} {path} exists; choose another name or give --force')


def _write(path: Path, text: str) -> None:
    """Write the file that `--out` names."""
    from waferbot_lockstep.atomic_files import write_text

    try:
        write_text(path, text)
    except OSError as error:
        raise UserError(f'--out {path} cannot be written: {error.strerror}') from error


ACTIONS = {
    'add': _add, 'list': _list, 'show': _show, 'start': _start, 'fit-gearbox': _fit_gearbox,
}  # fmt: skip
