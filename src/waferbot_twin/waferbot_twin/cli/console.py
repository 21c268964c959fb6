# SPDX-License-Identifier: Apache-2.0
"""What commands print, and where: results to standard output, all else to standard error."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from waferbot_twin.plain_values import finite

QUIET_S = 2.0
"""Nothing shorter than this gets a progress bar."""

error_console = Console(stderr=True, highlight=False, markup=False)


def _result_console() -> Console:
    """Return a console that keeps tables whole when the output goes to a file."""
    console = Console(highlight=False, markup=False)
    return console if console.is_terminal else Console(highlight=False, markup=False, width=120)


result_console = _result_console()


def print_json(result: Any) -> None:
    """Print a result as JSON; numbers that are not finite become null."""
    print(json.dumps(finite(result), indent=2, sort_keys=True))


def new_table(*headings: str) -> Table:
    """Return an empty table: the first column names the row, the others hold numbers."""
    table = Table(box=None, pad_edge=False)
    for place, heading in enumerate(headings):
        table.add_column(heading, justify='right' if place else 'left', no_wrap=True)
    return table


def say(text: str) -> None:
    """Tell the user something that is no result."""
    print(text, file=sys.stderr)


@contextlib.contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function (done, total) that draws a bar on a terminal, once it has taken a while."""
    if not error_console.is_terminal:
        yield lambda done, total: None
        return
    begun_s = time.monotonic()
    bar = Progress(
        TextColumn('{task.description}'),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=error_console,
        transient=True,
    )
    task = bar.add_task(what, total=None)
    started = False

    def show(done: int, total: int) -> None:
        nonlocal started
        if not started:
            if time.monotonic() - begun_s < QUIET_S:
                return
            started = True
            bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if started:
            bar.stop()
