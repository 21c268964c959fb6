# SPDX-License-Identifier: Apache-2.0
"""Which waferbot this is: its version, and the commit of the checkout that it is run from."""

from __future__ import annotations

import subprocess
from importlib import metadata
from pathlib import Path


def version_text() -> str:
    """Return the version and the commit, `0.1.0 (4f45868c1a2b)`; without what is not known."""
    try:
        version = metadata.version('waferbot_twin')
    except metadata.PackageNotFoundError:
        version = 'of unknown version'
    revision = git_revision()
    return f'{version} ({revision})' if revision else version


def git_revision() -> str | None:
    """Return the commit, with `-dirty` where files were changed since; None outside a checkout."""
    folder = Path(__file__).resolve().parent
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
