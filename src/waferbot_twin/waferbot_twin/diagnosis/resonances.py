# SPDX-License-Identifier: Apache-2.0
"""
Parts that give a little, much stiffer than their data say: the machine rings.

What such a compliance c changes is a ring at the frequency of its own mode, hundreds of hertz, for
tenths of a second. A change of f by a part of a hertz then changes the phase of all of it, so the
likelihood has a maximum only some parts of a thousand wide, and no way leads there from c = 0. But the
ring shows as a line in the spectrum of what the plant leaves over, and a mode that is all in one part
has

    f = f_typical sqrt(c_typical / c).

So each compliance is tried where one of its modes is on a line, also on one that is folded about
multiples of half the rate of the samples (the mechanism is faster); first by the modes of the machine,
which the steps of the simulation in time make lower, then corrected by the line that it shows. A mode
that would show more in another encoder than that one has is not tried. Where a value changes about as
much as the line has, others close by are tried, each in whatever phase suits best: so the ring has to
be coherent for as long as it lasts only, not the same to a part of a cycle. From the best one a fit
finds the rest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from joblib import Parallel, delayed
from scipy.signal import hilbert

from waferbot_lockstep.errors import UserError
from waferbot_plant.modes import Mode, coupled_modes
from waferbot_twin.diagnosis.hypothesis import Hypothesis, evaluate, parameters_of, whole_change
from waferbot_twin.diagnosis.jointly import by_channel, fit_jointly
from waferbot_twin.diagnosis.problem import PLANT, Cause, Problem, apply_all
from waferbot_twin.diagnosis.screening import Screened
from waferbot_twin.diagnosis.spectral_lines import (
    NEAR,
    SAME_RATE,
    Line,
    line_at,
    spectrum_of,
    strongest,
)

OWN = 0.3
"""Share of a mode's energy that a part has at least for the mode to be its own."""

ALIKE = 10.0
"""
Ratio of RMS changes about a line within which a compliance may have made it: a few times too much
of it is shaken by more than the right one is.
"""

FOLDS = 2
"""Up to which multiple of the rate of the samples a ring may lie."""

CORRECTIONS = 2
"""How often a value is corrected by the line that it makes."""

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

COARSELY = (-0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075)
"""As `CLOSE`, about the best of these."""

ENOUGH = 1.0
"""Gain in 2 ln L below which values still closer are not worth trying."""

PLAINLY = 10.0
"""Gain in 2 ln L from which on another value is plainly better."""

FAINTLY = 4.0
"""
Gain in 2 ln L below which no value about one that may have made a brief line is tried more closely.

The best of seven independent values, each in the phase that suits (two degrees of freedom), gains
2 (1 + 1/2 + ... + 1/7) = 5.2 in noise in the mean.
"""


def screen_lines(
    problem: Problem,
    base: Hypothesis,
    rivals: Sequence[Cause],
    found: Sequence[Line],
    workers: int = 1,
) -> list[Screened]:
    """Try every compliance that the model holds rigid at the lines that it may have made."""
    stiff = [
        cause
        for cause in rivals
        if found and not any(cause.values.values()) and may_ring(problem, cause)
    ]
    pool = Parallel(n_jobs=workers, batch_size=1)
    each = pool(delayed(_at_lines)(problem, base, cause, found) for cause in stiff)
    return [
        Screened(tried, gain - math.log(base.samples), np.zeros(1))
        for at_lines in each
        for tried, gain in at_lines
    ]


def may_ring(problem: Problem, cause: Cause) -> bool:
    """Return whether a cause is the compliance, not yet tuned, of what the model holds rigid."""
    rigid = all(item.neutral == 0.0 for item in parameters_of(problem, cause))
    return cause.effect.rings and rigid and not cause.narrow


