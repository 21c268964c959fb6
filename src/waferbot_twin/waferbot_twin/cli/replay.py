# SPDX-License-Identifier: Apache-2.0
"""
Replay one node against the recorded signals of the others, and compare its output.

The output of a replay of the same model is identical to the recorded one: every difference is 0, and
so is the exit code. It is 1 if the output differs anywhere.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

from waferbot_lockstep.errors import UserError
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.console import print_json, progress_bar, result_console
from waferbot_twin.engines.with_ros import engine_with_ros
from waferbot_twin.models import NODES, Model, load_model, recorded_model
from waferbot_twin.plan import Plan
from waferbot_twin.recording.reader import Recording, read_recording

EXAMPLES = (
    'waferbot replay runs/step --node pmac',
    'waferbot replay runs/step --node plant --model rigid --json',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot replay`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording folder or .mcap file'
    )
    parser.add_argument('--node', choices=NODES, required=True, help='the node to replay')
    parser.add_argument(
        '--model', metavar='NAME|FILE', help='default: the model that the recording was made with'
    )
    parser.add_argument(
        '--engine', choices=('inprocess', 'ros'), default='inprocess', help='default: inprocess'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Replay, and tell how far the output is from the recorded one."""
    recording = read_recording(options.recording)
    model = load_model(options.model) if options.model else recorded_model(recording)
    if options.engine == 'inprocess':
        from waferbot_twin.replay import replay_in_process

        differences = replay_in_process(recording, model, options.node)
    else:
        replay_over_ros = engine_with_ros('replay_ros').replay_over_ros
        with progress_bar(f'replaying {options.node}') as progress:
            differences = replay_over_ros(
                recording, recorded_plan(recording, model), options.node, progress
            )
    identical = all(difference.first_tick is None for difference in differences)
    if options.json:
        print_json(
            {
                'node': options.node,
                'engine': options.engine,
                'model': model.name,
                'identical': identical,
                'differences': [difference.as_dict() for difference in differences],
            }
        )
        return 0 if identical else 1
    table = Table(box=None, pad_edge=False)
    for heading in (
        'topic',
        'of',
        'unit',
        'RMS recorded',
        'RMS difference',
        'largest',
        'from [s]',
    ):
        table.add_column(
            heading, justify='left' if heading in ('topic', 'of', 'unit') else 'right'
        )
    for difference in differences:
        first_s = (
            ''
            if difference.first_tick is None
            else f'{recording.timing.seconds(difference.first_tick):.5f}'
        )
        table.add_row(
            difference.topic,
            difference.place,
            difference.unit,
            f'{difference.rms_recorded:.6g}',
            f'{difference.rms:.6g}',
            f'{difference.largest:.6g}',
            first_s,
        )
    result_console.print(table)
    print('identical' if identical else 'not identical')
    return 0 if identical else 1


def recorded_plan(recording: Recording, model: Model) -> Plan:
    """Return the plan that a recording was made from; raises `UserError` if it does not say."""
    text = recording.attachments.get('experiment.yaml')
    if text is None:
        raise UserError(f'{recording.path} does not hold its experiment; replay it inprocess')
    return Plan(model, load_experiment(text), recording.ticks, recording.timing)
