# SPDX-License-Identifier: Apache-2.0
"""
Write a part of the twin as an FMU for co-simulation: FMI 3.0, or 2.0.

The parts: plant (mechanism, motors, encoders, sensors), twin (the closed loop), pmac, copley. One step
is a tick of 1/18000 s, or several. Named parameters of the model become parameters of the FMU, which
count until its initialisation ends. The FMU needs a Python with the packages of its requirements.txt.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, say

KINDS = ('plant', 'twin', 'pmac', 'copley')

EXAMPLES = (
    'waferbot export-fmu --model as_built --out fmu/plant.fmu',
    'waferbot export-fmu --block twin --fmi 2 --parameter bodies.carriage.mass_kg --out fmu/twin.fmu',
    'waferbot run --model as_built --plant fmu/plant.fmu --duration 0.05 --out runs/fmu_plant',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot export-fmu`."""
    parser.add_argument('--model', default='rigid', metavar='NAME|FILE', help='default: rigid')
    parser.add_argument(
        '--block', choices=KINDS, default='plant', help='which part (default: plant)'
    )
    parser.add_argument('--fmi', choices=('3', '2'), default='3', help='default: 3')
    parser.add_argument(
        '--parameter', action='append', default=[], metavar='PATH',
        help='a parameter that the FMU is to have, e.g. bodies.carriage.mass_kg',
    )  # fmt: skip
    parser.add_argument('--out', type=Path, required=True, metavar='FILE', help='a new file .fmu')
    parser.add_argument('--force', action='store_true', help='replace the file at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Write the FMU and say what is in it."""
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.fmi.export import REQUIREMENTS, export
    from waferbot_twin.models import load_model

    if options.out.suffix != '.fmu':
        raise UserError(f'--out is {options.out}; give a file that ends in .fmu')
    if options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    variant = Variant.of(load_model(options.model))
    about = export(variant, options.block, options.parameter, options.fmi, options.out)
    if options.json:
        print_json({**about, 'out': str(options.out), 'requirements': list(REQUIREMENTS)})
    else:
        say(
            f'wrote {options.out}: {about["kind"]} of {about["model"]}, FMI {about["fmi"]}.0, '
            f'{len(about["parameters"])} parameters; needs Python with {", ".join(REQUIREMENTS)}'
        )
    return 0
