# SPDX-License-Identifier: Apache-2.0
"""
What stays unexplained: where, how much, and what it goes with.

Three kinds of evidence, one for each kind of block:

- a force over speed or position of an axis that no physical cause explains as well (`discrepancy`),
  as one of the effects of the posterior;
- in a block that follows from its inputs to the last bit, anything at all that is left over;
- in every other channel, a residual that depends on what the command makes the machine do. The
  columns of the noise-free motion (position, speed, direction, acceleration, currents; where the loop
  cannot be closed what commands explain of the log, `commanded_record`) are fitted to the white residual
  by least squares, with the Bayes factor of Schwarz' approximation,

      ln BF = G - k / 2 ln N,                                                                       (1)

  G as in `estimation.evidence`, k columns, N samples, and prior odds of the expected number of causes
  over the number of channels. Noise knows nothing of the command: what goes with it is something that
  the model lacks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.discrepancy import goes_with, is_discrepancy
from waferbot_twin.diagnosis.inference.exactness import inexact
from waferbot_twin.diagnosis.inference.settings import Settings
from waferbot_twin.diagnosis.inference.single_effects import Follows, Posterior, squares_of
from waferbot_twin.effects.places import motor_axes
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import in_deviations
from waferbot_twin.noise_model.residual_spectrum import log_likelihood_ratios_in, powers_along
from waferbot_twin.residuals.commanded_record import as_commanded
from waferbot_twin.residuals.noise_free_motion import Motion, motions
from waferbot_twin.residuals.problem import PLANT, Channel, Problem
from waferbot_twin.residuals.record import Array


@dataclass(frozen=True)
class Unexplained:
    """
    Something that no cause explains.

    `share` is that of what the nominal model gets wrong in the block, on the axis, beyond noise
    (`Posterior.share`); `with_what` says what it goes with, in words.
    """

    axis: str
    block: str
    share: float
    with_what: str


def unexplained(problem: Problem, posterior: Posterior, follows: Follows) -> list[Unexplained]:
    """
    Return what stays unexplained, one line for each axis and block, the largest share first.

    `follows` is what `follows_command` found.
    """
    found = [
        Unexplained(cause.axis, PLANT, posterior.share(problem, place, follows), goes_with(cause))
        for place, cause in enumerate(posterior.found.causes)
        if is_discrepancy(cause)
    ]
    axes = {
        (block, channel.axis)
        for block in posterior.found.residuals
        for channel in problem.channels(block)
        if (block, channel.name) in follows
    }
    places = [(place, _motion_of(problem, place[1])) for place in sorted(axes)]
    places += [(place, 'its input') for place in inexact(problem, posterior)]
    for (block, axis), with_what in places:
        share = _left(problem, posterior, block, axis, follows)
        found.append(Unexplained(axis, block, share, with_what))
    largest: dict[tuple[str, str], Unexplained] = {}
    for item in sorted(found, key=lambda one: -one.share):
        largest.setdefault((item.axis, item.block), item)
    return list(largest.values())


def _motion_of(problem: Problem, axis: str) -> str:
    """Return what stands for the command of an axis: where none is known, its motion."""
    known = (
        not one.is_imported or one.path_commanded(axis) is not None for one in problem.records
    )
    return 'the commanded motion' if all(known) else 'its motion'


def _left(
    problem: Problem, posterior: Posterior, block: str, axis: str, follows: Follows
) -> float:
    """Return the share of what the nominal model gets wrong on an axis that is left over."""
    before, left = (
        squares_of(problem, item, block, axis) for item in (posterior.nothing, posterior.found)
    )
    noise = posterior.noise(problem, block, axis, follows)
    error = max(before, left) - noise
    return min((left - noise) / error, 1.0) if error > 0.0 else 0.0


def follows_command(problem: Problem, posterior: Posterior, settings: Settings) -> Follows:
    """Return the channels in which what is left over goes with the command, and its share there."""
    found = posterior.found
    try:
        ideal = problem.ideal(found.causes)
        noise_free = ideal.records if ideal else [as_commanded(one) for one in problem.records]
        moving = motions(problem, noise_free, motor_axes(problem.nominal))
    except UserError:
        return {}
    asked: dict[tuple[str, str], list[tuple[Channel, int]]] = {}
    for block, fit in found.fits.items():
        for place, channel in enumerate(problem.channels(block)):
            if fit.colours[place].error.order:
                asked.setdefault((block, channel.name), []).append((channel, place))
    prior = math.log(settings.expected_causes / max(len(asked), 1))
    result = {}
    for (block, name), channels in asked.items():
        evidence, share = _dependence(found, block, channels, moving)
        if evidence + prior > 0.0:
            result[block, name] = share
    return result


def _dependence(
    found: Hypothesis,
    block: str,
    channels: Sequence[tuple[Channel, int]],
    moving: dict[tuple[int, str], Motion],
) -> tuple[float, float]:
    """Return equation (1) of a channel in all logs, and the share of its mean square that depends."""
    fit = found.fits[block]
    signals = [_signals(moving[id(channel.log.record), channel.axis]) for channel, _ in channels]
    # An imported log has no line currents. What one log does not have is asked of none.
    known = np.all([[np.isfinite(one).all() for one in own[1]] for own in signals], axis=0)
    columns = [np.zeros((len(one), int(known.sum()))) for one in found.residuals[block]]
    for (channel, place), (clock_s, own) in zip(channels, signals, strict=True):
        kept = [one for one, is_known in zip(own, known, strict=True) if is_known]
        columns[place] = _columns(clock_s, kept, channel.log.times_s(channel.name))
    places = [place for _, place in channels]
    white = in_deviations(fit.colours, columns)
    rows = np.vstack([white[place] for place in places])
    left = [fit.whitened[place] for place in places]
    whole = np.concatenate(left)
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    solution, *_ = np.linalg.lstsq(rows / scale, whole, rcond=1e-8)
    explained = rows / scale @ solution
    cuts = np.cumsum([len(one) for one in left])[:-1]
    rest = np.split(whole - explained, cuts)
    squares = [float(one @ one) - float(two @ two) for one, two in zip(left, rest, strict=True)]
    powers = powers_along(
        rest, np.split(explained, cuts), [fit.colours[place] for place in places]
    )
    rank = np.linalg.matrix_rank(rows / scale, 1e-8)
    gained = sum(log_likelihood_ratios_in(powers, squares))
    return gained - 0.5 * float(rank) * math.log(len(whole)), sum(squares) / float(whole @ whole)


def _signals(motion: Motion) -> tuple[Array, list[Array]]:
    """Return the clock of a motion, and what the command makes the axis do, NaN where nobody knows."""
    return motion.clock_s, [
        motion.position,
        motion.speed,
        motion.acceleration,
        motion.direction,
        motion.speed * np.abs(motion.speed),
        *motion.currents,
        motion.amplitude,
    ]


def _columns(clock_s: Array, signals: Sequence[Array], times_s: Array) -> Array:
    """Return signals at some times, (n, k), each about its mean in its standard deviations."""
    columns = np.column_stack([np.interp(times_s, clock_s, one) for one in signals])
    columns = columns - columns.mean(axis=0)
    scale = columns.std(axis=0)
    return columns / np.where(scale > 0.0, scale, 1.0)
