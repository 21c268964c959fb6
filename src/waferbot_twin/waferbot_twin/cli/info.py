# SPDX-License-Identifier: Apache-2.0
"""Tell what a recording holds: topics, rates, completeness, and what it was made from."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.table import Table

from waferbot_lockstep.contract import CONTRACT_TOPICS
from waferbot_twin.cli.console import print_json, result_console
from waferbot_twin.cli.import_log import show
from waferbot_twin.logs import archive
from waferbot_twin.recording.completeness import Account, reported
from waferbot_twin.recording.reader import Recording, read_recording

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
    recording = read_recording(options.recording)
    if archive.ATTACHMENT in recording.attachments:
        return _tell_measured(options)
    result = describe(recording)
    if options.json:
        print_json(result)
        return 0
    run = result['run']
    print(f'{recording.path}')
    print(
        f'  experiment {run.get("experiment", "?")} on model {run.get("model", "?")}, '
        f'engine {run.get("engine", "?")}, seed {run.get("seed", "?")}'
    )
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
    if recording.attachments:
        print('  attached: ' + ', '.join(sorted(recording.attachments)))
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


def describe(recording: Recording) -> dict[str, Any]:
    """Return what a recording holds as plain values."""
    timing = recording.timing
    ticks = recording.ticks
    sim_s = timing.seconds(ticks)
    missing = count_missing(recording)
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


def count_missing(recording: Recording) -> int:
    """Return how many places of messages lack between tick 0 and the last recorded tick."""
    account = Account(recording.timing, reported(recording.run.get('without', ())))
    for topic in CONTRACT_TOPICS:
        array = recording.topics.get(topic.name)
        if array is None:
            continue
        for tick, valid in zip(array['tick'].tolist(), array['valid'].tolist(), strict=True):
            account.topics[topic].is_new(tick, valid)
    return sum(account.missing(recording.ticks).values())
