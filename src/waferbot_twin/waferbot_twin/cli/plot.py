# SPDX-License-Identifier: Apache-2.0
"""Draw a recording or an imported log: position, following error and current of each axis."""

from __future__ import annotations

import argparse
from pathlib import Path

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, progress_bar
from waferbot_twin.logs.archive import ATTACHMENT
from waferbot_twin.output_folder import note_file
from waferbot_twin.recording.reader import header_of

FORMATS = ('.png', '.svg', '.pdf')

EXAMPLES = ('waferbot plot runs/step --out step.png',)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot plot`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording folder or .mcap file'
    )
    parser.add_argument(
        '--out', type=Path, metavar='FILE', help='picture to write (default: DIR/plot.png)'
    )
    parser.add_argument('--force', action='store_true', help='replace the picture of --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read the recording and draw it."""
    path: Path = options.recording
    attached = header_of(path).attachments
    folder = path if path.is_dir() else path.parent
    out = options.out or folder / 'plot.png'
    if out.suffix not in FORMATS:
        raise UserError(f'--out is {out}; give a file that ends in {", ".join(FORMATS)}')
    if out.exists() and not options.force:
        raise UserError(f'--out {out} exists already; choose another file or give --force')
    if ATTACHMENT in attached:
        from waferbot_twin.logs.load import load_log
        from waferbot_twin.logs.picture import plot_log

        plot_log(load_log(path), out)
    else:
        from waferbot_twin.plot import plot_recording

        with progress_bar(f'reading {path.name}') as progress:
            plot_recording(path, out, progress)
    note_file(out)
    if options.json:
        print_json({'picture': str(out)})
    else:
        print(out)
    return 0
