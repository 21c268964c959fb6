# SPDX-License-Identifier: Apache-2.0
"""
Show a recording in the browser: the machine moving, its motors' forces, what its parts bear, and plots.

Needs no ROS tools and no network: the page and all that it uses come with waferbot, and are served
to this computer alone (127.0.0.1). Ctrl-C ends it.
"""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.cli.console import print_json, say
from waferbot_twin.logs import archive
from waferbot_twin.recording.reader import read_recording

LARGEST_PORT = 65535

EXAMPLES = (
    'waferbot view runs/step',
    'waferbot view runs/step --no-browser',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot view`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording folder or .mcap file'
    )
    parser.add_argument(
        '--port', type=int, default=0, metavar='N', help='port of the page (default: a free one)'
    )
    parser.add_argument(
        '--no-browser', action='store_true', help='only tell the address, open no browser'
    )
    parser.add_argument('--json', action='store_true', help='print the address as JSON')


def execute(options: argparse.Namespace) -> int:
    """Serve the recording until Ctrl-C."""
    if not 0 <= options.port <= LARGEST_PORT:
        raise UserError(f'--port is {options.port}; it must be from 0 (a free one) to 65535')
    told: list[np.ndarray] = []
    recording = read_recording(options.recording, told.append)
    if archive.ATTACHMENT in recording.attachments:
        raise UserError(
            f'{options.recording} is a measured log, which has no machine to show; '
            f'draw it with `waferbot plot {options.recording}`'
        )
    from waferbot_twin.view.content import ViewContent
    from waferbot_twin.view.server import ViewServer

    with ViewServer(ViewContent(recording, told), options.port) as server:
        if options.json:
            print_json({'url': server.url})
        else:
            print(server.url)
        sys.stdout.flush()
        if not options.no_browser and not webbrowser.open(server.url):
            say('no browser could be opened; open the address above')
        say('Ctrl-C ends it')
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return 0
    return 0
