# SPDX-License-Identifier: Apache-2.0
"""
Make a model that runs out of the description of a machine: amplifiers and controller by its data.

Current loops from the motors' data sheets, commutation and feedback from the encoders, gains for a
bandwidth as of a rigid axis, the bias that holds the weight. Then tune it. --experiments writes the
shipped experiments for its axes: steps, strokes, slow runs, noise, multisines, swept sines.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console, say
from waferbot_twin.cli.keeping import keep
from waferbot_twin.output_folder import OutputFolder

EXAMPLES = (
    'waferbot commission ball_screw_stage --bandwidth y_linear=25 --out stage.yaml',
    'waferbot commission scara --bandwidth y_linear=15 --bandwidth x_rotate=8 --bandwidth y_rotate=8 '
    '--out scara.yaml --experiments scara_experiments --stroke y_linear=0.2',
    'waferbot commission gantry --bandwidth y_linear=25 --bandwidth x_rotate=20 --bandwidth y_rotate=10 '
    '--out gantry.yaml',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot commission`."""
    parser.add_argument('machine', metavar='NAME|FILE', help='the description of a machine')
    parser.add_argument(
        '--bandwidth', action='append', default=[], required=True, metavar='AXIS=HZ',
        help='natural frequency of the position loop; of every axis',
    )  # fmt: skip
    parser.add_argument('--out', type=Path, metavar='FILE', required=True, help='a new file .yaml')
    parser.add_argument(
        '--experiments', type=Path, metavar='DIR',
        help='a new folder for the shipped experiments as ones of its axes',
    )  # fmt: skip
    parser.add_argument(
        '--stroke', action='append', default=[], metavar='AXIS=LENGTH',
        help='how far they may take an axis, m or rad; negative: the other way (default: as far as '
        'those of the shipped machine)',
    )  # fmt: skip
    parser.add_argument(
        '--force', action='store_true', help='replace what is at --out and at --experiments'
    )
    parser.add_argument('--json', action='store_true', help='print the settings as JSON')


def execute(options: argparse.Namespace) -> int:
    """Work the settings out, write the model, print them."""
    from waferbot_lockstep.atomic_files import write_text
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model_or_machine
    from waferbot_twin.tuning.commission import commission
    from waferbot_twin.tuning.own_experiments import STEPS, own_experiments

    if options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    bandwidths = dict(_bandwidth(text) for text in options.bandwidth)
    strokes = dict(_stroke(text) for text in options.stroke)
    if strokes and options.experiments is None:
        raise UserError('--stroke is for --experiments: say where they go')
    output = None
    if options.experiments is not None:
        output = OutputFolder(options.experiments, options.force, option='--experiments')
    variant = Variant.of(load_model_or_machine(options.machine))
    found = commission(variant, bandwidths)
    # The names of the shipped machine all have a place; those it has no axis for cannot move.
    units = {
        axis: unit
        for axis, unit in found.description.axis_units.items()
        if axis in found.description.axes
    }
    experiments = {} if output is None else own_experiments(units, strokes)
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_text(options.out, found.text)
    except OSError as error:
        raise UserError(f'--out {options.out} cannot be written: {error.strerror}') from error
    result = {
        axis: {'pmac': found.pmac[axis], 'copley': found.copley[axis]} for axis in bandwidths
    }
    if options.json:
        print_json(result)
    else:
        table = new_table('setting', *bandwidths)
        for device in ('pmac', 'copley'):
            for name in next(iter(result.values()))[device]:
                table.add_row(name, *(f'{result[axis][device][name]:.6g}' for axis in bandwidths))
        result_console.print(table)
    say(f'wrote {options.out}')
    return keep(output, lambda folder: _write(experiments, folder)).tell(
        f'{len(experiments)} experiments: {{}}/{STEPS}.yaml and others'
    )


def _write(experiments: Mapping[str, str], folder: Path) -> None:
    for name, text in experiments.items():
        (folder / f'{name}.yaml').write_text(text, 'utf-8')


def _stroke(text: str) -> tuple[str, float]:
    axis, _, value = text.partition('=')
    try:
        return axis.strip(), float(value)
    except ValueError:
        raise UserError(f'--stroke {text}: give AXIS=LENGTH, m or rad') from None


def _bandwidth(text: str) -> tuple[str, float]:
    axis, sign, value = text.partition('=')
    try:
        hertz = float(value)
    except ValueError:
        hertz = math.nan
    if not sign or not 0.01 <= hertz <= 500.0:
        raise UserError(f'--bandwidth {text}: give AXIS=HZ, from 0.01 to 500 Hz')
    return axis.strip(), hertz
