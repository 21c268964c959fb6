# SPDX-License-Identifier: Apache-2.0
"""Tell what a recording holds: topics, rates, completeness, and what it was made from."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from waferbot_lockstep.contract import Topic
from waferbot_twin.checked_json import NUMBER, TEXT, WHOLE, checked_json
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console
from waferbot_twin.cli.import_log import show
from waferbot_twin.logs import archive
from waferbot_twin.plain_values import significant
from waferbot_twin.recording.completeness import Account, reported
from waferbot_twin.recording.reader import Progress, header_of, stream_recording

OVERLAY = 'overlay.json'
"""What is attached to an overlay."""

_OVERLAY = {
    'type': 'object',
    'required': ['signals'],
    'properties': {
        'signals': {
            'type': 'array',
            'items': {
                'type': 'object',
                'required': [
                    'topic',
                    'unit',
                    'samples',
                    'rms_measured',
                    'rms_simulated',
                    'rms_residual',
                ],
                'properties': {
                    'topic': TEXT,
                    'unit': TEXT,
                    'samples': WHOLE,
                    **dict.fromkeys(('rms_measured', 'rms_simulated', 'rms_residual'), NUMBER),
                },
            },
        }
    },
}

EXAMPLES = ('waferbot info runs/step',)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot info`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording folder or .mcap file'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Read the recording and describe it."""
    attached = header_of(options.recording).attachments
    if archive.ATTACHMENT in attached:
        return _tell_measured(options)
    if OVERLAY in attached:
        return _tell_overlay(options, attached[OVERLAY])
    with progress_bar(f'reading {options.recording.name}') as progress:
        result = describe(options.recording, progress)
    if options.json:
        print_json(result)
        return 0
    run = result['run']
    print(f'{options.recording}')
    print(
        f'  experiment {run.get("experiment", "?")} on model {run.get("model", "?")}, '
        f'engine {run.get("engine", "?")}, seed {run.get("seed", "?")}'
    )
    foreign = run.get('plant')
    if foreign:
        print(f'  plant: {foreign.get("fmu", "?")}, FMI {foreign.get("fmi", "?")}')
    print(f'  {result["ticks"]} ticks, {result["sim_s"]:.4f} s of sim time')
    print(f'  {result["state"]}')
    table = Table(box=None, pad_edge=False)
    for heading in ('topic', 'type', 'messages', 'rate [Hz]'):
        table.add_column(
            heading, justify='right' if heading in ('messages', 'rate [Hz]') else 'left'
        )
    for topic in result['topics']:
        rate = f'{topic["rate_hz"]:.0f}' if topic['rate_hz'] else ''
        table.add_row(topic['name'], topic['type'], str(topic['messages']), rate)
    result_console.print(table)
    if result['attachments']:
        print('  attached: ' + ', '.join(result['attachments']))
    for name, version in sorted(run.get('versions', {}).items()):
        print(f'  {name} {version}')
    return 0


def _tell_measured(options: argparse.Namespace) -> int:
    """Describe a measured log that was imported."""
    from waferbot_twin.logs.load import load_log

    log = load_log(options.recording)
    if options.json:
        print_json({'path': str(options.recording), **log.describe()})
    else:
        print(f'{options.recording}: measured log, imported from {log.source}')
        show(log)
    return 0


def _tell_overlay(options: argparse.Namespace, text: str) -> int:
    """Describe what `compare` or `replay` laid over one another."""
    about = checked_json(text, _OVERLAY, f'{options.recording}: {OVERLAY}')
    if options.json:
        print_json({'path': str(options.recording), **about})
        return 0
    print(f'{options.recording}: overlay, topics under /measured, /simulated, /residual')
    table = new_table('signal', 'unit', 'samples', 'RMS measured', 'RMS simulated', 'RMS residual')
    table.columns[1].justify = 'left'
    for row in about['signals']:
        numbers = (row[f'rms_{side}'] for side in ('measured', 'simulated', 'residual'))
        table.add_row(
            row['topic'], row['unit'], str(row['samples']), *(significant(one) for one in numbers)
        )
    result_console.print(table)
    return 0


def describe(path: Path, progress: Progress | None = None) -> dict[str, Any]:
    """
    Return what a recording holds as plain values; it is read piece by piece.

    `missing` says how many places of messages lack between tick 0 and the end that the recorder tells
    (a run may be broken off within a tick), or the last recorded tick. Raises `UserError`.
    """
    header = header_of(path)
    timing = header.timing
    layout = header.layout
    account = Account(timing, reported(header.run.get('without', ()), layout), layout)
    last_tick = -1

    def take(topic: Topic, records: np.ndarray) -> None:
        nonlocal last_tick
        account.topics[topic].note_all(records['tick'], records['valid'])
        last_tick = max(last_tick, int(records['tick'].max()))

    recording = stream_recording(path, take, progress)
    ticks = last_tick + 1
    sim_s = timing.seconds(ticks)
    told = recording.summary.get('ticks', '')
    end = int(told) if told.isdecimal() and len(told) < 16 else ticks
    missing = sum(account.missing(end).values())
    if not recording.closed:
        state = f'cut off: the recorder did not end; readable up to tick {ticks - 1}'
    else:
        state = f'closed; {missing} missing'
        if recording.summary.get('reason'):
            state += f' ({recording.summary["reason"]})'
        if recording.summary.get('failure'):
            state += f'; the run failed: {recording.summary["failure"]}'
    return {
        'path': str(recording.path),
        'closed': recording.closed,
        'missing': missing,
        'state': state,
        'failure': recording.summary.get('failure', ''),
        'ticks': ticks,
        'sim_s': sim_s,
        'run': recording.run,
        'attachments': sorted(recording.attachments),
        'topics': [
            {
                'name': name,
                'type': recording.types[name],
                'messages': count,
                'rate_hz': count / sim_s if sim_s else None,
            }
            for name, count in sorted(recording.counts.items())
        ],
    }
