# SPDX-License-Identifier: Apache-2.0
"""Which waferbot this is: its version, and the commit of the checkout that it is run from."""

from __future__ import annotations

import subprocess
from pathlib import Path

VERSION = '0.1.0'
"""Of all packages; also in each `package.xml` and `setup.py`."""


def version_text() -> str:
    """Return the version and the commit, `0.1.0 (4f45868c1a2b)`, which is known in a checkout."""
    revision = git_revision()
    return f'{VERSION} ({revision})' if revision else VERSION


def git_revision() -> str | None:
    """Return the commit, with `-dirty` where files were changed since; None outside a checkout."""
    folder = Path(__file__).resolve().parent
    if folder.parts[-3:] != ('src', 'waferbot_twin', 'waferbot_twin'):
        return None  # an installed package; whose repository it lies in says nothing about it
    try:
        described = subprocess.run(
            ['git', '-C', str(folder), 'describe', '--always', '--dirty', '--abbrev=12'],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
