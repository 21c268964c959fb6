# SPDX-License-Identifier: Apache-2.0
"""
All points of a sweep, on several processes, kept as they come: a sweep that is broken off goes on.

What is done is kept in `DIR.waferbot-sweep` beside the result: the plan of the sweep, and `runs.jsonl`,
a line for each run, written as it ends. Started again with the same plan it runs what is missing, and no
point twice; with another one it is refused. The order of the results is that of the points, whatever the
number of processes.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from waferbot_lockstep.atomic_files import write_text
from waferbot_lockstep.errors import UserError
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.evaluations import as_they_end
from waferbot_twin.sweep.evaluation import Found, Task, as_table, evaluate

PARTS = '.waferbot-sweep'
RUNS = 'runs.jsonl'
Progress = Callable[[int, int], None]


def run(
    task: Task,
    points: np.ndarray,
    workers: int,
    parts: Path | None,
    progress: Progress = lambda done, total: None,
) -> pd.DataFrame:
    """
    Return a row for each point: parameters by path, measures, `error`.

    `parts` is the folder in which what is done is kept, None for nowhere. Raises `UserError` if there
    is a sweep of another plan in it.
    """
    done = {} if parts is None else _begin(parts, plan_of(task, points))
    missing = [place for place in range(len(points)) if place not in done]
    progress(len(done), len(points))
    with contextlib.nullcontext(_forgets) if parts is None else _keeping(parts / RUNS) as keep:
        work = as_they_end(functools.partial(evaluate, task), points[missing], workers)
        for place, found in work:
            done[missing[place]] = found
            keep(missing[place], found)
            progress(len(done), len(points))
    places = range(len(points))
    return as_table(task, points, [done[place] for place in places], places)


def plan_of(task: Task, points: np.ndarray) -> dict[str, object]:
    """Return what makes a sweep the same: model, experiment, measures and points."""
    text = load_experiment(task.experiment).text
    return {
        'model': hashlib.sha256(task.variant.text.encode()).hexdigest(),
        'experiment': hashlib.sha256(text.encode()).hexdigest(),
        'paths': list(task.paths),
        'measures': list(task.measures),
        'points': hashlib.sha256(np.ascontiguousarray(points).tobytes()).hexdigest(),
        'count': len(points),
    }


def parts_folder(out: Path) -> Path:
    """Return where what is done of a sweep is kept until it is complete."""
    return out.with_name(out.name + PARTS)


def forget(parts: Path) -> None:
    """Remove what was kept."""
    shutil.rmtree(parts, ignore_errors=True)


def _begin(parts: Path, plan: dict[str, object]) -> dict[int, Found]:
    """Return what is done already of this plan."""
    file = parts / 'plan.json'
    if not file.exists():
        parts.mkdir(parents=True, exist_ok=True)
        write_text(file, json.dumps(plan, indent=1))
        return {}
    try:
        before = json.loads(file.read_text('utf-8'))
    except (OSError, ValueError):
        before = None
    if before != plan:
        raise UserError(
            f'{parts} holds a sweep that was broken off, of another model, experiment or points; '
            'go on with it as it was started, or remove that folder'
        )
    return _kept(parts / RUNS)


def _kept(file: Path) -> dict[int, Found]:
    """Return the runs in a file, and cut off a last line that was not written to its end."""
    if not file.exists():
        return {}
    whole, _, torn = file.read_bytes().rpartition(b'\n')
    if torn:
        with file.open('r+b') as stream:
            stream.truncate(len(whole) + 1 if whole else 0)
    done: dict[int, Found] = {}
    try:
        for line in whole.splitlines():
            place, values, error = json.loads(line)
            done[int(place)] = [float(value) for value in values], str(error)
    except (ValueError, TypeError) as error:
        raise UserError(
            f'{file}, line {len(done) + 1} is no run of a sweep; remove {file.parent}'
        ) from error
    return done


def _forgets(place: int, found: Found) -> None:
    """Keep nothing."""


@contextlib.contextmanager
def _keeping(file: Path) -> Iterator[Callable[[int, Found], None]]:
    """Give a function that writes a run to the end of a file."""
    try:
        # Python writes every digit of a number: what is read again has the same bits.
        with file.open('a', encoding='utf-8') as stream:

            def keep(place: int, found: Found) -> None:
                stream.write(json.dumps([place, *found]) + '\n')
                stream.flush()

            yield keep
    except OSError as error:
        raise UserError(f'{file} cannot be written: {error.strerror}') from error
