# SPDX-License-Identifier: Apache-2.0
"""Nobody from another host sees or stops a twin, unless it was opened to all."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from harness import PATIENCE_S, user_environment

from waferbot_twin.engines.domain import Domain

pytestmark = pytest.mark.slow

SCRIPT = str(Path(__file__).parent / 'two_hosts.py')


def two_hosts(*arguments):
    """Run a command in a network namespace of its own, with an intruder in another."""
    return subprocess.run(
        ['unshare', '--map-root-user', '--net', sys.executable, SCRIPT, *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env=user_environment(),
    )


@pytest.fixture(scope='module', autouse=True)
def permitted():
    """Where namespaces are not permitted there is nothing to try."""
    programs = ('unshare', 'nsenter', 'ip')
    if not all(map(shutil.which, programs)) or two_hosts('1', '', '--try').returncode:
        pytest.skip('network namespaces cannot be made here')


def run_beside_an_intruder(tmp_path, *options):
    claim = Domain()
    claim.release()
    output = tmp_path / 'seen.json'
    run = ['run', '--domain', str(claim.number), '--duration', '0.5', *options]
    done = two_hosts(
        str(claim.number), str(output), sys.executable, '-m', 'waferbot_twin', *run
    )  # fmt: skip
    return done, json.loads(output.read_text())


def test_an_intruder_who_knows_the_address_sees_and_stops_nothing(tmp_path):
    done, seen = run_beside_an_intruder(tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert seen['heard'] == 0
    assert set(seen['topics']) <= {'/encoders', '/stop', '/parameter_events', '/rosout'}


def test_the_same_intruder_stops_a_twin_that_is_open_to_all(tmp_path):
    done, seen = run_beside_an_intruder(tmp_path, '--any-host')
    assert done.returncode == 1
    assert 'the intruder says so' in done.stderr
    assert '/phase_currents' in seen['topics']
