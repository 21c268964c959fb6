# SPDX-License-Identifier: Apache-2.0
"""
Make a log as a real machine would give it, with hidden effects.

An effect without an axis gets one by chance, a parameter that is not given has a typical value. The log
holds encoder counts, currents, commands and states as a logger on the machine sees them, with noise, and
nothing that tells what is hidden in it; --truth writes that to a file of its own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.atomic_files import write_text
from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console
from waferbot_twin.cli.seeds import add_seed
from waferbot_twin.recording.writer import as_json

EXAMPLES = (
    'waferbot synthesize --list',
    'waferbot synthesize --effect coulomb_friction:x_rotate,friction=2.5 --out logs/hidden',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot synthesize`."""
    parser.add_argument(
        '--effect', action='append', default=[], metavar='NAME[:AXIS][,KEY=VALUE...]',
        help='an effect to hide in the log (may be given several times)',
    )  # fmt: skip
    parser.add_argument('--experiment', default='wafer_exchange', metavar='NAME|FILE')
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument('--noise', type=float, default=1.0, help='level, 0 for none (default 1)')
    add_seed(parser, 'of noise and of what is drawn')
    parser.add_argument(
        '--without', action='append', default=[],
        choices=('commanded', 'currents', 'command', 'voltages', 'amplifier'),
        help='signals that the log does not have',
    )  # fmt: skip
    parser.add_argument('--out', type=Path, metavar='DIR', help='the log, a new folder')
    parser.add_argument('--truth', type=Path, metavar='FILE', help='write what is hidden here')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--list', action='store_true', help='list all effects and leave')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """List effects, or write a log."""
    from waferbot_twin.synthesis import synthesize

    if options.list:
        return _list(options)
    if options.out is None:
        raise UserError('give --out DIR for the log (or --list)')
    if options.truth is not None and options.truth.exists() and not options.force:
        raise UserError(f'{options.truth} exists; choose another file or give --force')
    with progress_bar(f'{options.experiment} on {options.model}') as progress:
        line, truth = synthesize(
            options.model,
            options.effect,
            options.experiment,
            options.noise,
            options.seed,
            options.without,
            options.out,
            options.force,
            progress,
        )
    if options.truth is not None:
        try:
            write_text(options.truth, as_json(truth) + '\n')
        except OSError as error:
            raise UserError(f'--truth {options.truth}: {error.strerror}') from error
    if options.json:
        print_json({'out': str(options.out), 'recorder': line})
    else:
        print(f'{line} messages, recorded to {options.out}')
    return 0


def _list(options: argparse.Namespace) -> int:
    """Print the library."""
    from waferbot_twin.effects import library
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model

    variant = Variant.of(load_model(options.model))
    effects = [(effect, effect.axes(variant)) for effect in library().values()]
    if options.json:
        print_json(
            [
                {
                    'effect': effect.name,
                    'block': effect.block.value,
                    'axes': list(axes),
                    'title': effect.title,
                    'summary': effect.summary,
                }
                for effect, axes in effects
            ]
        )
        return 0
    table = new_table('effect', 'block', 'axes', 'what it is')
    for column in table.columns:
        column.justify, column.no_wrap = 'left', False
    for effect, axes in effects:
        what = f'{effect.title}: {effect.summary}'
        table.add_row(effect.name, effect.block.value, ' '.join(axes) or '-', what)
    result_console.print(table)
    return 0
