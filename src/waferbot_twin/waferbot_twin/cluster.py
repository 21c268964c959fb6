# SPDX-License-Identifier: Apache-2.0
"""
Work on a cluster: what joblib would give to processes of this machine goes to the workers of Dask.

Start one with `dask scheduler` and, on each machine, `dask worker ADDRESS`, in an environment with
the same waferbot. Nothing else here needs Dask, so it is not among what is installed: pip install
distributed.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import joblib

from waferbot_lockstep.errors import UserError

CONNECT_S = 10.0


@contextlib.contextmanager
def cluster(address: str | None, package: Path | None = None) -> Iterator[int | None]:
    """
    Send what joblib does inside to the scheduler at `address`; give the number of its cores.

    Gives None, and changes nothing, if there is no address. `package` is a folder with a Python package
    that the workers lack: it is sent first. Raises `UserError` if Dask is not installed,
    the scheduler cannot be reached or has no workers.
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
        if package is not None:
            with tempfile.TemporaryDirectory() as folder:
                name = str(Path(folder) / package.name)
                client.upload_file(shutil.make_archive(name, 'zip', package.parent, package.name))
        with joblib.parallel_config(backend='dask'):
            yield cores
