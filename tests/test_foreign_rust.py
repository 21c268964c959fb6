# SPDX-License-Identifier: Apache-2.0
"""A PMAC in Rust that shares neither code, nor messages, nor the middleware with ours."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from foreign_peers import check_conformance, check_real_time, check_same_bits, pmac_arguments

FOLDER = Path(__file__).parent / 'foreign_rust'
BUILT = Path(__file__).parent.parent / 'build' / 'foreign_rust'
FORGIVEN = {'stale message', 'missing message', 'contradicting message', 'silence'}

# The first time, what it stands on is compiled: a minute, more on a busy machine.
pytestmark = [pytest.mark.slow, pytest.mark.long(100), pytest.mark.timeout(900)]


@pytest.fixture(scope='module')
def pmac():
    """The program, built as Cargo.lock says."""
    cargo = shutil.which('cargo')
    if cargo is None:
        pytest.skip('no cargo')
    # Not optimised, it is built in half the time and gives the same bits.
    environment = {
        **os.environ,
        'CARGO_TARGET_DIR': str(BUILT),
        'CARGO_PROFILE_DEV_DEBUG': 'false',
    }
    environment.pop('LD_LIBRARY_PATH', None)  # cargo brings libraries of its own
    fetched = subprocess.run(
        [cargo, 'fetch', '--locked'], cwd=FOLDER, env=environment, capture_output=True, text=True
    )
    # Without a network there are no crates. A Cargo.lock that does not fit is a mistake of ours.
    assert 'lock file' not in fetched.stderr, fetched.stderr
    if fetched.returncode:
        pytest.skip(f'crates cannot be had: {fetched.stderr[-300:]}')
    built = subprocess.run(
        [cargo, 'build', '--locked', '--offline'],
        cwd=FOLDER,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return str(BUILT / 'debug' / 'foreign-pmac')


@pytest.mark.parametrize(
    ('duration_s', 'layout'),
    [(0.5, ()), (2.0, ('--compose', 'plant,copley'))],
    ids=['four processes', 'composed'],
)
def test_a_pmac_in_rust_gives_the_same_bits_as_ours(pmac, tmp_path, start, duration_s, layout):
    check_same_bits(start, tmp_path, {'pmac': [pmac, *pmac_arguments()]}, duration_s, layout)


@pytest.mark.alone  # asks for the wall clock
def test_in_real_time_it_moves_the_axes(pmac, start, domain, connect, tmp_path):
    """Without a pause: RustDDS ends its receiving thread when SIGSTOP interrupts that."""
    command = [pmac, *pmac_arguments()]
    log = tmp_path / 'pmac.log'
    check_real_time(start, connect(domain), domain, log, 'pmac', command, patience_s=1.0)


def test_the_conformance_kit_finds_nothing_wrong_with_it(pmac):
    check_conformance('pmac', [pmac, *pmac_arguments()], FORGIVEN)
