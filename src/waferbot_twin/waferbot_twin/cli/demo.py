# SPDX-License-Identifier: Apache-2.0
"""
Show the twin at work, and what it is for: to find what a model of a machine gets wrong.

First three ROS 2 nodes in lock-step make a step on each axis, recorded and plotted; the same run is
repeated in one process without ROS and compared bit by bit, and each node is replayed alone against the
recording.

Then logs are made of the machine as built and diagnosed against the rigid model, as in chapters 4 and 6
of the thesis: what lacks, the model extended by it, and what that gains in the thesis' steps, beside
what its flexible model gained over its rigid one.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from waferbot_lockstep.package_data import package_data
from waferbot_twin.cli import run
from waferbot_twin.cli.console import print_json, progress_of_stages, result_console, say
from waferbot_twin.cli.keeping import Kept, keep
from waferbot_twin.output_folder import OutputFolder
from waferbot_twin.plan import make_plan
from waferbot_twin.recording.compare import differing_signals
from waferbot_twin.recording.reader import read_recording
from waferbot_twin.response_reader import load_responses

if TYPE_CHECKING:
    from waferbot_twin.diagnosis.diagnose import Diagnosis
    from waferbot_twin.diagnosis.proposals.screening import Progress

MODEL, MACHINE = 'rigid', 'as_built'
"""The model that the logs are diagnosed against, and that of the machine that they are of."""

FINDING, JUDGING = ('moves', 'random_steps'), ('steps',)
"""Experiments in `config/demo`: those that causes are found in, and the thesis' steps that judge."""

NOISE = 1.0
"""Level of the noise in the logs (`synthesis`)."""

EXAMPLES = ('waferbot demo --out demo',)
"""What `--help` shows; tests run them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `waferbot demo`."""
    parser.add_argument(
        '--out', type=Path, default=Path('runs/demo'), metavar='DIR', help='default: runs/demo'
    )
    parser.add_argument('--json', action='store_true', help='print the result as JSON')


def execute(options: argparse.Namespace) -> int:
    """Run, compare, replay, diagnose; print and plot."""
    at_work = _at_work(options.out)
    if not options.json:
        _print(at_work)
    diagnosis, kept = _diagnose(options.out)
    if options.json:
        from waferbot_twin.diagnosis.report import as_dict

        print_json({**at_work, 'diagnosis': as_dict(diagnosis)})
    else:
        _print_diagnosis(diagnosis, kept.folder)
    same = not at_work['differing_signals'] and all(at_work['replay_identical'].values())
    return 0 if same and kept.as_asked else 1


def _at_work(folder: Path) -> dict[str, Any]:
    """Run the twin over ROS and in one process, compare, replay and plot."""
    from waferbot_twin.models import NODES
    from waferbot_twin.plot import plot_recording
    from waferbot_twin.replay import replay_in_process

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
    plot_recording(folder / 'ros', picture)
    metrics = {
        response.axis: asdict(figures)
        for response in load_responses(folder / 'ros')
        if (figures := response.metrics()) is not None
    }
    return {
        'ros': over_ros,
        'inprocess': in_process,
        'differing_signals': different,
        'replay_identical': replayed,
        'metrics': metrics,
        'picture': str(picture),
    }


def make_logs(folder: Path) -> None:
    """Make the logs that are diagnosed: of the machine as built, with noise, as its logger sees it."""
    from waferbot_twin.synthesis import synthesize

    for seed, name in enumerate((*FINDING, *JUDGING), 1):
        experiment = package_data('waferbot_twin', 'config', 'demo', f'{name}.yaml')
        out = folder / name
        synthesize(MACHINE, (), str(experiment), NOISE, seed, (), out, True, lambda *_: None)


def _diagnose(folder: Path) -> tuple[Diagnosis, Kept]:
    """Make logs of the machine as built, and diagnose them against the rigid model."""
    from waferbot_twin.diagnosis.report import write

    say('Logs of the machine as built, against the rigid model: what does it get wrong?')
    make_logs(folder / 'logs')
    output = OutputFolder(folder / 'diagnosis', force=True)
    with progress_of_stages('diagnosis') as progress:
        found = diagnosis_of_logs(folder / 'logs', progress)
    kept = keep(output, lambda place: write(found, place))
    return found, kept


def diagnosis_of_logs(folder: Path, progress: Progress) -> Diagnosis:
    """Return the diagnosis of the logs in a folder (`make_logs`) against the rigid model."""
    import waferbot

    result = waferbot.diagnose(
        waferbot.load_model(MODEL),
        waferbot.load_logs(folder / name for name in FINDING),
        waferbot.load_logs(folder / name for name in JUDGING),
        progress=progress,
    )
    return result.details


def _print_diagnosis(diagnosis: Diagnosis, folder: Path | None) -> None:
    from waferbot_twin.cli.print_diagnosis import print_diagnosis
    from waferbot_twin.thesis import thesis

    steps = thesis()['steps']
    gains = {axis: float(steps[axis]['improvement']['rms_error']) for axis in steps}
    print_diagnosis(diagnosis, gains, 'flexible over rigid in the thesis [%]')
    if folder is not None:
        print(f'report:  {folder / "report.html"}')
        print(f'model:   ./waferbot run --model {folder / "extended.yaml"}')


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