def _at_lines(
    problem: Problem, base: Hypothesis, cause: Cause, found: Sequence[Line]
) -> list[tuple[Cause, float]]:
    """Return a compliance with each value that may have made a line, and its gain in 2 ln L there."""
    (parameter,) = parameters_of(problem, cause)
    typical = cause.with_values({parameter.name: parameter.typical})
    step_s = problem.records[0].timing.tick_s
    begun: list[Cause] = []
    tried: list[tuple[Cause, float]] = []
    for mode, line in itertools.product(_own_modes(problem, base, typical), found):
        if not _agrees(problem, base, mode, line):
            continue
        for frequency_hz, sign in _folded(line, 0.5 / step_s):
            ratio = mode.frequency_hz / _in_continuous_time(frequency_hz, step_s)
            value = parameter.typical * ratio**2
            if not parameter.low < value < parameter.high:
                continue
            start = replace(cause.with_values({parameter.name: value}), narrow=(parameter.name,))
            try:
                found_there = _on_line(problem, base, start, line, frequency_hz, sign)
                if found_there is None or any(_same(found_there, other) for other in begun):
                    continue
                begun.append(found_there)
                tried += _refined(problem, base, found_there, line)
            except UserError:  # the machine blows up with it
                continue
    return tried


def _same(cause: Cause, other: Cause) -> bool:
    """Return whether a compliance is so near another value that the same would be found from there."""
    (name,) = cause.narrow
    return abs(cause.values[name] / other.values[name] - 1.0) < CLOSE[0][-1]


def _agrees(problem: Problem, base: Hypothesis, mode: Mode, line: Line) -> bool:
    """
    Return whether a mode that made a line would not show too much in any other encoder.

    Encoder j moves by w_j = k_j shape_j, with k_j counts per unit. Where the line has the RMS value A_i
    in its own channel i, j would have A_i |w_j / w_i|, which is more than j has there, A_j, by no more
    than `ALIKE`. Above the observer's frequency the residuals have what the encoders have.
    """
    encoders = problem.nominal.description.encoders
    moves, measured = {}, {}
    for name in dict.fromkeys(problem.channel_names(PLANT)):
        spectrum = spectrum_of(problem, base.residuals[PLANT], name, line.brief)
        # With another rate of samples a ring is folded to another frequency.
        if spectrum is None or abs(spectrum.rate_hz / line.rate_hz - 1.0) > SAME_RATE:
            continue
        encoder = encoders[name]
        moves[name] = abs(mode.shape.get(encoder.coordinate, 0.0) * encoder.counts_per_unit)
        _, measured[name] = strongest(spectrum, line, NEAR * line.frequency_hz)
    own = moves[line.channel]
    return all(
        measured[line.channel] * moves[name] <= ALIKE * measured[name] * own for name in moves
    )


def _folded(line: Line, highest_hz: float) -> list[tuple[float, float]]:
    """Return the frequencies, Hz, that samples show as a line, and whether that rises (1) with them."""
    beside = [
        (fold * line.rate_hz + sign * line.frequency_hz, sign)
        for fold in range(1, FOLDS + 1)
        for sign in (-1.0, 1.0)
    ]
    return [(line.frequency_hz, 1.0), *(item for item in beside if item[0] < highest_hz)]


def _in_continuous_time(frequency_hz: float, step_s: float) -> float:
    """
    Return the frequency of a mode that rings at another one in steps of the implicit midpoint rule, Hz.

    tan(omega' h / 2) = omega h / 2, with omega' in steps of h and omega without.
    """
    return math.tan(math.pi * frequency_hz * step_s) / (math.pi * step_s)


def _own_modes(problem: Problem, base: Hypothesis, cause: Cause) -> list[Mode]:
    """Return the modes that a compliance makes, at its value."""
    (parameter,) = parameters_of(problem, cause)
    timing = problem.records[0].timing
    value, more = cause.values[parameter.name], 1.01
    softer = cause.with_values({parameter.name: more * value})
    here, there = (
        coupled_modes(apply_all(problem.nominal, (*base.causes, one)).build(timing))
        for one in (cause, softer)
    )
    if len(here) != len(there):
        return []
    return [
        mode
        for mode, moved in zip(here, there, strict=True)
        if 1.0 - moved.frequency_hz / mode.frequency_hz > 0.5 * OWN * (more - 1.0)
    ]


