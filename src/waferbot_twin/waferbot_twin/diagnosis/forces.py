# SPDX-License-Identifier: Apache-2.0
"""
The force that a model lacks, over speed and over position of an axis.

The innovation e of the plant block, c counts per m or rad, shows a constant force F that is missing on
the mass M as soon as the observer has settled, as its correction of the speed then makes up for F / M:

    F = M l2 e / (c h),        l2 / h = w^2 for small w h,                                          (1)

with l2, h and w of `residuals.plant_block`; positive if the machine is pushed forward more than the
model. Forces that change faster than w are averaged.

Noise n of the position is w^2 M n in (1), far more than any friction where an encoder is coarse. But it
is noise of high frequencies: the observer takes out what is below w, like s^2 / w^2. So force, speed and
position go through the low-pass filter of inverse dynamics, forwards and backwards, which is as low as
the noise asks for (`estimation.inverse_dynamics`, cut-off). What is drawn are means in bins, with 95 %
intervals from the scatter of passes through a bin (`estimation.residual_curves`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.diagnose import Diagnosis
from waferbot_twin.diagnosis.wording import metres_per_count
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.estimation.inverse_dynamics import (
    HIGHEST_SHARE,
    Filtered,
    Stretch,
    Terms,
    cut_off,
    filtered,
)
from waferbot_twin.estimation.residual_curves import BINS, BinnedMeans, binned_means
from waferbot_twin.noise_model.variance_components import Shapes
from waferbot_twin.plain_values import with_prefix
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import PLANT, Channel, Problem, apply_all
from waferbot_twin.residuals.record import Array
from waferbot_twin.validation.gain_report import AFTER, BEFORE

__all__ = ['BINS', 'draw_forces', 'residual_forces']


def draw_forces(diagnosis: Diagnosis) -> Figure | None:
    """Draw mean residual force over speed and over position of every axis that moves; None of none."""
    nominal = diagnosis.nominal
    axes = {
        axis: forces
        for axis in places.motor_axes(nominal)
        if (forces := residual_forces(diagnosis.problem, diagnosis.before, axis)) is not None
    }
    if not axes:
        return None
    figure, panels = plt.subplots(
        len(axes), 2, figsize=(12.0, 1.0 + 2.5 * len(axes)), squeeze=False, layout='constrained'
    )
    for row, axis in zip(panels, axes, strict=True):
        after = residual_forces(diagnosis.problem, diagnosis.after, axis)
        pairs = ((axes[axis], BEFORE, 'nominal model'), (after, AFTER, 'extended model'))
        largest = max(float(np.abs(one.mean).max()) for one in axes[axis])
        factor, unit = with_prefix(largest, places.force_unit(nominal, axis))
        for forces, colour, label in pairs:
            for panel, means, way in zip(row, forces or (), _ways(nominal, axis), strict=False):
                reach = np.nan_to_num(means.high95 - means.mean)
                panel.errorbar(
                    way * means.centre, factor * means.mean, factor * reach, fmt='o-',
                    color=colour, ms=3.5, lw=0.9, elinewidth=0.8, label=label,
                )  # fmt: skip
        what = 'torque' if unit.endswith('Nm') else 'force'
        slides = places.length_unit(nominal, axis) == 'm'
        titles = (
            ('speed [mm/s]', 'position [mm]') if slides else ('speed [rad/s]', 'position [turns]')
        )
        for panel, title in zip(row, titles, strict=True):
            panel.set_xlabel(title)
            panel.set_ylabel(f'missing {what} [{unit}]')
            panel.set_title(nominal.titles[axis], fontsize=9, loc='left')
            panel.axhline(0.0, color='#888888', lw=0.8)
            panel.grid(alpha=0.3)
        _show_the_means(row, factor, [forces for forces, _, _ in pairs if forces is not None])
    panels[0][0].legend(fontsize=8, loc='best')
    return figure


def _show_the_means(
    row: Sequence[Axes], factor: float, forces: Sequence[tuple[BinnedMeans, BinnedMeans]]
) -> None:
    """Let means fill half of a panel: an interval from two passes can be a hundred times as long."""
    for panel, means in zip(row, zip(*forces, strict=True), strict=True):
        values = factor * np.concatenate([[0.0], *(one.mean for one in means)])
        margin = 0.5 * np.ptp(values) or 1.0
        panel.set_ylim(values.min() - margin, values.max() + margin)


def _ways(nominal: Variant, axis: str) -> tuple[float, float]:
    """Return the factors of speed and position as they are drawn: mm, or rad/s and turns."""
    if places.length_unit(nominal, axis) == 'm':
        return 1e3, 1e3
    return 1.0, 0.5 / math.pi


def residual_forces(
    problem: Problem, hypothesis: Hypothesis, axis: str
) -> tuple[BinnedMeans, BinnedMeans] | None:
    """
    Return the residual force (1) of an axis, binned over its speed and over its position, all logs.

    None if no log has its position long enough, or if it stands in all of them.
    """
    stretches, observers_hz = [], []
    encoder = places.position_encoder(problem.nominal, axis)
    for place, channel in enumerate(problem.channels(PLANT)):
        log, shapes = channel.log, channel.noise.shapes
        if channel.name != encoder or not isinstance(log, PlantBlock):
            continue
        if shapes is None:
            continue
        variant = apply_all(problem.nominal, hypothesis.causes)
        stretch = _stretch(problem, variant, channel, shapes, hypothesis.residuals[PLANT][place])
        if stretch is not None:
            stretches.append(stretch)
            observers_hz.append(shapes.observer_hz)
    if not stretches or not any(np.ptp(one.position) for one in stretches):
        return None
    parts = _filtered(stretches, min(*observers_hz, cut_off(stretches)))
    if not parts:
        return None
    speed, position, force = (
        np.concatenate([getattr(part, name)[part.moving] for part in parts])
        for name in ('speed', 'position', 'force')
    )
    if len(speed) == 0 or np.ptp(speed) == 0.0 or np.ptp(position) == 0.0:
        return None
    means = binned_means(speed, force), binned_means(position, force)
    return means if all(len(one.mean) for one in means) else None


def _stretch(
    problem: Problem, variant: Variant, channel: Channel, shapes: Shapes, residual: Array
) -> Stretch | None:
    """Return position and residual force (1) of a channel, at even times; None of too few samples."""
    log = channel.log
    assert isinstance(log, PlantBlock)
    if len(residual) < 3:
        return None
    axis = channel.axis
    metres, _ = metres_per_count(problem.nominal, axis)
    step = log.steps(variant)[log.channels.index(channel.name)]
    mass = places.joined_inertia(problem.nominal, axis)
    time_s = log.times_s(channel.name)
    step_s = float(np.median(np.diff(time_s)))
    even_s = np.arange(time_s[0], time_s[-1], step_s)
    force = mass * observer_gain(shapes) * metres * step * residual
    resolution = log.record.resolution[log.record.layout.encoder_place(channel.name)]
    return Stretch(
        step_s,
        np.interp(even_s, time_s, metres * log.measured(channel.name)),
        np.interp(even_s, time_s, force),
        metres * resolution,
    )


def _filtered(stretches: list[Stretch], cut_off_hz: float) -> list[Filtered]:
    """Return the stretches that are long enough for the filter, behind it."""
    found = []
    for one in stretches:
        try:
            found.append(filtered(one, min(cut_off_hz, HIGHEST_SHARE / one.step_s), Terms()))
        except UserError:
            continue
    return found


def observer_gain(shapes: Shapes) -> float:
    """Return l2 / h of (1), 1/s2."""
    turned = 2.0 * math.pi * shapes.observer_hz / shapes.rate_hz
    shrunk = math.exp(-shapes.damping * turned)
    swung = math.cos(math.sqrt(1.0 - shapes.damping**2) * turned)
    return (1.0 + shrunk**2 - 2.0 * shrunk * swung) * shapes.rate_hz**2
