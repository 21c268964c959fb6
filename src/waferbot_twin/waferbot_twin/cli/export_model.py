# SPDX-License-Identifier: Apache-2.0
"""
Write a model, such as a diagnosis extended it, as URDF or as MJCF.

URDF gets friction and damping of each axis as <dynamics>, MJCF armature, damping, frictionloss and
motors as well. Both have friction + damping x speed; what they miss of the model's own law is said.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import new_table, print_json, result_console, say

FORMATS = {'.urdf': 'URDF', '.xml': 'MJCF', '.mjcf': 'MJCF'}

EXAMPLES = (
    'waferbot export-model --model as_built --out exchange/as_built.xml',
    'waferbot export-model --model as_built --out exchange/as_built.urdf',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot export-model`."""
    parser.add_argument(
        '--model', default='as_built', metavar='NAME|FILE',
        help='a model, or the description of a machine alone (default: as_built)',
    )  # fmt: skip
    parser.add_argument(
        '--out', type=Path, required=True, metavar='FILE', help='a new file: .urdf, or .xml (MJCF)'
    )
    parser.add_argument('--force', action='store_true', help='replace the file at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Write the file, print friction and damping of each axis."""
    from dataclasses import asdict

    from waferbot_lockstep.atomic_files import write_text
    from waferbot_plant.mjcf import joint_dynamics, mjcf
    from waferbot_plant.urdf import urdf
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.models import load_model_or_machine

    kind = FORMATS.get(options.out.suffix)
    if kind is None:
        raise UserError(f'--out is {options.out}; give a file that ends in {", ".join(FORMATS)}')
    if options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    description = Variant.of(load_model_or_machine(options.model)).description
    found = joint_dynamics(description)
    if kind == 'URDF':
        text = urdf(
            description, {axis: (one.damping, one.friction) for axis, one in found.items()}
        )
    else:
        text = mjcf(description, found)
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_text(options.out, text)
    except OSError as error:
        raise UserError(f'--out {options.out} cannot be written: {error.strerror}') from error
    if options.json:
        print_json({'format': kind, 'axes': {axis: asdict(one) for axis, one in found.items()}})
    else:
        table = new_table('axis', 'friction [N, Nm]', 'damping [N s/m, Nm s/rad]', 'misses [%]')
        for axis, one in found.items():
            table.add_row(
                axis, f'{one.friction:.4g}', f'{one.damping:.4g}', f'{100.0 * one.misfit:.1f}'
            )
        result_console.print(table)
    say(f'wrote {options.out} ({kind})')
    return 0
