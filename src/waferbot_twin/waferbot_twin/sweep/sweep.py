# SPDX-License-Identifier: Apache-2.0
"""
All points of a sweep, on several processes, kept as they come: a sweep that is broken off goes on.

What is done is kept in `DIR.waferbot-sweep` beside the result, a file for each batch of points,
with the plan of the sweep. Started again with the same plan it runs what is missing, and no point
twice; with another one it is refused. The order of the results is that of the points, whatever the
number of processes.
"""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from waferbot_lockstep.atomic_files import write_text
from waferbot_lockstep.errors import UserError
from waferbot_pmac.experiments import load_experiment
from waferbot_twin.batches import in_batches
from waferbot_twin.sweep.evaluation import Task, as_table, evaluate

PARTS = '.waferbot-sweep'
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
    done = pd.DataFrame()
    if parts is not None:
        done = _begin(parts, plan_of(task, points))
    missing = [place for place in range(len(points)) if place not in done.index]
    pieces = [done] if len(done) else []
    progress(len(done), len(points))
    ran = 0
    for found in in_batches(functools.partial(evaluate, task), points[missing], workers):
        batch = missing[ran : ran + len(found)]
        ran += len(found)
        piece = as_table(task, points[batch], found, batch)
        pieces.append(piece)
        if parts is not None:
            _keep(piece, parts / f'part-{batch[0]:07d}.parquet')
        progress(len(points) - len(missing) + ran, len(points))
    return pd.concat(pieces).sort_index()


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


def _begin(parts: Path, plan: dict[str, object]) -> pd.DataFrame:
    """Return what is done already of this plan."""
    file = parts / 'plan.json'
    if not file.exists():
        parts.mkdir(parents=True, exist_ok=True)
        write_text(file, json.dumps(plan, indent=1))
        return pd.DataFrame()
    try:
        before = json.loads(file.read_text('utf-8'))
    except (OSError, ValueError):
        before = None
    if before != plan:
        raise UserError(
            f'{parts} holds a sweep that was broken off, of another model, experiment or points; '
            'go on with it as it was started, or remove that folder'
        )
    pieces = [pd.read_parquet(one) for one in sorted(parts.glob('part-*.parquet'))]
    return pd.concat(pieces) if pieces else pd.DataFrame()


def _keep(piece: pd.DataFrame, file: Path) -> None:
    """Write a part whole or not at all."""
    fresh = file.with_suffix('.new')
    try:
        piece.to_parquet(fresh)
        fresh.rename(file)
    except ImportError as error:
        raise UserError('a sweep is kept as parquet: python -m pip install pyarrow') from error
    except OSError as error:
        raise UserError(f'{file} cannot be written: {error.strerror}') from error
