# SPDX-License-Identifier: Apache-2.0
"""Where compiled code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os
from waferbot_lockstep.compiled import cache_folder, compiled, numba

@compiled
def twice(x):
    return 2.0 * x

print(twice(1.5), cache_folder(), os.path.isdir(numba.config.CACHE_DIR))
"""


def run(**environment):
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME', 'HOME')
    }
    program = ['-c', 'exec(compile(open(0).read(), "-", "exec"))']
    return subprocess.run(
        [sys.executable, *program], input=PROGRAM.replace('@compiled\n', '@numba.njit\n'),
        env={**kept, **environment}, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


def test_a_home_that_cannot_be_written_to_is_said_and_does_not_matter():
    result = run(HOME='/dev/null')
    assert result.returncode == 0, result.stderr
    value, folder, there = result.stdout.split()
    assert (value, there) == ('3.0', 'True')
    assert result.stderr == (
        '/dev/null/.cache/waferbot cannot be written to; the compilation of the model is not kept\n'
    )
    assert not Path(folder).parent.exists(), 'the temporary folder is removed at the end'


def test_a_home_that_can_be_written_to_keeps_it(tmp_path):
    result = run(HOME=str(tmp_path))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ''
    folder = Path(result.stdout.split()[1])
    assert folder.parent == tmp_path / '.cache' / 'waferbot'
    assert folder.is_dir()
