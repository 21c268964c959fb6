# SPDX-License-Identifier: Apache-2.0
"""A picture of points with many columns: parallel coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd


def parallel_coordinates(
    panel: Any, table: pd.DataFrame, names: Sequence[str], colour: str
) -> int:
    """
    Draw every row as a line over its columns, each between its smallest and largest; coloured by one.

    Rows without numbers are left out; return how many were drawn.
    """
    shown = table[list(names)].replace([np.inf, -np.inf], np.nan).dropna()
    if not shown.empty:
        low, high = shown.min(), shown.max()
        scaled = (shown - low) / (high - low).replace(0.0, 1.0)
        colours = plt.get_cmap('viridis')(scaled[colour])
        for row, shade in zip(scaled.to_numpy(), colours, strict=True):
            panel.plot(range(len(names)), row, color=shade, lw=0.8, alpha=0.7)
        for place, name in enumerate(names):
            panel.axvline(place, color='black', lw=0.6)
            panel.text(place, -0.04, f'{low[name]:.4g}', ha='center', va='top', fontsize=8)
            panel.text(place, 1.04, f'{high[name]:.4g}', ha='center', va='bottom', fontsize=8)
    panel.set_xticks(range(len(names)), [name.replace('.', '.\n') for name in names], fontsize=8)
    panel.tick_params(axis='x', pad=14)
    panel.set_yticks([])
    panel.set_ylim(-0.02, 1.02)
    return len(shown)


def width_in(names: Sequence[str]) -> float:
    """Return how wide a figure of so many columns is, in inches."""
    return max(7.0, 1.9 * len(names))
