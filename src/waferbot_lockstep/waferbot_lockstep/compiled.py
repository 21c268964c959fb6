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

import hashlib
import os
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
    """Return a digest of all sources that compiled code can depend on, and of Numba's version."""
    digest = hashlib.sha256(numba.__version__.encode())
    for package in PACKAGES:
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or [] if spec else []:
            for path in sorted(Path(folder).rglob('*.py')):
                digest.update(path.name.encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Return the folder for compiled code: below NUMBA_CACHE_DIR or the user's cache folder."""
    base = os.environ.get('NUMBA_CACHE_DIR') or os.path.join(
        os.environ.get('XDG_CACHE_HOME') or os.path.join(Path.home(), '.cache'), 'waferbot'
    )
    return Path(base) / source_digest()


numba.config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined]
numba.config.DISABLE_INTEL_SVML = True  # type: ignore[attr-defined]

compiled = numba.njit(cache=True, error_model='numpy')