def _on_line(
    problem: Problem,
    base: Hypothesis,
    start: Cause,
    line: Line,
    frequency_hz: float,
    sign: float,
) -> Cause | None:
    """
    Return a compliance corrected by the line that it shows; none if that is far from as strong.

    Raises `UserError` if the simulation blows up.
    """
    (name,) = start.narrow
    measured_hz, measured = line_at(problem, base.residuals[PLANT], line, NEAR * line.frequency_hz)
    best = start
    for _ in range(CORRECTIONS):
        change = whole_change(problem, base, (*base.causes, best))[PLANT]
        channels = by_channel(change[:, 0], base.residuals[PLANT])
        shown_hz, shown = line_at(problem, channels, line, NEAR * frequency_hz)
        if not measured / ALIKE < shown < measured * ALIKE:
            return None
        too_high_hz = sign * (shown_hz - measured_hz)
        factor = (1.0 + too_high_hz / frequency_hz) ** 2
        best = best.with_values({name: best.values[name] * factor})
    return best


def _refined(
    problem: Problem, base: Hypothesis, cause: Cause, line: Line
) -> Iterator[tuple[Cause, float]]:
    """Give the best value near that of a compliance, and its gain in 2 ln L, if it may gain anything."""
    if line.brief:  # its frequency is known to some parts of a hundred only
        cause, gain = _best(problem, base, cause, [1.0 + share for share in COARSELY])
        if gain < FAINTLY:
            return
    yield _closer(problem, base, cause)


def _closer(problem: Problem, base: Hypothesis, cause: Cause) -> tuple[Cause, float]:
    """Return the best of the values close to that of a compliance, and its gain in 2 ln L."""
    gain = -math.inf
    for close in CLOSE:
        before = gain
        cause, gain = _best(problem, base, cause, [1.0 + share for share in close])
        if gain < before + ENOUGH:
            break
    return cause, gain


def _best(
    problem: Problem, base: Hypothesis, cause: Cause, factors: Sequence[float]
) -> tuple[Cause, float]:
    """Return the best of so many times the value of a compliance, and its gain in 2 ln L."""
    return max(_tried(problem, base, cause, factors), key=lambda item: item[1])


def _tried(
    problem: Problem, base: Hypothesis, cause: Cause, factors: Sequence[float]
) -> list[tuple[Cause, float]]:
    """Return so many times the value of a compliance, each with its gain in 2 ln L."""
    (item,) = parameters_of(problem, cause)
    value = cause.values[item.name]
    about = [
        cause.with_values({item.name: float(np.clip(value * factor, item.low, item.high))})
        for factor in factors
    ]
    return [(one, _in_any_phase(problem, base, one)) for one in about]


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
    told. The cause as it is where no other value explains the logs plainly better in any phase, or
    none better as it is. Raises `UserError`.
    """
    (item,) = parameters_of(problem, cause)
    narrow = replace(cause, narrow=(item.name,))
    if cause.values[item.name] < TUNING[-1] * item.typical:
        typical = narrow.with_values({item.name: item.typical})
        tried = _tried(problem, base, typical, TUNING)
    else:
        tried = _tried(problem, base, narrow, SOFTLY)
    about = [1.0 + share for share in COARSELY]
    least = _in_any_phase(problem, base, cause) + PLAINLY
    refined = [cause]
    for one in _maxima(tried):
        best, gain = _best(problem, base, one, about)
        if gain >= least:
            refined.append(_closer(problem, base, best)[0])
    # In any phase much suits a little: as they are, values far too soft would be the worst of all.
    return max(refined, key=lambda one: evaluate(problem, (*base.causes, one)).log_likelihood)


def _in_any_phase(problem: Problem, base: Hypothesis, cause: Cause) -> float:
    """
    Return the gain in 2 ln L of what a cause changes, as large and in such phase as suits best.

    That takes the change beside itself a quarter of a cycle later.
    """
    change = whole_change(problem, base, (*base.causes, cause))
    both = {}
    for block, matrix in change.items():
        channels = by_channel(matrix[:, 0], base.residuals[block])
        later = np.concatenate([hilbert(channel).imag for channel in channels])
        both[block] = np.column_stack([matrix, later])
    found = fit_jointly(problem, base.residuals, both, known=base.fits)
    return 2.0 * (found.log_likelihood - sum(base.fits[b].log_likelihood for b in both))
