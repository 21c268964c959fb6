# SPDX-License-Identifier: Apache-2.0
"""A fitted map of losses as files: the entry of a description, and a picture with the points."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np

from waferbot_twin.html_page import save_drawing
from waferbot_twin.library.gearbox_points import Points
from waferbot_twin.library.loss_map import LossMap, from_zero

DIGITS = 6


def as_yaml(found: LossMap, name: str, coordinate: str, origin: str) -> str:
    """Return an entry of `frictions` on the coordinate of the input; `origin` says from what it is."""
    whole = from_zero(found)
    lines = [
        '# Loss of a gearbox, referred to its input: a row over speed for each load.',
        'frictions:',
        f'  {name}:',
        f'    coordinate: {coordinate}',
        f'    speed_rad_s: {_listed(whole.speeds)}',
        f'    load_nm: {_listed(whole.loads)}',
        '    torque_nm:',
        '      value:',
        *(f'        - {_listed(row)}' for row in whole.losses),
        f"      from: '{origin.replace(chr(39), chr(39) * 2)}'",
    ]
    return '\n'.join(lines) + '\n'


def draw(points: Points, found: LossMap, file: Path) -> None:
    """
    Draw the loss over speed for each load, and the points with two standard errors.

    A point is drawn at the nearest load of the map, moved there along the map, so that its distance from
    the line is its residual. Raises `OSError` if the file cannot be written.
    """
    figure, panel = plt.subplots(figsize=(8.0, 4.8))
    nearest = np.abs(points.load[:, None] - found.loads).argmin(axis=1)
    shades = plt.get_cmap('viridis')(np.linspace(0.0, 0.85, len(found.loads)))
    fine = np.linspace(0.0, found.speeds[-1], 400)
    for row, (load, shade) in enumerate(zip(found.loads, shades, strict=True)):
        losses = found.at(fine, np.full(len(fine), load))
        panel.plot(fine, losses, color=shade, lw=1.4, label=f'map at {load:.3g} Nm')
        for driving, face in ((True, shade), (False, 'white')):
            own = (nearest == row) & (points.driving == driving)
            speed = np.abs(points.speed[own])
            moved = found.at(speed, np.full(len(speed), load)) + found.residuals[own]
            panel.errorbar(
                speed, moved,
                yerr=2.0 * np.nan_to_num(points.error[own]),
                fmt='o', ms=4, lw=1.0, color=shade, mfc=face,
            )  # fmt: skip
    panel.set_xlim(left=0.0)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel('speed of the input [rad/s]')
    panel.set_ylabel('loss referred to the input [Nm]')
    panel.set_title(
        'points at the nearest load; filled: the motor drives, open: the load does', fontsize=9
    )
    panel.legend(loc='best', fontsize=8)
    panel.grid(alpha=0.3)
    figure.tight_layout()
    save_drawing(figure, file)


def _listed(values: np.ndarray) -> str:
    """Return numbers as a list of YAML."""
    return f'[{", ".join(repr(float(f"{value:.{DIGITS}g}")) for value in values)}]'
