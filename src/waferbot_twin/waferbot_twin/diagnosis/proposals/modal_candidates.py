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
that would show more in another encoder than that one has is not tried. A value that changes about as
much as the line has is a candidate (`rings`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

from joblib import Parallel, delayed

from waferbot_lockstep.errors import UserError
from waferbot_plant.modes import Mode, coupled_modes
from waferbot_twin.diagnosis.proposals.compliance_scan import (
    COARSELY,
    STANDS_OUT,
    NoiseFree,
    held_rigid,
    noise_free,
    promise,
    same_ring,
    values_tried,
)
from waferbot_twin.diagnosis.proposals.spectral_lines import (
    NEAR,
    SAME_RATE,
    Line,
    line_at,
    spectrum_of,
    strongest,
)
from waferbot_twin.estimation.hypothesis import Hypothesis, parameters_of, whole_change
from waferbot_twin.estimation.stacked_least_squares import Signature, by_channel
from waferbot_twin.residuals.problem import PLANT, Cause, Problem, apply_all

OWN = 0.3
"""Share of a mode's energy that a part has at least for the mode to be its own."""

ALIKE = 10.0
"""
Ratio of RMS changes about a line within which a compliance may have made it: a few times too much
of it is shaken by more than the right one is.
"""

FOLDS = 2
"""Up to which multiple of the rate of the samples a ring may lie."""

Ring = tuple[Cause, Signature]
"""A compliance at a value, and what it changes there."""

CORRECTIONS, ALMOST = 2, 0.001
"""How often at most a value is corrected by the line that it makes, and by what share at least."""


def at_line(
    problem: Problem, base: Hypothesis, rivals: Sequence[Cause], line: Line, workers: int = 1
) -> list[Ring]:
    """Return every compliance that the model holds rigid where it may have made a line, as a ring."""
    stiff = held_rigid(problem, rivals)
    if not stiff:
        return []
    ideal = noise_free(problem, base) if line.brief else None
    pool = Parallel(n_jobs=workers, batch_size=1)
    each = pool(delayed(_at_line)(problem, base, cause, line, ideal) for cause in stiff)
    return [tried for of_one in each for tried in of_one]


def ring_of(problem: Problem, base: Hypothesis, cause: Cause) -> Ring:
    """Return a compliance with what it changes; raises `UserError` if the machine blows up with it."""
    return cause, whole_change(problem, base, (*base.causes, cause))


def _at_line(
    problem: Problem, base: Hypothesis, cause: Cause, line: Line, ideal: NoiseFree | None
) -> list[Ring]:
    """Return a compliance with each value that may have made a line, as a ring."""
    (parameter,) = parameters_of(problem, cause)
    typical = cause.with_values({parameter.name: parameter.typical})
    step_s = problem.records[0].timing.tick_s
    found: list[Ring] = []
    for mode in _own_modes(problem, base, typical):
        if not _agrees(problem, base, mode, line):
            continue
        for frequency_hz, sign in _folded(line, 0.5 / step_s):
            ratio = mode.frequency_hz / _in_continuous_time(frequency_hz, step_s)
            value = parameter.typical * ratio**2
            if not parameter.low < value < parameter.high:
                continue
            start = replace(cause.with_values({parameter.name: value}), narrow=(parameter.name,))
            try:
                there = _on_line(problem, base, start, line, frequency_hz, sign)
                if there is None or any(same_ring(there[0], other) for other, _ in found):
                    continue
                found += (
                    [there] if ideal is None else _roughly_known(problem, base, there[0], ideal)
                )
            except UserError:  # the machine blows up with it
                continue
    return found


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
) -> Ring | None:
    """
    Return a compliance corrected by the line that it shows; none if that is far from as strong.

    Raises `UserError` if the simulation blows up.
    """
    (name,) = start.narrow
    measured_hz, measured = line_at(problem, base.residuals[PLANT], line, NEAR * line.frequency_hz)
    best = start
    for _ in range(CORRECTIONS + 1):
        change = whole_change(problem, base, (*base.causes, best))
        channels = by_channel(change[PLANT][:, 0], base.residuals[PLANT])
        shown_hz, shown = line_at(problem, channels, line, NEAR * frequency_hz)
        if not measured / ALIKE < shown < measured * ALIKE:
            return None
        factor = (1.0 + sign * (shown_hz - measured_hz) / frequency_hz) ** 2
        ring = best, change
        if abs(factor - 1.0) < ALMOST:
            break
        best = best.with_values({name: best.values[name] * factor})
    return ring


def _roughly_known(
    problem: Problem, base: Hypothesis, cause: Cause, ideal: NoiseFree
) -> list[Ring]:
    """
    Return the best value about one of which the frequency is known to some parts of a hundred only.

    None if none gains anything: most brief lines are noise.
    """
    gain_of = functools.partial(promise, base, ideal)
    tried = values_tried(problem, cause, COARSELY, gain_of)
    best, gain = max(tried, key=lambda item: item[1])
    return [ring_of(problem, base, best)] if gain >= STANDS_OUT else []
