# SPDX-License-Identifier: Apache-2.0
"""Work on a Dask cluster: a real scheduler and two workers on this machine, one of which is killed."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import threading
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from harness import wait_until

import waferbot as wb
from waferbot_lockstep.timing import Timing
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.calibration.search import STAGES, search
from waferbot_twin.calibration.values import calibrated
from waferbot_twin.cluster import cluster
from waferbot_twin.effects import find
from waferbot_twin.residuals.problem import Cause
from waferbot_twin.suggestion import suggest
from waferbot_twin.suggestion.candidates import Candidate
from waferbot_twin.suggestion.separation import Machine
from waferbot_twin.sweep.evaluation import Task
from waferbot_twin.sweep.pareto import pareto_front
from waferbot_twin.sweep.variation import parse_variations
from waferbot_twin.version import git_revision

distributed = pytest.importorskip(
    'distributed', reason='--cluster needs distributed, which is not installed'
)

WHAT = (
    'sweep', '--model', 'rigid', '--vary', 'pmac.y_rotate.Ixx30=3000:7000:6',
    '--vary', 'pmac.y_rotate.Ixx31=2500:4500:4', '--experiment', 'step_y_rotate',
    '--measure', 'rms_following_error.y_rotate', '--measure', 'overshoot_percent.y_rotate',
)  # fmt: skip


@pytest.fixture
def scheduler(start):
    """Give a function that starts a scheduler with workers: its address, and the workers."""

    def begin(count, **environment):
        program = start(
            'distributed.cli.dask_scheduler',
            '--port',
            '0',
            '--no-dashboard',
            '--host',
            '127.0.0.1',
        )
        program.wait_for('Scheduler at:')
        address = re.search(r'tcp://127\.0\.0\.1:\d+', program.output).group()
        workers = [
            start(
                'distributed.cli.dask_worker',
                address,
                '--nthreads',
                '1',
                '--no-nanny',
                '--no-dashboard',
                '--host',
                '127.0.0.1',
                **environment,
            )
            for _ in range(count)
        ]
        for worker in workers:
            worker.wait_for('Registered to:')
        return address, workers

    return begin


def swept(start, out, *more):
    twin = start('waferbot_twin', *WHAT, '--out', str(out), *more)
    assert twin.wait() == 0, twin.output
    return pd.read_parquet(out / 'sweep.parquet')


@pytest.mark.slow
@pytest.mark.alone
def test_a_sweep_on_two_workers_survives_the_loss_of_one(scheduler, start, tmp_path):
    address, workers = scheduler(2)
    out = tmp_path / 'cluster'
    twin = start('waferbot_twin', *WHAT, '--out', str(out), '--cluster', address)
    runs = out.with_name('cluster.waferbot-sweep') / 'runs.jsonl'
    wait_until(lambda: runs.exists() and runs.stat().st_size, 'the first points are there', twin)
    os.kill(workers[0].process.pid, signal.SIGKILL)
    assert twin.wait() == 0, twin.output
    found = pd.read_parquet(out / 'sweep.parquet')
    here = swept(start, tmp_path / 'here', '--workers', '1')
    pd.testing.assert_frame_equal(found, here, check_exact=True)
    assert len(found) == 24
    assert np.isfinite(found['rms_following_error.y_rotate']).all()


@contextmanager
def on_workers(address):
    """Give the number of cores of a cluster; at least two of its workers must have worked."""
    with (
        distributed.Client(address, set_as_default=False) as watcher,
        distributed.get_task_stream(watcher) as stream,
        cluster(address) as cores,
    ):
        yield cores
    assert len({task['worker'] for task in stream.data}) >= 2


@pytest.mark.slow
@pytest.mark.alone
def test_a_front_an_identification_and_a_calibration_on_two_workers(scheduler, tmp_path):
    """To the last bit as in one process; during the front one of the workers is killed."""
    pytest.importorskip('pymoo', reason='fronts need pymoo, which is not installed')
    address, workers = scheduler(2)
    model = wb.load_model('rigid')
    log = wb.synthesize(
        model, ['viscous_friction:x_rotate'], tmp_path / 'log', 'step_x_rotate'
    ).log
    names = ['bodies.x_rotate_load.inertia_kg_m2.xx', 'pmac.x_rotate.Ixx31']
    with on_workers(address) as cores:
        there = wb.identify(model, [log], names, workers=cores).parameters
    here = wb.identify(model, [log], names, workers=1).parameters
    pd.testing.assert_frame_equal(there, here, check_exact=True)

    stage, start = dataclasses.replace(STAGES['y_rotate'], population=8), calibrated()
    with on_workers(address) as cores:
        there = search(stage, start, 1, workers=cores)
    assert there == search(stage, start, 1)

    variations = parse_variations(
        ('pmac.y_rotate.Ixx30=2000:8000', 'pmac.y_rotate.Ixx31=2000:8000'), model.variant
    )
    measures = ('peak_current_a.y_rotate', 'rms_following_error.y_rotate')
    paths = tuple(one.path for one in variations)
    task = Task(model.variant, paths, 'step_y_rotate', measures)
    killers = []

    def kill_one(done, total):
        if not killers and done < total // 2:
            # Between two populations nothing would be lost: in the middle of this one.
            killers.append(threading.Timer(0.1, workers[0].process.kill))
            killers[0].start()

    with on_workers(address) as cores:
        there = pareto_front(task, variations, (), 1, cores, kill_one)
    assert workers[0].process.wait(10) == -signal.SIGKILL
    here = pareto_front(task, variations, (), 1)
    pd.testing.assert_frame_equal(there.points, here.points, check_exact=True)


@pytest.mark.slow
@pytest.mark.alone
def test_experiments_are_suggested_on_two_workers(scheduler, monkeypatch):
    """What four short experiments are worth: to the last bit as in one process."""
    address, _ = scheduler(2)
    variant = wb.load_model('rigid').variant
    motions = [
        f'{{name: m{size}, duration_s: 0.3, motion: '
        f'{{x_rotate: {{kind: step, start_s: 0.05, amplitude_counts: {size}}}}}}}'
        for size in (200, 400, 600, 800)
    ]
    candidates = [Candidate(motion, load_experiment(motion)) for motion in motions]
    monkeypatch.setattr(suggest, 'library', lambda variant: candidates)
    monkeypatch.setattr(suggest, 'designed', lambda *arguments: [])
    monkeypatch.setattr(suggest, '_instead', lambda machine, found: [])
    causes = [
        Cause(effect, 'x_rotate', effect.typical(variant, 'x_rotate'))
        for effect in map(find, ('viscous_friction', 'coulomb_friction'))
    ]
    machine = Machine(variant, 1.0, 3, Timing())
    with on_workers(address) as cores:
        there = suggest.suggest(machine, causes, lambda done, total: None, cores)
    here = suggest.suggest(machine, causes, lambda done, total: None, 1)
    worth = [
        [(one.candidate.label, one.evidence(one.separations)) for one in found.rated]
        for found in (there, here)
    ]
    assert worth[0] == worth[1]
    assert len(worth[0]) == 4
    assert worth[0][0][1] > 0.0


@pytest.mark.slow
def test_what_is_wrong_with_a_cluster_is_told(scheduler, start, tmp_path):
    address, _ = scheduler(0)
    for at, said in ((address, 'has no workers'), ('tcp://127.0.0.1:9', 'no scheduler answers')):
        twin = start('waferbot_twin', *WHAT, '--cluster', at)
        assert twin.wait() == 1
        assert said in twin.output
        assert 'Traceback' not in twin.output


@pytest.mark.skipif(git_revision() is None, reason='not a checkout: the commit is not known')
def test_workers_with_another_waferbot_are_refused(scheduler, start):
    """One that does not know its commit is not known to be the same."""
    address, _ = scheduler(1, GIT_DIR='/nowhere')
    twin = start('waferbot_twin', *WHAT, '--cluster', address)
    assert twin.wait() == 1
    assert re.search(r'worker tcp://\S+ has waferbot 0\.1\.0, this is 0\.1\.0 \(', twin.output)
    assert 'Traceback' not in twin.output
