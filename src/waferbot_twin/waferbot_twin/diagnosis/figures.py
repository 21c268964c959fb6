# SPDX-License-Identifier: Apache-2.0
"""
Pictures of a diagnosis: what every block leaves over, and residual force over speed and position.

The innovation e of the plant block, c counts per m or rad, shows a constant force F that is missing on
the mass M as soon as the observer has settled, as its correction of the speed then makes up for F / M:

    F = M l2 e / (c h),        l2 / h = w^2 for small w h,                                          (1)

with l2, h and w of `residuals.plant_block`; positive if the machine is pushed forward more than the
model. Forces that change faster than w are averaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import matplotlib

matplotlib.use('Agg')

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from waferbot_twin.diagnosis.diagnose import Diagnosis
from waferbot_twin.diagnosis.wording import BLOCKS, metres_per_count
from waferbot_twin.effects import places
from waferbot_twin.effects.variant import Variant
from waferbot_twin.envelope import draw_signal
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.logs.machine import POSITION_ENCODER
from waferbot_twin.noise_model.variance_components import Shapes
from waferbot_twin.plain_values import with_prefix
from waferbot_twin.plot import TITLES
from waferbot_twin.residuals.plant_block import PlantBlock
from waferbot_twin.residuals.problem import PLANT, UNITS, Channel, Problem, apply_all
from waferbot_twin.residuals.record import Array
from waferbot_twin.validation.gain_report import AFTER, BEFORE

ROUNDING = 1e-9
"""RMS residual (counts, A or V) below which nothing is left over."""

BINS = 30
"""Bins of speed or position."""

LEAST_IN_BIN = 20
"""Samples that a bin has at least: of fewer, a mean says nothing."""

SMOOTHING_S = 0.005
"""Time over which speed is averaged, so that counts do not look like speed."""


@dataclass(frozen=True)
class Binned:
    """
    Mean residual force in bins of a signal.

    `at` (k,) m, rad, m/s or rad/s; `mean` (k,) and its standard `error` (k,) in N or Nm.
    """

    at: Array
    mean: Array
    error: Array


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
    rows = max(1, -(-len(shown) // 2))
    figure, panels = plt.subplots(
        rows, 2, figsize=(12.0, 1.2 + 1.7 * rows), squeeze=False, layout='constrained'
    )
    for panel, (block, place, channel) in zip(panels.flat, shown, strict=False):
        _draw_residual(panel, diagnosis, block, place, channel)
    for panel in panels.flat[len(shown) :]:
        panel.set_axis_off()
    for panel in panels.flat[max(0, len(shown) - 2) : len(shown)]:
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
    panel.set_title(f'{BLOCKS[block]}: {channel_title(channel.name)}', fontsize=9, loc='left')
    panel.set_ylabel(f'[{unit}]')
    panel.grid(alpha=0.3)


def channel_title(name: str) -> str:
    """Return a channel as it is said: "X-Rotate", "Y-Rotate motor", "Y-Linear line 1"."""
    for axis, said in TITLES.items():
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


def draw_forces(diagnosis: Diagnosis) -> Figure | None:
    """Draw mean residual force over speed and over position of every axis that moves; None of none."""
    axes = {
        axis: forces
        for axis in places.motor_axes(diagnosis.nominal)
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
        for forces, colour, label in pairs:
            if forces is not None:
                for panel, means in zip(row, forces, strict=True):
                    panel.errorbar(
                        means.at, means.mean, 2.0 * means.error, fmt='o-', color=colour,
                        ms=3.5, lw=0.9, elinewidth=0.8, label=label,
                    )  # fmt: skip
        force = places.force_unit(diagnosis.nominal, axis)
        length = places.length_unit(diagnosis.nominal, axis)
        for panel, what in zip(row, (f'speed [{length}/s]', f'position [{length}]'), strict=True):
            panel.set_xlabel(what)
            panel.set_ylabel(f'residual {"torque" if force == "Nm" else "force"} [{force}]')
            panel.set_title(TITLES[axis], fontsize=9, loc='left')
            panel.axhline(0.0, color='#888888', lw=0.8)
            panel.grid(alpha=0.3)
    panels[0][0].legend(fontsize=8, loc='best')
    return figure


def residual_forces(
    problem: Problem, hypothesis: Hypothesis, axis: str
) -> tuple[Binned, Binned] | None:
    """
    Return the residual force (1) of an axis, binned over its speed and over its position, all logs.

    None if no log has its position, or if it stands in all of them.
    """
    speeds, positions, forces = [], [], []
    independent = 1.0
    metres, _ = metres_per_count(problem.nominal, axis)
    for place, channel in enumerate(problem.channels(PLANT)):
        log = channel.log
        if channel.name != POSITION_ENCODER[axis] or not isinstance(log, PlantBlock):
            continue
        shapes = channel.noise.shapes
        if shapes is None or len(hypothesis.residuals[PLANT][place]) < LEAST_IN_BIN:
            continue
        stiffness = places.moving_inertia(problem.nominal, axis) * observer_gain(shapes)
        independent = min(independent, 2.0 * math.pi * shapes.observer_hz / shapes.rate_hz)
        step = _step_of(problem, hypothesis, log, channel.name)
        position = metres * log.measured(channel.name)
        speed = np.gradient(position, log.times_s(channel.name))
        positions.append(position)
        speeds.append(_averaged(speed, max(1, round(SMOOTHING_S * shapes.rate_hz))))
        forces.append(stiffness * metres * step * hypothesis.residuals[PLANT][place])
    if not forces or np.ptp(np.concatenate(positions)) == 0.0:
        return None
    force = np.concatenate(forces)
    return (
        binned(np.concatenate(speeds), force, independent),
        binned(np.concatenate(positions), force, independent),
    )


def observer_gain(shapes: Shapes) -> float:
    """Return l2 / h of (1), 1/s2."""
    turned = 2.0 * math.pi * shapes.observer_hz / shapes.rate_hz
    shrunk = math.exp(-shapes.damping * turned)
    swung = math.cos(math.sqrt(1.0 - shapes.damping**2) * turned)
    return (1.0 + shrunk**2 - 2.0 * shrunk * swung) * shapes.rate_hz**2


def _step_of(problem: Problem, hypothesis: Hypothesis, log: PlantBlock, name: str) -> float:
    """Return the step of the encoder that residuals are counted in, counts."""
    return log.steps(apply_all(problem.nominal, hypothesis.causes))[log.channels.index(name)]


def _averaged(values: Array, width: int) -> Array:
    return np.convolve(values, np.full(width, 1.0 / width), mode='same')


def binned(signal: Array, values: Array, independent: float = 1.0) -> Binned:
    """
    Return the mean of `values` (n,) in `BINS` equal bins of `signal` (n,), at the signal's mean there.

    Bins with fewer than `LEAST_IN_BIN` samples are left out. Of n samples in a bin, n times
    `independent` count for the standard error: what an observer has passed changes slowly.
    """
    edges = np.linspace(signal.min(), signal.max(), BINS + 1)
    which = np.clip(np.searchsorted(edges, signal, side='right') - 1, 0, BINS - 1)
    number = np.bincount(which, minlength=BINS)
    enough = number >= LEAST_IN_BIN
    counted = np.maximum(number, 1)
    at = np.bincount(which, signal, BINS) / counted
    mean = np.bincount(which, values, BINS) / counted
    spread = np.bincount(which, (values - mean[which]) ** 2, BINS) / counted
    error = np.sqrt(spread / np.maximum(independent * number, 1.0))
    return Binned(at[enough], mean[enough], error[enough])
