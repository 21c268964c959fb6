# SPDX-License-Identifier: Apache-2.0
"""Nothing of a command outlives it: no worker process, nothing in shared memory, no claim."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from harness import children_of, command_line, wait_until

from waferbot_twin.cli.demo import make_logs
from waferbot_twin.engines.domain import FIRST_DOMAIN, Domain
from waferbot_twin.workers import remove_shared_memory_of_the_dead


def workers_of(pid):
    return [child for child in children_of(pid) if 'LokyProcess' in ' '.join(command_line(child))]


def working(pid):
    """Return how many workers have begun with what they were given: our compiler is loaded then."""
    maps = [Path('/proc') / str(child) / 'maps' for child in workers_of(pid)]
    return sum('llvmlite' in path.read_text() for path in maps if path.exists())


def is_running(pid):
    try:
        return (Path('/proc') / str(pid) / 'stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason='one core needs no workers')
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGKILL])
def test_the_workers_of_a_diagnosis_end_with_it(start, tmp_path, number):
    """Without a parent they would wait for more work for five minutes, longer than we wait here."""
    make_logs(tmp_path)
    program = start(
        *('waferbot_twin', 'diagnose', str(tmp_path / 'steps'), '--model', 'rigid'),
        *('--validate', str(tmp_path / 'moves'), '--out', str(tmp_path / 'out')),
    )
    wait_until(lambda: working(program.process.pid) >= 2, 'two workers at work', program)
    family = children_of(program.process.pid)
    program.signal(number)
    program.wait()
    wait_until(lambda: not any(map(is_running, family)), 'all that it started has ended')
    assert not list(Path('/dev/shm').glob(f'joblib_memmapping_folder_{program.process.pid}_*'))


def test_what_the_dead_left_in_shared_memory_is_removed_and_nothing_else(tmp_path):
    dead = subprocess.Popen([sys.executable, '-c', ''])
    dead.wait()
    left = tmp_path / f'joblib_memmapping_folder_{dead.pid}_1_2'
    used = tmp_path / f'joblib_memmapping_folder_{os.getpid()}_1_2'
    other = tmp_path / 'joblib_memmapping_folder_of_somebody'
    for folder in (left, used, other):
        folder.mkdir()
        (folder / 'array.pkl').write_bytes(b'0')
    remove_shared_memory_of_the_dead(tmp_path, unused_s=3600.0)
    assert left.exists()  # too young: it may be another container's
    remove_shared_memory_of_the_dead(tmp_path, unused_s=-3600.0)
    assert {path.name for path in tmp_path.iterdir()} == {used.name, other.name}


CLAIM = """
from waferbot_twin.engines.domain import Domain
claimed = Domain()
print(claimed.number, flush=True)
input()
"""


def test_a_domain_is_claimed_whatever_tmpdir_says_and_free_after_a_kill(tmp_path):
    held = [Domain()]
    other = subprocess.Popen(
        [sys.executable, '-c', CLAIM],
        env={**os.environ, 'TMPDIR': str(tmp_path), 'ROS_DOMAIN_ID': ''},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    number = int(other.stdout.readline())
    try:
        assert number >= FIRST_DOMAIN
        assert number != held[0].number
        with pytest.raises(Exception, match=f'ROS domain {number} is in use by another twin'):
            Domain(number)
    finally:
        other.kill()
        other.wait()
    held.append(Domain(number))
    for claimed in held:
        claimed.release()
    assert not list(tmp_path.iterdir())
