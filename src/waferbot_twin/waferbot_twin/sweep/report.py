# SPDX-License-Identifier: Apache-2.0
"""A sweep as a table, JSON and a picture: parallel coordinates, and sensitivities if there are any."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from waferbot_lockstep.errors import UserError
from waferbot_twin.html_page import save_picture
from waferbot_twin.plain_values import finite
from waferbot_twin.recording.writer import as_json
from waferbot_twin.sweep.evaluation import ERROR
from waferbot_twin.sweep.parallel_coordinates import parallel_coordinates, width_in

FILES = ('sweep.parquet', 'sweep.png', 'sweep.json')


def check_writable() -> None:
    """Raise `UserError` if what writes the table is not installed, before many runs."""
    if importlib.util.find_spec('pyarrow') is None:
        raise UserError('points are kept as parquet: python -m pip install pyarrow')


def summary(
    table: pd.DataFrame, measures: Sequence[str], sensitivity: pd.DataFrame | None
) -> dict[str, Any]:
    """Return as plain values: range and best point of every measure, failures, sensitivities."""
    paths = [name for name in table.columns if name not in (*measures, ERROR)]
    result: dict[str, Any] = {
        'schema': 1,
        'points': len(table),
        'failed': int((table[ERROR] != '').sum()),
        'errors': [text for text in dict.fromkeys(table[ERROR]) if text],
        'measures': {},
        'sensitivities': None if sensitivity is None else sensitivity.to_dict('records'),
    }
    for measure in measures:
        values = table[measure][np.isfinite(table[measure])]
        if values.empty:
            result['measures'][measure] = None
            continue
        best = values.idxmin()
        result['measures'][measure] = {
            'least': float(values.min()),
            'median': float(values.median()),
            'largest': float(values.max()),
            'numbers': len(values),
            'least_at': {path: float(table.loc[best, path]) for path in paths},
        }
    return dict(finite(result))


def write(
    table: pd.DataFrame, measures: Sequence[str], sensitivity: pd.DataFrame | None, folder: Path
) -> None:
    """Write table, picture and summary into a folder."""
    table.to_parquet(folder / FILES[0])
    draw(table, measures, sensitivity, folder / FILES[1])
    result = summary(table, measures, sensitivity)
    (folder / FILES[2]).write_text(as_json(result) + '\n', 'utf-8')


def draw(
    table: pd.DataFrame, measures: Sequence[str], sensitivity: pd.DataFrame | None, file: Path
) -> None:
    """Draw every point as a line over its parameters and measures, coloured by the first measure."""
    names = [name for name in table.columns if name != ERROR]
    count = 1 if sensitivity is None else 2
    figure, panels = plt.subplots(count, 1, figsize=(width_in(names), 4.2 * count), squeeze=False)
    panel = panels[0, 0]
    shown = parallel_coordinates(panel, table, names, measures[0])
    panel.set_title(f'{shown} of {len(table)} points; colour: {measures[0]}', pad=18)
    if sensitivity is not None:
        _draw_sensitivity(panels[1, 0], sensitivity)
    figure.tight_layout()
    save_picture(figure, file)


def _draw_sensitivity(panel: Any, sensitivity: pd.DataFrame) -> None:
    labels = sensitivity['parameter'] + '\n' + sensitivity['measure']
    place = np.arange(len(labels))
    for shift, name in ((-0.2, 'first'), (0.2, 'total')):
        panel.barh(
            place + shift, sensitivity[name], 0.38, xerr=sensitivity[f'{name}_95'], label=name
        )
    panel.set_yticks(place, labels, fontsize=8)
    panel.invert_yaxis()
    panel.set_xlabel('share of the variance')
    panel.legend(fontsize=8)
    panel.grid(alpha=0.3, axis='x')
