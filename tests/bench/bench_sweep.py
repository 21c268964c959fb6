# SPDX-License-Identifier: Apache-2.0
"""
How the time of a sweep falls with the number of workers: processes, and a Dask cluster on this machine.

With `--waiting` every run waits as long as one takes, instead of calculating: so what handing out and
keeping the runs costs is seen apart from what else the machine does, and with more workers than it has
cores. The share is (time of one worker) / (workers x time): 1 is linear.

    ./waferbot --exec python tests/bench/bench_sweep.py --points 1000 --workers 1 2
    ./waferbot --exec python tests/bench/bench_sweep.py --points 1000 --waiting --workers 1 2 8
    ./waferbot --exec python tests/bench/bench_sweep.py --points 10000 --waiting --cluster 2x16 2x32
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from waferbot_twin.cluster import cluster
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.sweep import sweep
from waferbot_twin.sweep.evaluation import Found, Task, evaluate

PATHS = ('connections.belt.stiffness_n_m', 'rotors.y_rotate_motor.inertia_kg_m2')
LOW, HIGH = (3.2e5, 1.2e-5), (4.2e5, 2.2e-5)


def wait(run_s: float, task: Task, point: np.ndarray) -> Found:
    """Take as long as a run, by half more or less, and return its parameters as what it measured."""
    time.sleep(run_s * (0.5 + (point[0] - LOW[0]) / (HIGH[0] - LOW[0])))
    return [float(value) for value in point[: len(task.measures)]], ''


def points(count: int) -> np.ndarray:
    """Return as many points, spread evenly at random."""
    return np.random.default_rng(1).uniform(LOW, HIGH, (count, 2))


def seconds(task: Task, count: int, workers: int, function: object) -> float:
    """Return how long a sweep takes that keeps every run, workers being there already."""
    sweep.evaluate = function  # type: ignore[assignment]
    sweep.run(task, points(2 * workers), workers, None)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        table = sweep.run(task, points(count), workers, Path(folder) / 'parts')
        assert len(table) == count
        return time.monotonic() - begin


@contextlib.contextmanager
def dask(processes: int, threads: int) -> Iterator[str]:
    """Start a scheduler with workers; give its address."""
    module = [sys.executable, '-m']
    common = ['--no-dashboard', '--host', '127.0.0.1']
    address = 'tcp://127.0.0.1:8799'
    started = []
    try:
        for arguments in (
            ['distributed.cli.dask_scheduler', '--port', '8799', *common],
            *[
                ['distributed.cli.dask_worker', address, '--nthreads', f'{threads}', *common]
                for _ in range(processes)
            ],
        ):
            started.append(subprocess.Popen(module + arguments, stderr=subprocess.DEVNULL))
        from distributed import Client

        with Client(address, timeout=60.0, set_as_default=False) as client:
            client.wait_for_workers(processes, timeout=60.0)
        yield address
    finally:
        for one in reversed(started):
            one.terminate()
            one.wait()


def main() -> None:
    """Measure, and print a row for each number of workers."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--points', type=int, default=1000)
    parser.add_argument('--workers', type=int, nargs='*', default=[])
    parser.add_argument('--cluster', nargs='*', default=[], metavar='PROCESSESxTHREADS')
    parser.add_argument('--waiting', action='store_true', help='runs wait instead of calculating')
    parser.add_argument('--run-s', type=float, default=0.08, help='how long such a run waits')
    options = parser.parse_args()
    variant = Variant.of(load_model('as_built'))
    task = Task(variant, PATHS, 'step_y_rotate', ('overshoot_percent.y_rotate',))
    function = functools.partial(wait, options.run_s) if options.waiting else evaluate
    first = options.run_s * options.points if options.waiting else None
    for workers in options.workers:
        taken = seconds(task, options.points, workers, function)
        first = first or workers * taken
        tell(f'{workers} processes', options.points, taken, first / (workers * taken))
    for text in options.cluster:
        processes, threads = map(int, text.split('x'))
        with dask(processes, threads) as address, cluster(address) as cores:
            assert cores == processes * threads
            taken = seconds(task, options.points, cores, function)
        first = first or cores * taken
        tell(f'Dask, {text}', options.points, taken, first / (cores * taken))


def tell(what: str, count: int, taken: float, share: float) -> None:
    """Print one measurement."""
    print(f'{what:>14}: {count} points in {taken:.1f} s, {share:.2f} of linear', flush=True)


if __name__ == '__main__':
    main()
