# SPDX-License-Identifier: Apache-2.0
"""
How the model is compiled: one decorator for every function that runs within a tick.

`@compiled` is Numba's `njit` with the settings that the twin's promise of bit-identical runs rests
on: no fast-math, no vendor vector library (their sine differs in the last bit from the scalar one),
IEEE results for division by zero.

Compiled code is kept on disk. Numba notices a change only in the file of the function itself, not in
those that it calls, and the closed loop calls functions of all packages; so the folder is named
after a digest of all their sources. Import this module before any other that compiles.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numba

PACKAGES = (
    'waferbot_lockstep',
    'waferbot_plant',
    'waferbot_pmac',
    'waferbot_copley',
    'waferbot_twin',
)


def source_digest() -> str:
    """
    Return a digest of all sources that compiled code can depend on, where they are, and Numba's version.

    Numba keeps compiled code by the path of its source: another clone with the same text has none of it.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for package in PACKAGES:
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or [] if spec else []:
            digest.update(os.path.realpath(folder).encode())
            for path in sorted(Path(folder).rglob('*.py')):
                text = path.read_bytes()
                if b'import rclpy' in text or (
                    package == 'waferbot_twin' and b'@compiled' not in text
                ):
                    continue  # no model code: nothing compiled depends on it
                digest.update(path.name.encode())
                digest.update(text)
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Return the folder for compiled code: below NUMBA_CACHE_DIR or the user's cache folder."""
    base = os.environ.get('NUMBA_CACHE_DIR') or os.path.join(
        os.environ.get('XDG_CACHE_HOME') or os.path.join(os.path.expanduser('~'), '.cache'),
        'waferbot',
    )
    return Path(base) / source_digest()


def writable(folder: Path) -> bool:
    """Make a folder, if it lacks, and tell whether files can be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def keep_for_this_process_only(reason: str) -> None:
    """Compile into a temporary folder, which this process removes at its end, and say so."""
    folder = tempfile.mkdtemp(prefix='waferbot-compiled-')
    owner = os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # and not in a child that was forked
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    os.environ['NUMBA_CACHE_DIR'] = folder  # processes that this one starts use it too
    print(f'{reason}; the compilation of the model is not kept', file=sys.stderr)


def compiled_before() -> bool:
    """Tell whether anything of these sources has been compiled and kept on disk."""
    return any(cache_folder().rglob('*.nbc'))


def drop_old_caches(folder: Path, kept: int = 8) -> None:
    """Remove the compiled code of all but the newest few versions of the sources."""
    try:
        if folder.exists() or not folder.parent.exists():
            return
        versions = sorted(
            (path for path in folder.parent.iterdir() if re.fullmatch('[0-9a-f]{16}', path.name)),
            key=lambda path: path.stat().st_mtime,
        )
    except OSError:
        return  # nobody may look there, or another process has just removed one
    for path in versions[: max(0, len(versions) - kept + 1)]:
        shutil.rmtree(path, ignore_errors=True)


drop_old_caches(cache_folder())
if not writable(cache_folder()):
    keep_for_this_process_only(f'{cache_folder().parent} cannot be written to')
numba.config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined]
numba.config.DISABLE_INTEL_SVML = True  # type: ignore[attr-defined]

compiled = numba.njit(cache=True, error_model='numpy')

compiled_without_lock = numba.njit(cache=True, error_model='numpy', nogil=True)
"""The same for what runs long by itself: other threads of Python go on meanwhile."""
