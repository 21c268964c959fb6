# SPDX-License-Identifier: Apache-2.0
"""
Errors of an encoder that come back along its way, whatever their period.

A reading that is off by a cos(k n) + b sin(k n) at n counts is in the innovation of the plant's observer
as s^2 / (s^2 + 2 z w s + w^2) and the whitening make it. With w[i] what is left over, white, and u the
same filtered backwards once more by both (the matched filter of any error of the readings), the power

    P(k) = |sum over i of u[i] exp(-j k n[i])|^2

is, for noise alone, exponentially distributed about a mean that changes with k little by little: the
larger of those below and above it, each a median over ln 2. The speed may be any, and change; where it
does not, a tone in time is one over the position as well, and whitening takes much of it for the colour
of the noise. So what is left over is asked as it is, too (u filtered by the observer alone). A linear
fit in that noise finds next to nothing of such an error, either. So each period is tried with the sizes,
too, that explain most of what is left over as it is, each channel over its RMS value.

Limits: at least `LEAST_PERIOD` counts, below which what is rounded off comes back; at least
`LEAST_PERIODS` on the way, below which a change of the machine over the position is no period; at least
`LEAST_SAMPLES` of each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import bilinear, lfilter
from scipy.stats import gamma

from waferbot_twin.diagnosis.proposals.periodogram import tuned_to
from waferbot_twin.estimation.gauss_newton import moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, in_quick_steps, signature
from waferbot_twin.estimation.stacked_least_squares import by_channel
from waferbot_twin.logs.machine import POSITION_ENCODER
from waferbot_twin.residuals.plant_block import OBSERVER_DAMPING, PlantBlock
from waferbot_twin.residuals.problem import PLANT, Cause, Problem
from waferbot_twin.residuals.record import Array

LEAST_PERIOD = 8.0
"""Counts."""

LEAST_PERIODS = 8.0

LEAST_SAMPLES = 2.5
"""Samples of a period at the usual speed."""

STEPS = 8.0
"""Parts of the shortest period to which positions are rounded."""

FINER = 4
"""Values of k for each independent one, at least."""

AROUND = 41
"""Independent values of k, below one and above it, whose median is what is around it."""

WAYS = 2
"""In how many ways periods are looked for: white, and as it is."""

BESIDE = 20.0
"""Independent values of k by which two periods are apart."""

MOST_PERIODS = 2
"""How many of an axis are looked at: each that is tried costs three simulations for every log."""

CHANCE = 0.01
"""Probability at most that noise alone has one in the logs."""


def at_periods(problem: Problem, base: Hypothesis, rivals: Sequence[Cause]) -> list[Cause]:
    """
    Return every effect with a cycle of the encoder at each period of its axis that stands out.

    Without any of it, and with the sizes that explain most of what is left over as it is.
    """
    having = {cause.name: cause for cause in rivals if cause.effect.cycle}
    found = []
    for cause in having.values():
        standing_out = periods(problem, base, POSITION_ENCODER[cause.axis])
        for tuned in tuned_to(problem, cause, cause.effect.cycle, standing_out):
            found += [tuned, _sized(problem, base, tuned)]
    return found


def _sized(problem: Problem, base: Hypothesis, cause: Cause) -> Cause:
    """Return a cause with the sizes of least squares in what is left over as it is, within bounds."""
    quick, begun = in_quick_steps(problem, base)
    change = signature(quick, begun, (*base.causes, cause), len(base.causes))[PLANT]
    left, noises = begun.residuals[PLANT], problem.noises(PLANT)
    scales = [max(float(np.std(r)), noise.floor) for r, noise in zip(left, noises, strict=True)]
    columns = by_channel(change, left)
    rows = np.vstack([part / scale for part, scale in zip(columns, scales, strict=True)])
    right = -np.concatenate([part / scale for part, scale in zip(left, scales, strict=True)])
    sizes = np.linalg.lstsq(rows, right, rcond=None)[0]
    (sized,) = moved((cause,), names_of(problem, (cause,)), sizes)
    return sized


def periods(problem: Problem, base: Hypothesis, name: str) -> list[float]:
    """Return the periods, counts, that stand out in what an encoder leaves over, the most first."""
    logs = list(_logs(problem, base, name))
    if not logs:
        return []
    travel = max(float(np.ptp(counts)) for counts, _ in logs)
    if travel < LEAST_PERIODS * LEAST_PERIOD:  # it stands, perhaps without any noise
        return []
    # Of an axis that stands most of the time the usual speed is nothing: at least that of all the time.
    fastest = max(
        max(
            float(np.percentile(np.abs(np.diff(counts)), 90.0)),
            float(np.ptp(counts)) / len(counts),
        )
        for counts, _ in logs
    )
    shortest = max(LEAST_PERIOD, LEAST_SAMPLES * fastest)
    step = shortest / STEPS
    points = 2 ** math.ceil(math.log2(FINER * max(travel / step, 1.0)))
    per_count = np.fft.rfftfreq(points, step)
    asked = (per_count > LEAST_PERIODS / travel) & (per_count < 1.0 / shortest)
    if not asked.any():
        return []
    power = np.max(
        [
            np.sum(
                [_power(counts, each[way], step, points, travel) for counts, each in logs], axis=0
            )
            for way in range(WAYS)
        ],
        axis=0,
    )
    by_chance = gamma(len(logs)).isf(CHANCE / (WAYS * np.count_nonzero(asked)))
    stands_out = asked & (power > by_chance)
    stands_out[1:-1] &= (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
    places = np.flatnonzero(stands_out)
    chosen: list[float] = []
    for here in per_count[places[np.argsort(-power[places])]]:
        apart = all(abs(here - other) > BESIDE / travel for other in chosen)  # no side lobes
        if apart and len(chosen) < MOST_PERIODS:
            chosen.append(float(here))
    return [1.0 / here for here in chosen]


def _logs(
    problem: Problem, base: Hypothesis, name: str
) -> Iterator[tuple[Array, tuple[Array, Array]]]:
    """Give of each log with a channel where it was, counts, and u there, of both ways."""
    place = 0
    for block in problem.plants:
        for channel in block.channels:
            if channel == name:
                fit, left = base.fits[PLANT], base.residuals[PLANT][place]
                own = fit.colours[place].error.own
                white = _backwards(own, _as_a_reading(block, name, fit.whitened[place]))
                as_it_is = _as_a_reading(block, name, left)[len(own) - 1 :]
                yield block.measured(name)[len(own) - 1 :], (white, as_it_is)
            place += 1


def _as_a_reading(block: PlantBlock, name: str, signal: Array) -> Array:
    """Return a signal filtered backwards by what the observer makes of a reading."""
    frequency = 2.0 * math.pi * block.observer_hz
    rate_hz = block.rates_hz[block.channels.index(name)]
    second_order = [1.0, 2.0 * OBSERVER_DAMPING * frequency, frequency**2]
    over, under = bilinear([1.0, 0.0, 0.0], second_order, rate_hz)
    return _backwards(over, signal, under)


def _backwards(over: Array, signal: Array, under: Array | float = 1.0) -> Array:
    return np.asarray(lfilter(over, under, signal[::-1])[::-1])


def _power(counts: Array, signal: Array, step: float, points: int, travel: float) -> Array:
    """Return P over what is around, for multiples of 1 / `points` periods in a step, counts."""
    where = np.rint((counts - counts.min()) / step).astype(int)
    power = np.abs(np.fft.rfft(np.bincount(where, signal, points))) ** 2
    width = round(AROUND * points * step / travel)
    median = median_filter(power, width, mode='reflect')
    # It is not level: slow errors are held by the observer. So the larger of those on both sides.
    below, above = (np.pad(median, beside, 'edge') for beside in ((width, 0), (0, width)))
    around = np.maximum(below, above)[width // 2 :][: len(power)] / math.log(2.0)
    return np.asarray(np.divide(power, around, out=np.zeros_like(power), where=around > 0.0))
