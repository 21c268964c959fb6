# SPDX-License-Identifier: Apache-2.0
"""What commands print, and where: results to standard output, all else to standard error."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections.abc import Callable, Collection, Iterator
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
"""Of nothing shorter than this is progress told."""

ENOUGH, LONG_S, LEAST_SHARE = 0.1, 20.0, 0.01
"""Share that must be done before a remaining time is told, and after so many seconds the least share."""

LATE = 2.0
"""How many times what was said it may take before it is said anew."""

error_console = Console(stderr=True, highlight=False, markup=False)


def _result_console() -> Console:
    """Return a console that keeps tables whole when the output goes to a file: as wide as they are."""
    console = Console(highlight=False, markup=False)
    return console if console.is_terminal else Console(highlight=False, markup=False, width=1000)


result_console = _result_console()


def print_json(result: Any) -> None:
    """Print a result as JSON; numbers that are not finite become null."""
    print(json.dumps(finite(result), indent=2, sort_keys=True))


def new_table(*headings: str, text: Collection[str] = ()) -> Table:
    """
    Return an empty table: the first column names the row, the others hold numbers.

    Where the terminal is narrow, names are wrapped, and so are the columns of other `text`.
    """
    table = Table(box=None, pad_edge=False)
    for place, heading in enumerate(headings):
        table.add_column(
            heading,
            justify='right' if place and heading not in text else 'left',
            no_wrap=bool(place) and heading not in text,
        )
    return table


def say(text: str) -> None:
    """Tell the user something that is no result."""
    print(text, file=sys.stderr)


@contextlib.contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """
    Give a function (done, total) that tells progress and remaining time, once it has taken a while.

    On a terminal it draws a bar. Elsewhere, as in the log of a script, it writes one line.
    """
    with progress_of_stages(what) as show:
        yield lambda done, total: show('', done, total)


@contextlib.contextmanager
def progress_of_stages(what: str) -> Iterator[Callable[[str, int, int], None]]:
    """
    Give a function (stage, done, total), as `progress_bar` does, for what has several stages.

    Elsewhere than on a terminal it writes a line for each stage that takes a while, however often it
    comes.
    """
    if not error_console.is_terminal:
        lines: dict[str, Callable[[int, int], None]] = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in lines:
                lines[stage] = _progress_line(
                    _named(what, stage), ' of this stage' if stage else ''
                )
            lines[stage](done, total)

        yield tell
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
    task, shown = bar.add_task(what, total=None), ''
    started = False

    def show(stage: str, done: int, total: int) -> None:
        nonlocal started, shown
        if not started:
            if time.monotonic() - begun_s < QUIET_S:
                return
            started = True
            bar.start()
        if stage != shown:
            shown = stage
            bar.reset(task, description=_named(what, stage))
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        if started:
            bar.stop()


def _named(what: str, stage: str) -> str:
    return f'{what}, {stage}' if stage else what


def _progress_line(what: str, of_what: str = '') -> Callable[[int, int], None]:
    """
    Return a function (done, total) that says once how long it will still take, `of_what`.

    Counted from where `done` begins to rise: before that, something was compiled or started. Enough
    must be done, so that the estimate is not that of the first few steps, which may be others. Where
    steps get longer and it takes twice what was said, it says it again, from the steps since; not of
    what begins anew.
    """
    first: tuple[float, int] | None = None
    again_s = 0.0

    def show(done: int, total: int) -> None:
        nonlocal first, again_s
        now_s = time.monotonic()
        if first is not None and done < first[1] and again_s:
            again_s = math.inf  # it has begun anew
        if first is None or done <= first[1]:
            first = (now_s, done)
        elapsed_s, more = now_s - first[0], done - first[1]
        share = LEAST_SHARE if elapsed_s >= LONG_S else ENOUGH
        if now_s < again_s or elapsed_s < QUIET_S or more < share * total or done >= total:
            return
        left_s = elapsed_s * (total - done) / more
        first, again_s = (now_s, done), now_s + LATE * left_s
        say(f'{what}: about {in_words(left_s)} left{of_what}')

    return show


def in_words(duration_s: float) -> str:
    """Return a duration as one reads it: `8 s`, `3 min`, `2 h`; rounded up, at least 1 s."""
    for unit_s, unit, most in ((1.0, 's', 120.0), (60.0, 'min', 7200.0)):
        if duration_s <= most:
            return f'{max(math.ceil(duration_s / unit_s), 1)} {unit}'
    return f'{math.ceil(duration_s / 3600.0)} h'
