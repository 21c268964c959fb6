# SPDX-License-Identifier: Apache-2.0
"""
Files that come with the packages: machines, settings, models, schemas, message definitions.

They lie inside the Python packages, so one way of finding them serves a checkout, a colcon workspace
and a wheel.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def package_data(package: str, *parts: str) -> Path:
    """Return the path of a file or folder in an installed package, `('waferbot_pmac', 'config')`."""
    return Path(str(files(package).joinpath(*parts)))
