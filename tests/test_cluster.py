# SPDX-License-Identifier: Apache-2.0
"""Work on a Dask cluster: a real scheduler and two workers on this machine, one of which is killed."""

from __future__ import annotations

import os
import re
import signal

import numpy as np
import pandas as pd
import pytest
from harness import wait_until

from waferbot_twin.version import git_revision

pytest.importorskip('distributed', reason='--cluster needs distributed, which is not installed')

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
    parts = out.with_name('cluster.waferbot-sweep')
    wait_until(lambda: list(parts.glob('part-*')), 'the first points are there', twin)
    os.kill(workers[0].process.pid, signal.SIGKILL)
    assert twin.wait() == 0, twin.output
    found = pd.read_parquet(out / 'sweep.parquet')
    here = swept(start, tmp_path / 'here', '--workers', '1')
    pd.testing.assert_frame_equal(found, here, check_exact=True)
    assert len(found) == 24
    assert np.isfinite(found['rms_following_error.y_rotate']).all()


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
