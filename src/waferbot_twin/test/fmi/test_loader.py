# SPDX-License-Identifier: Apache-2.0
"""What the loader of an FMU holds is released before its library is finished, against one in C."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

LOADER = r"""
#include <stdio.h>
#include <unistd.h>
static int held = 1;
static void say(const char *what) { dprintf(1, "%s %s\n", NAME, what); }
void finalizePythonInterpreter(void) { say(held ? "released" : "has nothing left"); held = 0; }
__attribute__((destructor)) static void finish(void) { finalizePythonInterpreter(); }
"""

IMPORTER = """
import atexit, ctypes, sys
from pathlib import Path
from waferbot_twin.fmi.loader import release_at_exit
ctypes.CDLL(str(Path('binaries/linux64/loaded.so').resolve()))
for _ in range(2):  # an FMU may be instantiated again
    release_at_exit(Path('resources').resolve())
print('imported', flush=True)
"""


@pytest.mark.skipif(sys.platform != 'linux' or not shutil.which('cc'), reason='for a C compiler')
def test_what_a_loader_holds_is_released_before_its_library_is_finished(tmp_path):
    (tmp_path / 'resources').mkdir()
    folder = tmp_path / 'binaries' / 'linux64'
    folder.mkdir(parents=True)
    (folder / 'loader.c').write_text(LOADER, 'utf-8')
    for name in ('loaded', 'other'):
        subprocess.run(
            ['cc', '-shared', '-fPIC', f'-DNAME="{name}"', '-o', f'{name}.so', 'loader.c'],
            cwd=folder, check=True, timeout=60,
        )  # fmt: skip
    done = subprocess.run(
        [sys.executable, '-c', IMPORTER], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        check=True,
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        'imported',
        'loaded released',
        'loaded has nothing left',
        'loaded has nothing left',
    ]
