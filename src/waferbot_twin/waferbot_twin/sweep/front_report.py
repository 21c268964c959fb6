# SPDX-License-Identifier: Apache-2.0
"""A Pareto front as JSON, table, picture and models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt

from waferbot_twin.html_page import save_picture
from waferbot_twin.plain_values import finite
from waferbot_twin.recording.writer import as_json
from waferbot_twin.sweep.parallel_coordinates import parallel_coordinates, width_in
from waferbot_twin.sweep.pareto import KEPT, Front

FILES = ('points.parquet', 'front.png', 'front.json')


def model_file(number: int) -> str:
    """Return the name of the file with the model of a point of the front."""
    return f'model_{number:03d}.yaml'


def summary(found: Front) -> dict[str, Any]:
    """Return as plain values: every point of the front with its measures and model, and `before`."""
    result = {
        'schema': 1,
        'minimised': list(found.objectives),
        'front': [
            {
                'point': {path: float(row[path]) for path in found.paths},
                'measures': {name: float(row[name]) for name in found.measures},
                'model': model_file(number),
            }
            for number, (_, row) in enumerate(found.front.iterrows(), 1)
        ],
        'before': found.before,
        'limits_kept': bool(found.variants),
        'runs': len(found.points),
    }
    return dict(finite(result))


def write(found: Front, folder: Path) -> None:
    """Write all points, the picture, the summary and the models into a folder."""
    found.points.to_parquet(folder / FILES[0])
    draw(found, folder / FILES[1])
    (folder / FILES[2]).write_text(as_json(summary(found)) + '\n', 'utf-8')
    for number, variant in enumerate(found.variants, 1):
        (folder / model_file(number)).write_text(variant.text, 'utf-8')


def draw(found: Front, file: Path) -> None:
    """
    Draw the front over parameters and measures; of two objectives the front itself above that.

    If there is none, all points that were run to their end take its place.
    """
    names = [*found.paths, *found.measures]
    two = len(found.objectives) == 2
    figure, panels = plt.subplots(
        1 + two, 1, figsize=(width_in(names), 4.2 * (1 + two)), squeeze=False
    )
    if two:
        _draw_two(panels[0, 0], found)
    panel = panels[-1, 0]
    rows = found.front if found.variants else found.points
    shown = parallel_coordinates(panel, rows, names, found.objectives[0])
    what = 'points of the front' if found.variants else 'points, none of which keeps the limits'
    panel.set_title(f'{shown} {what}; colour: {found.objectives[0]}', pad=18)
    figure.tight_layout()
    save_picture(figure, file)


def _draw_two(panel: Any, found: Front) -> None:
    """Draw all points and the front over two objectives; what violates limits may lie outside."""
    across, up = found.objectives
    kept, front = found.points[found.points[KEPT]], found.front
    others = found.points[~found.points[KEPT]]
    if found.variants:
        panel.plot(kept[across], kept[up], '.', color='0.7', ms=4, label='keeps the limits')
        panel.plot(front[across], front[up], 'o-', ms=4, lw=0.8, label='Pareto front')
    panel.plot(found.before[across], found.before[up], '*', ms=11, label='the model as it is')
    if found.variants:
        panel.set(xlim=panel.get_xlim(), ylim=panel.get_ylim())
    panel.plot(others[across], others[up], 'x', color='0.7', ms=4, label='violates a limit')
    panel.set_xlabel(across)
    panel.set_ylabel(up)
    panel.legend(fontsize=8)
    panel.grid(alpha=0.3)
