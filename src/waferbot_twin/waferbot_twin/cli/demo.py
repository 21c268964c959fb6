# SPDX-License-Identifier: Apache-2.0
"""
Show the twin at work: three ROS 2 nodes in lock-step, a step on each axis, recorded and plotted.

The same run is then repeated in one process without ROS and compared bit by bit, and each node is
replayed alone against the recording.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from waferbot_twin.cli import run
from waferbot_twin.cli.console import print_json, result_console, say
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.response import axis_responses


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot demo`."""
    parser.add_argument(
        '--out', type=Path, default=Path('runs/demo'), metavar='DIR', help='default: runs/demo'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run, compare, replay, print and plot."""
    from waferbot_twin.models import NODES
    from waferbot_twin.plot import plot_recording
    from waferbot_twin.replay import replay_in_process

    folder: Path = options.out
    plan = make_plan('rigid', 'step')
    say('Three nodes over ROS 2: plant, pmac, copley.')
    over_ros = run.run_plan(plan, _run_options('ros', folder / 'ros'))
    say('The same in one process, without ROS.')
    in_process = run.run_plan(plan, _run_options('inprocess', folder / 'inprocess'))
    recording = read_recording(folder / 'ros')
    different = differing_signals(recording, read_recording(folder / 'inprocess'))
    replayed = {
        node: all(
            difference.first_tick is None
            for difference in replay_in_process(recording, plan.model, node)
        )
        for node in NODES
    }
    picture = folder / 'step.png'
    plot_recording(recording, picture)
    metrics = {
        response.axis: asdict(figures)
        for response in axis_responses(recording)
        if (figures := response.metrics()) is not None
    }
    result = {
        'ros': over_ros,
        'inprocess': in_process,
        'differing_signals': different,
        'replay_identical': replayed,
        'metrics': metrics,
        'picture': str(picture),
    }
    if options.json:
        print_json(result)
    else:
        _print(result)
    return 0 if not different and all(replayed.values()) else 1


def _run_options(engine: str, out: Path) -> argparse.Namespace:
    """Return the options of `waferbot run`, as given on the command line."""
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    return parser.parse_args(['--engine', engine, '--out', str(out), '--force'])


def _print(result: dict[str, Any]) -> None:
    for engine in ('ros', 'inprocess'):
        one = result[engine]
        print(
            f'{engine:>10}: {one["ticks"]} ticks in {one["wall_s"]:.2f} s, {one["recorder"]} '
            f'messages, recorded to {one["out"]}'
        )
    same = 'bit-identical' if not result['differing_signals'] else 'DIFFERENT'
    print(f'   signals: {same} over ROS and in one process')
    for node, identical in result['replay_identical'].items():
        print(f'    replay: {node} alone {"gives the same again" if identical else "DIFFERS"}')
    table = Table(box=None, pad_edge=False)
    table.add_column('axis')
    columns = {
        'step': ('step', 1.0, '.4g'),
        'delay [ms]': ('delay_time', 1e3, '.2f'),
        'rise [ms]': ('rise_time', 1e3, '.2f'),
        'peak': ('peak', 1.0, '.4g'),
        'overshoot [%]': ('overshoot_percent', 1.0, '.1f'),
        'peak time [ms]': ('peak_time', 1e3, '.2f'),
        'settling [ms]': ('settling_time', 1e3, '.1f'),
    }
    for heading in columns:
        table.add_column(heading, justify='right', no_wrap=True)
    for axis, figures in result['metrics'].items():
        cells = (
            format(factor * figures[name], form) if math.isfinite(figures[name]) else '-'
            for name, factor, form in columns.values()
        )
        table.add_row(axis, *cells)
    result_console.print(table)
    print(f'picture: {result["picture"]}')
    print(f'more:    ./waferbot info {result["ros"]["out"]}')
