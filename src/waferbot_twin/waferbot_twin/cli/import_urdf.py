# SPDX-License-Identifier: Apache-2.0
"""
Make the description of a machine from a robot's URDF, of one to eight joints.

Masses, inertias, joints and <dynamics> are taken; motors and encoders a URDF does not have: what is to
be added is printed, and stands at the head of the file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, say

EXAMPLES = (
    'waferbot export-model --model planar_two_link_arm --out exchange/arm.urdf',
    'waferbot import-urdf exchange/arm.urdf --out exchange/arm.yaml',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot import-urdf`."""
    parser.add_argument('urdf', type=Path, metavar='URDF', help="the robot's file")
    parser.add_argument(
        '--out', type=Path, required=True, metavar='FILE', help='a new file .yaml: the description'
    )
    parser.add_argument('--force', action='store_true', help='replace the file at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read the robot, write the description, say what it lacks."""
    import yaml

    from waferbot_lockstep.atomic_files import write_text
    from waferbot_plant.description_file import load_description
    from waferbot_plant.urdf_reader import read_urdf

    if options.out.exists() and not options.force:
        raise UserError(f'--out {options.out} exists; choose another name or give --force')
    try:
        text = options.urdf.read_text('utf-8')
    except (OSError, ValueError) as error:
        raise UserError(f'{options.urdf} cannot be read: {error}') from error
    found = read_urdf(text, str(options.urdf))
    head = [f'# From {options.urdf.name}. It lacks:', *(f'# - {one}' for one in found.lacks)]
    body = yaml.safe_dump(found.description, sort_keys=False)
    written = '\n'.join([*head, '']) + body
    load_description(written)
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_text(options.out, written)
    except OSError as error:
        raise UserError(f'--out {options.out} cannot be written: {error.strerror}') from error
    if options.json:
        print_json({'description': found.description, 'lacks': list(found.lacks)})
    else:
        axes = ', '.join(f'{axis} is {name}' for axis, name in found.description['axes'].items())
        say(f'wrote {options.out}: {axes}')
        for one in found.lacks:
            say(f'lacks {one}')
    return 0
