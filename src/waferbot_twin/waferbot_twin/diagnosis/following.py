# SPDX-License-Identifier: Apache-2.0
"""
Does what is left over follow the command? Then something is missing, whatever it is.

Noise knows nothing of what was commanded, nor does the noise-free log of the model with the causes
found (`closed_loop_record`). So what an axis leaves over is regressed on what the command makes that
axis do there: position, speed, acceleration, currents, some of their products, and the change of each,
with the noise coloured as it is. Of noise alone, twice the gain in ln L has a chi-squared distribution
with as many degrees of freedom as there are regressors.

Limit: what a coarse encoder rounds off goes with its position, and is no noise; it is not asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from waferbot_lockstep.contract import AXES, ENCODERS
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.plant_block import PlantBlock
from waferbot_twin.diagnosis.problem import PLANT, WINDINGS, Cause, Problem, apply_all
from waferbot_twin.diagnosis.record import Array, Record
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.whitening import fit
from waferbot_twin.logs.machine import POSITION_ENCODER

CHANCE = 1e-8
"""
Probability that one channel of noise alone follows the command.

So small because coloured noise is only about an autoregression: in 60 empty pairs of logs a regressor of
the plant gained 1.07 in the mean instead of 1, and the least probability of 600 channels was 2e-5;
in another pair it was 3e-6.
"""

BLOCKS = (PLANT, WINDINGS)
"""Those whose output is measured with noise and follows the command through a machine."""

STANDS_COUNTS_S = 200.0
"""Speed that is about none."""

SMOOTHING_S = 0.005
"""Over which signals are averaged, so that counts do not look like speed."""


def axes_that_follow(problem: Problem, judge: Problem, found: Search) -> list[str]:
    """
    Return the axes on which what the causes leave over follows the command, in all logs together.

    No axis where a log does not have what was commanded, or the model's loop is unstable: then there
    is no noise-free log to ask.
    """
    both = []
    for logs, hypothesis in ((problem, found.found), (judge, found.judged)):
        try:
            ideal = logs.ideal(hypothesis.causes)
        except UserError:
            ideal = None
        if ideal is None:
            return []
        pairs = zip(logs.records, ideal.records, strict=True)
        both.append((logs, hypothesis, {id(one): other for one, other in pairs}))
    coarse = _coarse_encoders(problem, found.found.causes)
    axes: list[str] = []
    for block in BLOCKS:
        for name, axis in {item.name: item.axis for item in problem.channels(block)}.items():
            if axis in axes or (block == PLANT and name in coarse):
                continue
            each = [_gained(*one, block, name) for one in both]
            regressors = sum(count for _, count in each)
            if regressors and sum(gain for gain, _ in each) > chi2.isf(CHANCE, regressors):
                axes.append(axis)
    return axes


def _coarse_encoders(problem: Problem, causes: Sequence[Cause]) -> set[str]:
    """Return the encoders that show only multiples of some counts, in the logs and in the model."""
    variant = apply_all(problem.nominal, causes)
    return {
        name
        for block in problem.blocks[PLANT]
        if isinstance(block, PlantBlock)
        for name, step in zip(block.channels, block.steps(variant), strict=True)
        if step > 1.0
    }


def _gained(
    problem: Problem,
    hypothesis: Hypothesis,
    ideal: Mapping[int, Record],
    block: str,
    name: str,
) -> tuple[float, int]:
    """Return what a channel gains in 2 ln L by the regressors, and how many of these there are."""
    every = zip(problem.channels(block), hypothesis.residuals[block], strict=True)
    own = [(channel, residual) for channel, residual in every if channel.name == name]
    if not own:
        return 0.0, 0
    channels, left = zip(*own, strict=True)
    matrices = [
        _regressors(ideal[id(one.log.record)], one.log.times_s(name), one.axis) for one in channels
    ]
    noises = [one.noise.alone() for one in channels]
    moves = np.any([np.any(matrix != 0.0, axis=0) for matrix in matrices], axis=0)
    with_them, without = (
        fit(left, [matrix[:, columns] for matrix in matrices], noises).log_likelihood
        for columns in (moves, np.zeros_like(moves))
    )
    return 2.0 * (with_them - without), int(np.count_nonzero(moves))


def _regressors(ideal: Record, times_s: Array, axis: str) -> Array:
    """Return what the command makes an axis do, (samples, regressors), without any noise."""
    timing = ideal.timing
    place = AXES.index(axis)
    encoder = ENCODERS.index(POSITION_ENCODER[axis])
    rate_hz = timing.encoder_hz
    width = max(3, round(SMOOTHING_S * rate_hz))
    kernel = np.hanning(width + 2)
    kernel /= kernel.sum()

    def smooth(signal: Array) -> Array:
        ends = np.pad(signal, width, mode='edge')
        return np.asarray(np.convolve(ends, kernel, mode='same')[width:-width])

    def change(signal: Array) -> Array:
        return smooth(np.gradient(signal) * rate_hz)

    position = smooth(ideal.reading[:, encoder] - ideal.reading[0, encoder])
    speed = change(position)
    acceleration = change(speed)
    currents = ideal.line_current[:: timing.encoder_divider, 2 * place : 2 * place + 2]
    currents = currents[: len(position)]  # the last tick may be without a reading
    first, second = smooth(currents[:, 0]), smooth(currents[:, 1])
    direction = np.tanh(speed / STANDS_COUNTS_S)
    signals = [
        position,
        speed,
        acceleration,
        first,
        second,
        direction,
        np.abs(direction),
        speed * np.abs(speed),
        direction * position,
        direction * np.hypot(first, second),
    ]
    columns = [*signals, *(change(signal) for signal in signals)]
    clock_s = np.arange(len(position)) / rate_hz
    return np.column_stack([np.interp(times_s, clock_s, column) for column in columns])
