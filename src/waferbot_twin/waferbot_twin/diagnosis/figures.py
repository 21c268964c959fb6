# SPDX-License-Identifier: Apache-2.0
"""Pictures of a diagnosis: what every block leaves over."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from waferbot_twin.diagnosis.diagnose import Diagnosis
from waferbot_twin.diagnosis.wording import BLOCKS
from waferbot_twin.effects.variant import Variant
from waferbot_twin.envelope import draw_signal
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.plain_values import with_prefix
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import PLANT, UNITS, Channel
from waferbot_twin.residuals.record import Array
from waferbot_twin.validation.gain_report import AFTER, BEFORE

ROUNDING = 1e-9
"""RMS residual (counts, A or V) below which nothing is left over."""


def draw_residuals(diagnosis: Diagnosis) -> Figure:
    """
    Draw what every block leaves over in the first estimation log, before and after, over time in s.

    Channels of which nothing but rounding is left have no panel.
    """
    problem = diagnosis.problem
    shown = []
    for block in diagnosis.channels:
        residuals = diagnosis.before.residuals[block]
        for place, channel in enumerate(problem.channels(block)):
            first = channel.log.record is problem.records[0]
            if first and np.sqrt(np.mean(residuals[place] ** 2)) > ROUNDING:
                shown.append((block, place, channel))
    columns = 1 if len(shown) < 2 else 2
    rows = max(1, -(-len(shown) // columns))
    figure, panels = plt.subplots(
        rows, columns, figsize=(12.0, 1.2 + 1.7 * rows), squeeze=False, layout='constrained'
    )
    for panel, (block, place, channel) in zip(panels.flat, shown, strict=False):
        _draw_residual(panel, diagnosis, block, place, channel)
    for panel in panels.flat[len(shown) :]:
        panel.set_axis_off()
    for panel in panels.flat[max(0, len(shown) - columns) : len(shown)]:
        panel.set_xlabel('time [s]')
    if shown:
        panels[0][0].legend(fontsize=8, loc='upper right')
    return figure


def _draw_residual(
    panel: Axes, diagnosis: Diagnosis, block: str, place: int, channel: Channel
) -> None:
    time_s = channel.log.times_s(channel.name)
    pairs = [
        (diagnosis.nominal, diagnosis.before, BEFORE, 'nominal model'),
        (diagnosis.extended, diagnosis.after, AFTER, 'extended model'),
    ]
    signals = [
        in_user_units(variant, hypothesis, block, place, channel)
        for variant, hypothesis, _, _ in pairs
    ]
    largest = max(float(np.max(np.abs(values))) for values, _ in signals)
    factor, unit = with_prefix(largest, signals[0][1])
    for (values, _), (_, _, colour, label) in zip(signals, pairs, strict=True):
        draw_signal(panel, time_s, factor * values, colour, label)
    title = channel_title(channel.name, diagnosis.nominal.titles)
    panel.set_title(f'{BLOCKS[block]}: {title}', fontsize=9, loc='left')
    panel.set_ylabel(f'[{unit}]')
    panel.grid(alpha=0.3)


def channel_title(name: str, titles: Mapping[str, str]) -> str:
    """Return a channel as it is said: "X-Rotate", "Y-Rotate motor", "Y-Linear line 1"."""
    for axis, said in titles.items():
        if name.startswith(axis):
            return f'{said}{name.removeprefix(axis).replace("_", " ")}'
    return name


def in_user_units(
    variant: Variant, hypothesis: Hypothesis, block: str, place: int, channel: Channel
) -> tuple[Array, str]:
    """Return a residual (n,) and its unit: positions in m or rad, not in steps of an encoder."""
    values = np.asarray(hypothesis.residuals[block][place])
    log = channel.log
    if block != PLANT or not isinstance(log, PlantBlock):
        return values, UNITS[block]
    step = log.steps(variant)[log.channels.index(channel.name)]
    encoder = variant.description.encoders[channel.name]
    unit = 'rad' if variant.description.revolute[encoder.coordinate] else 'm'
    return values * step / encoder.counts_per_unit, unit
