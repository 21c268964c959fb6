# SPDX-License-Identifier: Apache-2.0
"""
Work on a cluster: what joblib would give to processes of this machine goes to the workers of Dask.

Start one with `dask scheduler` and, on each machine, `dask worker ADDRESS`, in an environment with
the same waferbot: the same bits come of the same versions alone, so versions of Python, of packages and
of waferbot are compared first. What a worker was doing when it was lost, others do again. Nothing else
here needs Dask, so it is not among what is installed: pip install distributed.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib

from waferbot_lockstep.errors import UserError
from waferbot_twin.version import version_text

CONNECT_S = 10.0

CALCULATE = ('numpy', 'scipy', 'numba', 'joblib')
"""Packages on which the bits of a result depend, beside those that Dask compares itself."""


@contextlib.contextmanager
def cluster(address: str | None, package: Path | None = None) -> Iterator[int | None]:
    """
    Send what joblib does inside to the scheduler at `address`; give the number of its cores.

    Gives None, and changes nothing, if there is no address. `package` is a folder with a Python package
    that the workers lack: it is sent first. Raises `UserError` if Dask is not installed, the scheduler
    cannot be reached, has no workers, or one with other versions.
    """
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise UserError(
            '--cluster needs Dask, which is not installed here: pip install distributed'
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise UserError(
            f'--cluster {address}: no scheduler answers there within {CONNECT_S:g} s ({error}); '
            'start one with `dask scheduler`'
        ) from error
    with client:
        cores = sum(client.ncores().values())
        if cores == 0:
            raise UserError(
                f'--cluster {address}: the scheduler has no workers; start some with '
                f'`dask worker {address}`'
            )
        _check_versions(client, address)
        if package is not None:
            with tempfile.TemporaryDirectory() as folder:
                name = str(Path(folder) / package.name)
                client.upload_file(shutil.make_archive(name, 'zip', package.parent, package.name))
        with joblib.parallel_config(backend='dask'):
            yield cores


def _check_versions(client: Any, address: str) -> None:
    """Refuse workers whose Python, packages or waferbot are not those of this process."""
    try:
        client.get_versions(check=True, packages=list(CALCULATE))
    except ValueError as error:
        raise UserError(
            f'--cluster {address}: its workers have other versions than this machine: '
            + ' '.join(str(error).split())
        ) from error
    ours = version_text()
    try:
        found = client.run(version_text)
    except Exception as error:  # what a worker raises comes as an exception of any kind
        raise UserError(f'--cluster {address}: a worker cannot run waferbot: {error}') from error
    for worker, theirs in found.items():
        if theirs != ours:
            raise UserError(
                f'--cluster {address}: worker {worker} has waferbot {theirs}, this is {ours}; install '
                'the same there'
            )
