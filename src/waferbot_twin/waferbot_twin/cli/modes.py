# SPDX-License-Identifier: Apache-2.0
"""
How a machine vibrates: first frequencies, coupled modes, and the simplified model.

First frequencies are those of Table 6.7: one spring with the inertia that it carries, all else held.
Coupled modes are those of the whole machine at a pose, its axes free. Connections with a first
frequency above ten times the controller's bandwidth may be taken as rigid; --write keeps that choice
as a description of its own.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.parameters import did_you_mean
from waferbot_twin.cli.console import new_table, print_json, result_console, say
from waferbot_twin.models import load_model
from waferbot_twin.plain_values import significant

FORMATS = ('.png', '.svg', '.pdf')
BANDWIDTH_HZ = 30.0
DAMPING = ('calculated', 'improved')

EXAMPLES = (
    'waferbot modes --model flexible --plot modes.png',
    'waferbot modes --pose x_rotate=0.5',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot modes`."""
    machine = parser.add_mutually_exclusive_group()
    machine.add_argument(
        '--model', default='flexible', metavar='NAME|FILE',
        help='machine of this model (default: flexible)',
    )  # fmt: skip
    machine.add_argument(
        '--description', metavar='NAME|FILE', help='machine of this description instead'
    )
    parser.add_argument('--damping', choices=DAMPING, help="default: the model's")
    parser.add_argument(
        '--bandwidth', type=float, default=BANDWIDTH_HZ, metavar='HZ',
        help=f'bandwidth of the controller (default: {BANDWIDTH_HZ:g})',
    )  # fmt: skip
    parser.add_argument(
        '--pose', nargs='+', default=[], metavar='AXIS=VALUE',
        help='where the axes are, m or rad (default: home), e.g. x_rotate=0.5',
    )  # fmt: skip
    parser.add_argument(
        '--write', type=Path, metavar='FILE',
        help='write the simplified machine as a description to this new file',
    )  # fmt: skip
    parser.add_argument('--plot', type=Path, metavar='FILE', help='draw the mode shapes')
    parser.add_argument('--draw', type=Path, metavar='FILE', help='draw the mechanism itself')
    parser.add_argument('--force', action='store_true', help='replace files that are there')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Analyse the machine and print what was found."""
    from waferbot_plant import modes
    from waferbot_plant.plant import find_description, load_machine

    for option, file in (('--plot', options.plot), ('--draw', options.draw)):
        if file is not None and file.suffix not in FORMATS:
            raise UserError(f'{option} is {file}; give a file that ends in {", ".join(FORMATS)}')
    files = {'--write': options.write, '--plot': options.plot, '--draw': options.draw}
    for option, file in files.items():
        if file is not None and file.exists() and not options.force:
            raise UserError(f'{option} {file} exists; choose another name or give --force')
    if not 0.0 < options.bandwidth < 1e6:
        raise UserError(f'--bandwidth is {options.bandwidth:g} Hz; it must be above 0')
    description, damping = options.description, options.damping or 'improved'
    if description is None:
        settings = load_model(options.model).parameters['plant']
        description = settings.get('description', 'rigid')
        damping = options.damping or settings.get('damping', 'improved')
    machine = load_machine(description, damping=damping)
    units = machine.description.axis_units
    pose = _pose(options.pose, {axis: units[axis] for axis in machine.description.axes})
    rows = modes.table_of_first_frequencies(machine.description)
    switches = modes.pick_simplified(machine.description, options.bandwidth)
    found = modes.coupled_modes(machine, pose)
    result = {
        'machine': machine.description.name,
        'description': str(description),
        'damping': damping,
        'pose': pose,
        'bandwidth_hz': options.bandwidth,
        'limit_hz': modes.BANDWIDTH_FACTOR * options.bandwidth,
        'first_frequencies': [
            {**asdict(row), 'difference_percent': row.difference_percent} for row in rows
        ],
        'switches': switches,
        'modes': [asdict(mode) for mode in found],
    }
    if options.json:
        print_json(result)
    else:
        _print(result, rows, found)
    if options.write:
        base = find_description(description).resolve()
        modes.write_switches(options.write, str(base), switches, options.force)
        say(f'wrote {options.write}')
    if options.plot or options.draw:
        from waferbot_plant import drawing

        if options.plot:
            if not found:
                raise UserError(
                    f'{machine.description.name}: nothing gives, so there are no modes to draw; '
                    'choose a machine with flexible connections'
                )
            drawing.draw_modes(machine, found, options.plot, pose)
            say(f'drew {options.plot}')
        if options.draw:
            drawing.draw_mechanism(machine, options.draw)
            say(f'drew {options.draw}')
    return 0


def _pose(texts: list[str], units: Mapping[str, str]) -> dict[str, float]:
    """Return the pose that `AXIS=VALUE ...` says, of axes in `units`, m or rad."""
    pose = {}
    for text in texts:
        axis, _, value = text.partition('=')
        if axis not in units:
            hint = did_you_mean(axis, units)
            raise UserError(f'--pose {text}: no axis {axis!r}{hint}; axes are {", ".join(units)}')
        try:
            pose[axis] = float(value)
        except ValueError:
            pose[axis] = math.nan
        if not math.isfinite(pose[axis]):
            raise UserError(f'--pose {text}: give a number of {units[axis]}')
    return pose


def _print(result: dict[str, Any], rows: list[Any], found: list[Any]) -> None:
    """Print the tables."""
    console = result_console
    limit = result['limit_hz']
    console.print(f'{result["machine"]}, damping {result["damping"]}\n')
    table = new_table(
        'first frequency (Table 6.7)', 'Hz', 'thesis', 'difference %', 'is', 'by rule'
    )
    for row in rows:
        picked = result['switches'][row.connections[0]]
        difference = row.difference_percent
        table.add_row(
            ' + '.join(row.connections),
            f'{row.frequency_hz:.2f}',
            '-' if row.thesis_hz is None else f'{row.thesis_hz:.2f}',
            '-' if difference is None else f'{difference:+.3f}',
            'flexible' if row.flexible else 'rigid',
            picked,
        )
    console.print(table)
    console.print(
        f'\nrule: rigid above {limit:g} Hz, ten times the bandwidth of {result["bandwidth_hz"]:g} Hz\n'
    )
    if not found:
        console.print('no coupled modes: every connection is rigid')
        return
    pose = ', '.join(f'{axis} {value:g}' for axis, value in result['pose'].items()) or 'home'
    console.print(f'coupled modes, pose: {pose}')
    table = new_table('mode', 'Hz', 'damping %', 'bends (share of energy)', 'moves')
    for column in table.columns[3:]:
        column.justify, column.no_wrap = 'left', False
    for number, mode in enumerate(found, start=1):
        table.add_row(
            str(number),
            f'{mode.frequency_hz:.2f}',
            significant(100.0 * mode.damping_ratio, 3),
            _largest(mode.energy, 2, '{name} {value:.0%}', 0.05),
            _largest(mode.shape, 2, '{name} {value:+.2g}', 0.02),
        )
    console.print(table)
    console.print('\nmoves: in m or rad, the largest 1; --json has all of them')


def _largest(values: dict[str, float], count: int, form: str, least: float) -> str:
    """Return the largest entries of a mapping in words, at least one of them."""
    ordered = sorted(values.items(), key=lambda item: -abs(item[1]))[:count]
    kept = [item for item in ordered if abs(item[1]) >= least] or ordered[:1]
    return ', '.join(form.format(name=name, value=value) for name, value in kept)
