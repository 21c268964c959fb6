# SPDX-License-Identifier: Apache-2.0
"""
Does what is left over follow the command? Then something is missing, whatever it is.

Noise knows nothing of what was commanded, nor does the noise-free log of the model with the causes
found (`closed_loop_record`). So what an axis leaves over is regressed on what the command makes that
axis do there: position, speed, acceleration, currents, some of their products, and the change of each,
with the noise coloured as it is; and, as another question, on harmonics of the motor's electrical cycle
there, alone and times the speed: what a motor does that is not as even as its model shows in these. Of
noise alone, twice the gain in ln L has a chi-squared distribution with as many degrees of freedom as
there are regressors.

Limit: what a coarse encoder rounds off goes with its position, and is no noise; it is not asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.noise_free_motion import Motion, change, motions
from waferbot_twin.diagnosis.problem import PLANT, WINDINGS, Cause, Problem, apply_all
from waferbot_twin.diagnosis.record import Array
from waferbot_twin.diagnosis.search_state import Search
from waferbot_twin.diagnosis.whitening import fit

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
            for regressors in (_signals, _harmonics):
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
    every = zip(problem.channels(block), hypothesis.residuals[block], strict=True)
    own = [(channel, residual) for channel, residual in every if channel.name == name]
    if not own:
        return 0.0, 0
    channels, left = zip(*own, strict=True)
    matrices = []
    for one in channels:
        there = moved[id(one.log.record), one.axis]
        columns = [
            np.interp(one.log.times_s(name), there.clock_s, column) for column in regressors(there)
        ]
        matrices.append(np.column_stack(columns))
    noises = [one.noise.alone() for one in channels]
    moves = np.any([np.any(matrix != 0.0, axis=0) for matrix in matrices], axis=0)
    with_them, without = (
        fit(left, [matrix[:, columns] for matrix in matrices], noises).log_likelihood
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
