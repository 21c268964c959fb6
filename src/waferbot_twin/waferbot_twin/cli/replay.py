# SPDX-License-Identifier: Apache-2.0
"""
Replay blocks of a model alone against recorded or measured signals, and compare their output.

  waferbot replay RUN --node N                  a recording of the twin, one node, tick by tick
  waferbot replay LOG --model M [--node N]      a measured log, every block that it has signals for

Of a recording of the same model the output is identical: every difference is 0, and so is the exit
code. It is 1 if the output differs anywhere.

Of a measured log nothing is bit-exact: the exit code is 0, and what is told is the RMS of measured,
simulated and residual. The plant is driven by the measured currents or forces and held to the measured
positions by an observer, so its residual is the error of predicting the next reading. --out DIR gets an
overlay: one MCAP with /measured, /simulated and /residual, and overlay.png.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

from waferbot_lockstep.errors import UserError
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.cli.console import new_table, print_json, progress_bar, result_console, say
from waferbot_twin.engines.with_ros import engine_with_ros
from waferbot_twin.logs.archive import ATTACHMENT
from waferbot_twin.models import (
    NODES,
    Model,
    load_model,
    load_model_or_machine,
    recorded_model,
)
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plain_values import significant
from waferbot_twin.plan import Plan
from waferbot_twin.recording.reader import Recording, header_of, read_recording

EXAMPLES = (
    'waferbot replay runs/step --node pmac',
    'waferbot replay runs/step --node plant --model rigid --json',
    'waferbot replay logs/measured --model as_built --out overlays/replayed',
)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot replay`."""
    parser.add_argument(
        'recording', type=Path, metavar='DIR', help='recording, or measured log that was imported'
    )
    parser.add_argument(
        '--node', choices=NODES,
        help='the node to replay; of a measured log all by default (pmac: also another controller)',
    )  # fmt: skip
    parser.add_argument(
        '--model', metavar='NAME|FILE',
        help='default: the model that the recording was made with; of a measured log also the '
        'description of a machine alone',
    )  # fmt: skip
    parser.add_argument(
        '--engine', choices=('inprocess', 'ros'), default='inprocess', help='default: inprocess'
    )
    parser.add_argument('--out', type=Path, metavar='DIR', help='of a measured log: an overlay')
    parser.add_argument('--force', action='store_true', help='replace what is at --out')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Replay, and tell how far the output is from the recorded one."""
    header = header_of(options.recording)
    if is_measured(header):
        return _replay_measured(options, header)
    if options.node is None:
        raise UserError(f'{options.recording} is a recording of a run: give --node, one of '
                        f'{", ".join(NODES)}')  # fmt: skip
    foreign = header.run.get('plant')
    if foreign and options.node == 'plant':
        raise UserError(
            f'{options.recording}: its plant was the FMU {foreign.get("fmu", "?")}, which is not in it; '
            'replay pmac or copley'
        )
    if options.out is not None:
        raise UserError('--out belongs to the replay of a measured log')
    return _replay_run(options)


def is_measured(header: Recording) -> bool:
    """Tell whether a recording is a measured log: imported, or of no run of the twin."""
    engine = header.run.get('engine')
    return ATTACHMENT in header.attachments or engine in (None, 'machine')


def _replay_measured(options: argparse.Namespace, header: Recording) -> int:
    """Replay every block on a measured log."""
    from waferbot_twin.comparison.blocks import replay_blocks
    from waferbot_twin.comparison.overlay import write_overlay
    from waferbot_twin.effects.variant import Variant

    if options.engine != 'inprocess':
        raise UserError(f'{options.recording} is a measured log; replay it inprocess')
    if options.model is None and 'model.yaml' not in header.attachments:
        raise UserError(f'{options.recording} is a measured log: say with --model what to replay')
    model = load_model_or_machine(options.model) if options.model else recorded_model(header)
    if options.out is not None:
        OutputFolder(options.out, options.force)  # nobody waits for what cannot be written
    replayed = replay_blocks(options.recording, Variant.of(model), options.node)
    about = {'log': str(options.recording), 'model': model.name, 'notes': list(replayed.notes)}
    rows = [trace.as_dict() for trace in replayed.traces]
    if options.json:
        print_json({**about, 'signals': rows})
    else:
        table = new_table(
            'signal', 'block', 'unit', 'samples', 'RMS measured', 'RMS simulated', 'RMS residual',
            'largest',
        )  # fmt: skip
        for column in table.columns[1:3]:
            column.justify = 'left'
        for trace, row in zip(replayed.traces, rows, strict=True):
            numbers = (
                row[key]
                for key in ('rms_measured', 'rms_simulated', 'rms_residual', 'largest_residual')
            )
            table.add_row(
                trace.name, trace.block, trace.unit, str(row['samples']),
                *(significant(number) for number in numbers),
            )  # fmt: skip
        result_console.print(table)
        for note in replayed.notes:
            result_console.print(f'note: {note}', soft_wrap=True)
    if options.out is not None:
        write_overlay(replayed.traces, about, options.out, options.force)
        say(f'overlay: {options.out}')
    return 0


def _replay_run(options: argparse.Namespace) -> int:
    """Replay one node of a run tick by tick."""
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
