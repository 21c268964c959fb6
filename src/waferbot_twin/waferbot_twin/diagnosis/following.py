# SPDX-License-Identifier: Apache-2.0
"""
Does what is left over follow the command? Then something is missing, whatever it is.

Noise knows nothing of what was commanded, nor does the noise-free log of the model with the causes
found (`closed_loop_record`). So what an axis leaves over is regressed on what the command makes that
axis do there: position, speed, acceleration, currents, some of their products, and the change of each,
with the noise coloured as it is, and by the other encoder of its axis where that tells of it; as another
question, on harmonics of the motor's electrical cycle there, alone and times the speed: what a motor
does that is not as even as its model shows in these; and as a third on any smooth function of the
position: scales and screws are not as even, either. Of noise alone, twice the gain in ln L has a
chi-squared distribution with as many degrees of freedom as there are regressors.

Limit: what a coarse encoder rounds off goes with its position, and is no noise; it is not asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import fit
from waferbot_twin.residuals.noise_free_motion import Motion, change, motions
from waferbot_twin.residuals.problem import PLANT, WINDINGS, Cause, Problem, apply_all
from waferbot_twin.residuals.record import Array

CHANCE = 1e-8
"""
Probability that one channel of noise alone follows the command.

So small because coloured noise is only about an autoregression: in 60 empty pairs of logs a regressor of
the plant gained 1.07 in the mean instead of 1, and the least probability of 600 channels was 2e-5;
in another pair it was 3e-6.
"""

BLOCKS = (PLANT, WINDINGS)
"""Those whose output is measured with noise and follows the command through a machine."""

HARMONICS = (1, 2, 6)
"""
Of the electrical cycle: current sensors make the first and the second, unequal windings the second, the
fifth and the seventh of the back-EMF the sixth.
"""


ALONG = 8
"""Cosines on the way of an axis: more are for `encoder_orders`."""


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
        shown = {channel.axis for block in BLOCKS for channel in logs.channels(block)}
        both.append((logs, hypothesis, motions(logs, ideal, shown)))
    coarse = _coarse_encoders(problem, found.found.causes)
    axes: list[str] = []
    for block in BLOCKS:
        for name, axis in {item.name: item.axis for item in problem.channels(block)}.items():
            if axis in axes or (block == PLANT and name in coarse):
                continue
            for regressors in (_signals, _harmonics, _along_the_way):
                each = [_gained(*one, block, name, regressors) for one in both]
                count = sum(number for _, number in each)
                if count and sum(gain for gain, _ in each) > chi2.isf(CHANCE, count):
                    axes.append(axis)
                    break
    return axes


def _coarse_encoders(problem: Problem, causes: Sequence[Cause]) -> set[str]:
    """Return the encoders that show only multiples of some counts, in the logs and in the model."""
    variant = apply_all(problem.nominal, causes)
    return {
        name
        for block in problem.plants
        for name, step in zip(block.channels, block.steps(variant), strict=True)
        if step > 1.0
    }


def _gained(
    problem: Problem,
    hypothesis: Hypothesis,
    moved: Mapping[tuple[int, str], Motion],
    block: str,
    name: str,
    regressors: Callable[[Motion], list[Array]],
) -> tuple[float, int]:
    """Return what a channel gains in 2 ln L by regressors, and how many of these there are."""
    channels, left = problem.channels(block), hypothesis.residuals[block]
    noises, residuals, matrices = [], [], []
    for place, one in enumerate(channels):
        if one.name != name:
            continue
        there = moved[id(one.log.record), one.axis]
        columns = np.column_stack(
            [np.interp(one.log.times_s(name), there.clock_s, own) for own in regressors(there)]
        )
        # The other encoder of a pair tells of this one's noise, and is not asked itself.
        for member in sorted({place, place + one.noise.beside}):
            noise = channels[member].noise
            noises.append(replace(noise, beside=int(np.sign(noise.beside))))
            residuals.append(left[member])
            matrices.append(columns if member == place else np.zeros_like(columns))
    if not matrices:
        return 0.0, 0
    moves = np.any([np.any(matrix != 0.0, axis=0) for matrix in matrices], axis=0)
    with_them, without = (
        fit(residuals, [matrix[:, columns] for matrix in matrices], noises).log_likelihood
        for columns in (moves, np.zeros_like(moves))
    )
    return 2.0 * (with_them - without), int(np.count_nonzero(moves))


def _signals(axis: Motion) -> list[Array]:
    """Return signals of a motion and some of their products, and how each changes."""
    first, second = axis.currents
    speed = axis.speed
    direction = axis.direction
    signals = [
        axis.position,
        speed,
        axis.acceleration,
        first,
        second,
        direction,
        np.abs(direction),
        speed * np.abs(speed),
        direction * axis.position,
        direction * np.hypot(first, second),
    ]
    return [*signals, *(change(signal, axis.rate_hz) for signal in signals)]


def _harmonics(axis: Motion) -> list[Array]:
    """Return harmonics of the electrical cycle, from the first sample on, and these times the speed."""
    waves = [wave(order * axis.angle) for order in HARMONICS for wave in (np.cos, np.sin)]
    return [*(wave - wave[0] for wave in waves), *(wave * axis.speed for wave in waves)]


def _along_the_way(axis: Motion) -> list[Array]:
    """Return cosines of 1/2, 1, 3/2 ... periods on the way: any smooth function of the position."""
    way = axis.position - axis.position.min()
    angle = math.pi * way / (float(way.max()) or 1.0)
    return [np.cos(order * angle) - np.cos(order * angle[0]) for order in range(1, ALONG + 1)]
