# SPDX-License-Identifier: Apache-2.0
"""Nodes of a recorded run that are killed at any tick."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import Program, command_line, domain_of

from endurance.watching import Onlooker
from waferbot_lockstep.errors import UserError
from waferbot_twin.recording.reader import read_recording

LAYOUTS = {
    'topics': ([], ('plant', 'pmac', 'copley')),
    'channel': (['--delivery', 'channel'], ('plant', 'pmac', 'copley')),
    'plant with copley': (['--compose', 'plant,copley'], ('pmac',)),
    'a copley for each axis': (
        ['--copley-per-axis'],
        ('plant', 'pmac', 'copley_y_linear', 'copley_x_rotate', 'copley_y_rotate'),
    ),
}
"""By name: options of `waferbot run`, and the nodes that have a process of their own."""

WITHIN_S = 5.0
LAST_TICK = 3000
START_S = 90.0
SHARED_MEMORY = Path('/dev/shm')


def one_kill(rng: random.Random, folder: Path) -> dict[str, Any]:
    """
    Kill a node at a tick; see what the run says, and what it leaves behind.

    `ok`: within `WITHIN_S` the run says an error that names the node and what of it never came; then it
    ends, no node is left, the recording can be read and has every tick up to its last one, and
    nothing of Fast DDS is in /dev/shm that was not there before.
    """
    layout = rng.choice(sorted(LAYOUTS))
    options, nodes = LAYOUTS[layout]
    victim, tick = rng.choice(nodes), rng.randrange(LAST_TICK)
    before = left_in_shared_memory()
    out = folder / 'run'
    run = ['run', '--experiment', 'constant', '--duration', '1000', '--out', str(out), *options]
    program = Program([sys.executable, '-m', 'waferbot_twin', *run], folder / 'run.log', {})
    row: dict[str, Any] = {'ok': False, 'layout': layout, 'victim': victim, 'tick': tick}
    try:
        children = program.find_children(len(nodes))
        seen = Onlooker(domain_of(program), ('encoders',))
        try:
            row['begun'] = seen.wait(lambda: seen.tick['encoders'] >= tick, START_S)
        finally:
            seen.end()
        os.kill(children[victim], signal.SIGKILL)
        killed_s = time.monotonic()
        while program.process.poll() is None and 'waferbot: error:' not in program.output:
            time.sleep(0.01)
        row['error after [s]'] = round(time.monotonic() - killed_s, 2)
        code = program.wait(60.0)
        row['ended after [s]'] = round(time.monotonic() - killed_s, 2)
        left = [name for name, pid in children.items() if command_line(pid)]
    finally:
        program.end()
    named = re.search(
        rf'waferbot: error: {victim} was killed by signal 9: .*never came', program.output
    )
    row |= {
        'named': bool(named),
        'left running': left,
        'recording': recording_of(out),
        'left in /dev/shm': sorted(left_in_shared_memory() - before),
    }
    row['ok'] = (
        row['begun']
        and code == 1
        and row['error after [s]'] <= WITHIN_S
        and row['named']
        and not left
        and row['recording'].endswith('ticks')
        and not row['left in /dev/shm']
    )
    if not row['ok']:
        row['output'] = program.output[-1500:]
    return row


def recording_of(out: Path) -> str:
    """Return how many ticks a recording holds, or what is wrong with it."""
    try:
        recording = read_recording(out)
    except (UserError, OSError) as error:
        return f'unreadable: {error}'
    ticks = recording['phase_currents']['tick']
    if not recording.closed:
        return 'not closed'
    if not np.array_equal(ticks, np.arange(len(ticks))):
        return f'gaps in {len(ticks)} messages'
    return f'{len(ticks)} ticks'


def left_in_shared_memory() -> set[str]:
    """Return the files of Fast DDS in shared memory that no living process has mapped."""
    files = {file.name for file in SHARED_MEMORY.iterdir() if 'fast' in file.name}
    for maps in Path('/proc').glob('[0-9]*/maps') if files else ():
        with contextlib.suppress(OSError):  # it has just ended, or is not ours
            text = maps.read_text('utf-8', 'replace')
            files = {name for name in files if f'{SHARED_MEMORY}/{name}' not in text}
    return files
