# SPDX-License-Identifier: Apache-2.0
"""
The value at which a compliance rings as the logs do.

What a compliance changes is a ring; a change of its frequency by a part of a hertz changes the phase of
all of it, and the likelihood goes up and down. So each value is tried in whatever phase suits best,
which asks only that the ring is coherent for as long as it lasts: of one that is damped within a few
cycles values some percent apart can still be told, of one that goes on (`modal_candidates`) parts of a
thousand.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import hilbert

from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.proposals.screening import Screened, untempered
from waferbot_twin.estimation.hypothesis import (
    Hypothesis,
    changed_by,
    evaluate,
    in_quick_steps,
    log_likelihood_ratio,
    parameters_of,
    whole_change,
)
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel, fit_jointly
from waferbot_twin.noise_model.prediction_error import (
    Colour,
    in_deviations,
    log_likelihoods_with,
    whitened,
)
from waferbot_twin.residuals.problem import Cause, Problem
from waferbot_twin.residuals.record import Array, Record

CLOSE = (
    (-0.009, -0.006, -0.003, 0.0, 0.003, 0.006, 0.009),
    (-0.003, -0.002, -0.001, 0.0, 0.001, 0.002, 0.003),
    (-0.0009, -0.0006, -0.0003, 0.0, 0.0003, 0.0006, 0.0009),
)
"""How far about a value others are tried, as a share of it; then ever closer about the best of these."""

TUNING = tuple(np.geomspace(0.04, 3.0, 45))
"""Times its typical value at which a compliance is tried, 10 % apart."""

RIVALLING, MOST_MAXIMA = 0.5, 2
"""
Share of the highest gain from which on another maximum is tried more closely, too, and how many.

One may be narrower than these values are apart: then the right one seems lower than a wrong one.
"""

SOFTLY = (0.78, 0.88, 1.0, 1.13, 1.28)
"""Times its value at which one is tried that is softer than all these."""

COARSELY = (0.925, 0.95, 0.975, 1.0, 1.025, 1.05, 1.075)
"""Times its value at which one is tried about the best of these, or about one roughly known."""

ENOUGH = 1.0
"""Gain in 2 ln L below which values still closer are not worth trying."""

PLAINLY = 10.0
"""Gain in 2 ln L from which on another value is plainly better."""

DAMPED = tuple(np.geomspace(0.02, 2.0, 38))
"""
Times its typical value at which a compliance is tried where nothing else is found: 13 % apart. Of those
in the machine's bearings and shafts that are as large as a log of a second shows, all lie here.
"""

APART = 4
"""One of so many of these is tried first: between two that are out of reach the others are, too."""

SLOWER = tuple(np.linspace(0.95, 1.25, 13))
"""
Times its value at which one is tried about the best of these. Those are found in steps of the encoders'
cycle, in which a part rings more slowly, at 1.6 kHz by 6 %: the right value is a little softer.
"""

STANDS_OUT = 12.0
"""
Gain in 2 ln L from which on the best of these is tried more closely. Each has two degrees of freedom, so
in noise one in 400 gains as much.
"""


@dataclass(frozen=True)
class NoiseFree:
    """Logs in which something is tried, and the hypothesis beside which it is."""

    problem: Problem
    beside: Hypothesis

    def in_quick_steps(self) -> NoiseFree:
        """Return the same in steps of the encoders' cycle."""
        return NoiseFree(*in_quick_steps(self.problem, self.beside))


def noise_free(problem: Problem, base: Hypothesis) -> NoiseFree:
    """
    Return logs in which rings are tried without the noise of readings: that makes any stiff part ring.

    Logs that do not say what was commanded stand for themselves, with their noise, and so do those in
    which the model blows up without measured positions to hold it.
    """
    try:
        ideal = problem.ideal(base.causes)
        return (
            NoiseFree(ideal, evaluate(ideal, base.causes)) if ideal else NoiseFree(problem, base)
        )
    except UserError:
        return NoiseFree(problem, base)


