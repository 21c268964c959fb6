# SPDX-License-Identifier: Apache-2.0
"""The options `--workers` and `--cluster`, which all commands with independent evaluations have."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator

from waferbot_lockstep.errors import UserError


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare `--workers` and `--cluster`; a number below 1 raises `UserError` when parsed."""
    parser.add_argument(
        '--workers', type=_count, default=os.cpu_count() or 1, metavar='N',
        help='how many evaluations run side by side (default: all cores)',
    )  # fmt: skip
    parser.add_argument(
        '--cluster', metavar='ADDRESS', help='send the work to the Dask scheduler at this address'
    )


@contextlib.contextmanager
def workers_of(options: argparse.Namespace) -> Iterator[int]:
    """Give the number of workers, inside of which joblib works on them; raises `UserError`."""
    from waferbot_twin.cluster import cluster

    with cluster(options.cluster) as cores:
        yield cores or options.workers


def _count(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise UserError(f'--workers is {text}; it must be a whole number from 1 on')
    return value