def may_ring(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause is the compliance, not yet tuned, of what the model holds rigid."""
    rigid = all(item.neutral == 0.0 for item in parameters_of(problem, cause))
    return cause.effect.rings and rigid and not cause.narrow


def same_ring(cause: Cause, other: Cause) -> bool:
    """Return whether a compliance is so near another value that the same would be found from there."""
    (name,) = cause.narrow
    return abs(cause.values[name] / other.values[name] - 1.0) < CLOSE[0][-1]


def held_rigid(problem: Problem, rivals: Iterable[Cause]) -> list[Cause]:
    """Return the compliances that may ring of which there is none yet."""
    return [
        cause for cause in rivals if may_ring(problem, cause) and not any(cause.values.values())
    ]


def screen_damped(
    problem: Problem, base: Hypothesis, rivals: Sequence[Cause], workers: int = 1
) -> list[Screened]:
    """
    Try every compliance that the model holds rigid for rings that are damped too quickly for a line.

    Costs a simulation of the plant for each value.
    """
    stiff = held_rigid(problem, rivals)
    if not stiff:
        return []
    quick = noise_free(problem, base).in_quick_steps()
    pool = Parallel(n_jobs=workers, batch_size=1)
    each = pool(delayed(_damped)(problem, base, cause, quick) for cause in stiff)
    return [
        untempered(tried, 0.5 * (gain - math.log(base.samples)))
        for found in each
        for tried, gain in found
    ]


def _damped(
    problem: Problem, base: Hypothesis, cause: Cause, quick: NoiseFree
) -> list[tuple[Cause, float]]:
    """Return the best values of a compliance, each with its gain in 2 ln L, that gain anything."""
    (item,) = parameters_of(problem, cause)
    typical = replace(cause.with_values({item.name: item.typical}), narrow=(item.name,))
    found: list[tuple[Cause, float]] = []
    try:
        tried = _within_reach(base, quick, times_its_value(problem, typical, DAMPED))
        if max(gain for _, gain in tried) < STANDS_OUT:
            return []
        for one in _maxima(tried):
            best, _ = best_of(problem, base, one, SLOWER)
            there = evaluate(problem, (*base.causes, best))
            gain = 2.0 * log_likelihood_ratio(there, base)
            if gain > STANDS_OUT:
                found.append((best, gain))
    except UserError:  # the machine blows up with it
        return []
    return found


def _within_reach(
    base: Hypothesis, logs: NoiseFree, values: Sequence[Cause]
) -> list[tuple[Cause, float]]:
    """
    Return values of a compliance that the logs could hold, each with its gain as `promise` has it.

    With w what a value changes, white and in deviations of the noise, a log that holds it is less likely
    without it by |w|^2 in 2 ln L. Where that is below `STANDS_OUT` it does not show; and there is not
    more left over than there is: white residuals of N samples have a square sum of N.
    """
    found: dict[int, tuple[Cause, float]] = {}
    beyond: dict[int, int] = {}  # -1 does not show, 1 is more than there is, 0 is within reach

    def try_value(place: int) -> None:
        change = _change_in(logs, values[place])
        shown = in_deviations(_colours_of(base, change), _channels_of(base, change))
        square = sum(float(np.sum(part**2)) for part in shown)
        samples = sum(len(part) for part in shown)
        beyond[place] = -1 if square < STANDS_OUT else int(square > samples)
        found[place] = values[place], _gain_of(base, change)

    first = sorted({*range(0, len(values), APART), len(values) - 1})
    for place in first:
        try_value(place)
    for below, above in itertools.pairwise(first):
        both_beyond = beyond[below] != 0 and beyond[below] == beyond[above]
        if not both_beyond:
            for place in range(below + 1, above):
                try_value(place)
    return [found[place] for place in sorted(found)]


def promise(base: Hypothesis, logs: NoiseFree, cause: Cause) -> float:
    """
    Return the gain in 2 ln L of what a cause changes in noise-free logs, in any size and phase.

    In noise of the colour that the residuals of `base` have as they are.
    """
    return _gain_of(base, _change_in(logs, cause))


def _change_in(logs: NoiseFree, cause: Cause) -> dict[str, Array]:
    return whole_change(logs.problem, logs.beside, (*logs.beside.causes, cause))


def _gain_of(base: Hypothesis, change: Mapping[str, Array]) -> float:
    """Return the gain in 2 ln L of a change by block, in any size and phase."""
    blocks = list(change)
    rows, right = whitened(
        [channel for block in blocks for channel in base.residuals[block]],
        [part for block in blocks for part in _with_later(change[block], base.residuals[block])],
        _colours_of(base, change),
    )
    scale = np.sqrt(np.sum(rows**2, axis=0))
    scale[scale == 0.0] = 1.0
    solution, *_ = np.linalg.lstsq(rows / scale, right, rcond=1e-10)
    return float(right @ right - np.sum((rows / scale @ solution - right) ** 2))


def _colours_of(base: Hypothesis, change: Mapping[str, Array]) -> list[Colour]:
    return [colour for block in change for colour in base.fits[block].colours]


def _channels_of(base: Hypothesis, change: Mapping[str, Array]) -> list[Array]:
    return [
        part
        for block, all_of in change.items()
        for part in by_channel(all_of, base.residuals[block])
    ]


def _with_later(change: Array, channels: Sequence[Array]) -> list[Array]:
    """Return a change channel by channel, beside itself a quarter of a cycle later: (N, 2)."""
    parts = by_channel(change, channels)
    return [np.column_stack([part, hilbert(part[:, 0]).imag]) for part in parts]


def closer(problem: Problem, base: Hypothesis, cause: Cause) -> Cause:
    """Return the best of the values close to that of a compliance."""
    gain = -math.inf
    for close in CLOSE:
        before = gain
        cause, gain = best_of(problem, base, cause, [1.0 + share for share in close])
        if gain < max(before + ENOUGH, STANDS_OUT):
            break
    return cause


def best_of(
    problem: Problem, base: Hypothesis, cause: Cause, factors: Sequence[float]
) -> tuple[Cause, float]:
    """Return the best of so many times the value of a compliance, and its gain in 2 ln L."""
    gain_of = functools.partial(in_any_phase, problem, base)
    return max(values_tried(problem, cause, factors, gain_of), key=lambda item: item[1])


def values_tried(
    problem: Problem, cause: Cause, factors: Sequence[float], gain_of: Callable[[Cause], float]
) -> list[tuple[Cause, float]]:
    """Return so many times the value of a compliance, each with its gain in 2 ln L."""
    return [(one, gain_of(one)) for one in times_its_value(problem, cause, factors)]


def times_its_value(problem: Problem, cause: Cause, factors: Sequence[float]) -> list[Cause]:
    """Return a compliance with so many times its value, as far as it may go."""
    (item,) = parameters_of(problem, cause)
    value = cause.values[item.name]
    return [
        cause.with_values({item.name: float(np.clip(value * factor, item.low, item.high))})
        for factor in factors
    ]


def _maxima(tried: Sequence[tuple[Cause, float]]) -> list[Cause]:
    """Return what gains more than its neighbours, and much: the best first."""
    gains = np.array([gain for _, gain in tried])
    ends = np.concatenate([[-math.inf], gains, [-math.inf]])
    peaks = np.flatnonzero(
        (gains >= ends[:-2]) & (gains > ends[2:]) & (gains >= RIVALLING * gains.max())
    )
    best_first = sorted((int(place) for place in peaks), key=lambda place: -gains[place])
    return [tried[place][0] for place in best_first[:MOST_MAXIMA]]


def tuned(problem: Problem, base: Hypothesis, cause: Cause) -> Cause:
    """
    Return a compliance where it rings as the logs do, of any size.

    Where the loop damps a ring quickly it makes no line, but values some percent apart can still be
    told. They are tried in the log that shows most of it for its length: a ring is the same in all. The
    cause as it is where no other value explains that log plainly better in any phase, or none all of
    them better as it is. Raises `UserError`.
    """
    (item,) = parameters_of(problem, cause)
    narrow = replace(cause, narrow=(item.name,))
    there = problem.of_log(
        _shown_most_in(problem, base, narrow.with_values({item.name: item.typical}))
    )
    beside = evaluate(there, base.causes)
    gain_of = functools.partial(in_any_phase, there, beside)
    if cause.values[item.name] < TUNING[-1] * item.typical:
        typical = narrow.with_values({item.name: item.typical})
        tried = values_tried(problem, typical, TUNING, gain_of)
    else:
        tried = values_tried(problem, narrow, SOFTLY, gain_of)
    least = gain_of(cause) + PLAINLY
    refined = [cause]
    for one in _maxima(tried):
        best, gain = best_of(there, beside, one, COARSELY)
        if gain >= least:
            refined.append(closer(there, beside, best))
    # In any phase much suits a little: as they are, values far too soft would be the worst of all.
    return max(refined, key=lambda one: evaluate(problem, (*base.causes, one)).log_likelihood)


def _shown_most_in(problem: Problem, base: Hypothesis, cause: Cause) -> Record:
    """Return the log in which a cause changes most, white, mean over its time."""
    change = whole_change(problem, base, (*base.causes, cause))
    white = in_deviations(_colours_of(base, change), _channels_of(base, change))
    channels = [channel for block in change for channel in problem.channels(block)]
    power = {id(channel.log.record): 0.0 for channel in channels}
    for channel, part in zip(channels, white, strict=True):
        record = channel.log.record
        power[id(record)] += float(np.sum(part**2)) / record.duration_s
    return max((channel.log.record for channel in channels), key=lambda record: power[id(record)])


def in_any_phase(problem: Problem, base: Hypothesis, cause: Cause) -> float:
    """Return the gain in 2 ln L of what a cause changes, as large and in such phase as suits best."""
    change = whole_change(problem, base, (*base.causes, cause))
    return gain_in_any_phase(problem, base, change)


def gain_in_any_phase(problem: Problem, base: Hypothesis, change: Signature) -> float:
    """
    Return the gain in 2 ln L of a change, as large and in such phase as suits best.

    That takes the change beside itself a quarter of a cycle later.
    """
    both = {
        block: np.vstack(_with_later(matrix, base.residuals[block]))
        for block, matrix in change.items()
    }
    found = fit_jointly(problem, base.residuals, both, 2, known=base.fits)
    blocks = list(both)
    before = [channel for block in blocks for channel in base.residuals[block]]
    parts = [part for b in blocks for part in by_channel(both[b], base.residuals[b])]
    left = [one + part @ found.value for one, part in zip(before, parts, strict=True)]
    # Compared with the same noise models: `hypothesis.log_likelihood_ratio`.
    colours = found.colours, _colours_of(base, change)
    after, as_it_was = (
        max(sum(log_likelihoods_with(one, channels)) for one in colours)
        for channels in (left, before)
    )
    return 2.0 * (after - as_it_was)


def gain_as_it_is(problem: Problem, base: Hypothesis, change: Signature) -> float:
    """Return the gain in 2 ln L of a change of the residuals as it is."""
    return 2.0 * log_likelihood_ratio(changed_by(problem, base.residuals, change), base)
