# SPDX-License-Identifier: Apache-2.0
"""
Errors of an encoder that come back along its way, whatever their period.

A reading that is off by a cos(k n) + b sin(k n) at n counts is in the innovation of the plant's observer
as s^2 / (s^2 + 2 z w s + w^2) and the whitening make it. With w[i] what is left over, white, and u the
same filtered backwards once more by both (the matched filter of any error of the readings), the power

    P(k) = |sum over i of u[i] exp(-j k n[i])|^2 / sum over i of |H(k v[i])|^2,                     (1)

with v the speed, and H what u was filtered by, is for noise alone exponentially distributed about a mean
that changes with k little by little: the larger of those below and above it, each a median over ln 2.
Without H it would rise by powers of ten within the first few k. The speed may be any, and change; where
it does not, a tone in time is one over the position as well, and whitening takes much of it for the
colour of the noise. So what is left over is asked as it is, too (u filtered by the observer alone). A
linear fit in that noise finds next to nothing of such an error, either. So each period is tried with the
sizes, too, that explain most of what is left over as it is, each channel over its RMS value.

Limits: at least `LEAST_PERIOD` counts, below which what is rounded off comes back; at least
`LEAST_PERIODS` on the way of a log, below which a change of the machine over the position is no period;
at least `LEAST_SAMPLES` of each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import bilinear, lfilter
from scipy.stats import gamma

from waferbot_twin.diagnosis.proposals.periodogram import tuned_to
from waferbot_twin.effects import places
from waferbot_twin.estimation.gauss_newton import moved, names_of
from waferbot_twin.estimation.hypothesis import Hypothesis, in_quick_steps, signature
from waferbot_twin.estimation.stacked_least_squares import by_channel
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

SPEEDS = 256
"""Parts of the speeds of a log for the sum over |H|^2 of equation (1); 64 is fine enough, 32 is not."""

ANGLES = np.geomspace(1e-6, math.pi, 2048)
"""Frequencies, rad per sample, at which a filter's response is tabulated."""

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
        encoder = places.position_encoder(problem.nominal, cause.axis)
        standing_out = _in_its_unit(problem, cause, periods(problem, base, encoder))
        for tuned in tuned_to(problem, cause, cause.effect.cycle, standing_out):
            found += [tuned, _sized(problem, base, tuned)]
    return found


def _in_its_unit(problem: Problem, cause: Cause, counts: Sequence[float]) -> list[float]:
    """Return periods in the unit in which an effect has its cycle."""
    nominal = problem.nominal
    units = {item.name: item.unit for item in cause.effect.parameters(nominal, cause.axis)}
    if units[cause.effect.cycle] == 'counts':
        return list(counts)
    encoder = nominal.description.encoders[places.position_encoder(nominal, cause.axis)]
    return [one / abs(encoder.counts_per_unit) for one in counts]


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
    every = list(_logs(problem, base, name))
    if not every:
        return []
    travel = max(log.travel for log in every)
    if travel < LEAST_PERIODS * LEAST_PERIOD:  # it stands, perhaps without any noise
        return []
    # Of an axis that stands most of the time the usual speed is nothing: at least that of all the time.
    fastest = max(
        max(float(np.percentile(log.speeds, 90.0)), log.travel / len(log.counts)) for log in every
    )
    shortest = max(LEAST_PERIOD, LEAST_SAMPLES * fastest)
    step = shortest / STEPS
    points = 2 ** math.ceil(math.log2(FINER * max(travel / step, 1.0)))
    per_count = np.asarray(np.fft.rfftfreq(points, step), np.float64)
    asked = (per_count > LEAST_PERIODS / travel) & (per_count < 1.0 / shortest)
    if not asked.any():
        return []
    logs = [log for log in every if log.travel > LEAST_PERIODS * shortest]
    shown = [per_count * log.travel > LEAST_PERIODS for log in logs]
    power = np.max(
        [
            np.sum(
                [
                    np.where(own, _power(log, way, step, per_count), 0.0)
                    for log, own in zip(logs, shown, strict=True)
                ],
                axis=0,
            )
            for way in range(WAYS)
        ],
        axis=0,
    )
    in_logs = np.maximum(np.sum(shown, axis=0), 1)
    by_chance = gamma(in_logs).isf(CHANCE / (WAYS * np.count_nonzero(asked)))
    stands_out = asked & (power > by_chance)
    stands_out[1:-1] &= (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
    places = np.flatnonzero(stands_out)
    chosen: list[float] = []
    for here in per_count[places[np.argsort(-power[places])]]:
        apart = all(abs(here - other) > BESIDE / travel for other in chosen)  # no side lobes
        if apart and len(chosen) < MOST_PERIODS:
            chosen.append(float(here))
    return [1.0 / here for here in chosen]


@dataclass(frozen=True)
class _Log:
    """
    A log's readings of an encoder (N,), counts, with u there, of both ways.

    `error` is the prediction-error filter of its noise, `over` and `under` are the observer's filter.
    """

    counts: Array
    signals: tuple[Array, Array]
    error: Array
    over: Array
    under: Array

    @property
    def travel(self) -> float:
        """How far the encoder goes, counts."""
        return float(np.ptp(self.counts))

    @property
    def speeds(self) -> Array:
        """The speed (N,), counts per sample."""
        return np.abs(np.gradient(self.counts))

    def response(self, way: int) -> Array:
        """Return |H|^2 of u at `ANGLES`: of noise of which `error` leaves 1."""
        later = np.exp(-1j * ANGLES)
        over, under, error = (
            np.abs(np.polyval(taps[::-1], later)) ** 2
            for taps in (self.over, self.under, self.error)
        )
        return np.asarray(over / under * (1.0 / error if way else error), np.float64)


def _logs(problem: Problem, base: Hypothesis, name: str) -> Iterator[_Log]:
    """Give every log with a channel."""
    place = 0
    for block in problem.plants:
        for channel in block.channels:
            if channel == name:
                fit, left = base.fits[PLANT], base.residuals[PLANT][place]
                own = fit.colours[place].error.own
                over, under = _observed(block, name)
                white = _backwards(own, _backwards(over, fit.whitened[place], under))
                as_it_is = _backwards(over, left, under)[len(own) - 1 :]
                counts = block.measured(name)[len(own) - 1 :]
                yield _Log(counts, (white, as_it_is), own, over, under)
            place += 1


def _observed(block: PlantBlock, name: str) -> tuple[Array, Array]:
    """Return the filter, numerator and denominator, that the observer makes of a reading."""
    frequency = 2.0 * math.pi * block.observer_hz
    rate_hz = block.rates_hz[block.channels.index(name)]
    second_order = [1.0, 2.0 * OBSERVER_DAMPING * frequency, frequency**2]
    over, under = bilinear([1.0, 0.0, 0.0], second_order, rate_hz)
    return np.asarray(over, np.float64), np.asarray(under, np.float64)


def _backwards(over: Array, signal: Array, under: Array | float = 1.0) -> Array:
    return np.asarray(lfilter(over, under, signal[::-1])[::-1])


def _power(log: _Log, way: int, step: float, per_count: Array) -> Array:
    """Return P over what is around at so many periods in a count, positions in steps of so many."""
    points = 2 * (len(per_count) - 1)
    where = np.rint((log.counts - log.counts.min()) / step).astype(int)
    power = np.abs(np.fft.rfft(np.bincount(where, log.signals[way], points))) ** 2
    noise, response = np.zeros(len(per_count)), log.response(way)
    times, ends = np.histogram(log.speeds, SPEEDS)
    for count, speed in zip(times, 0.5 * (ends[:-1] + ends[1:]), strict=True):
        noise += count * np.interp(2.0 * math.pi * speed * per_count, ANGLES, response)
    power = np.divide(power, noise, out=np.zeros_like(power), where=noise > 0.0)
    width = min(round(AROUND * points * step / log.travel), len(power))
    median = median_filter(power, width, mode='reflect')
    # It is not level: slow errors are held by the observer. So the larger of those on both sides.
    below, above = (np.pad(median, beside, 'edge') for beside in ((width, 0), (0, width)))
    around = np.maximum(below, above)[width // 2 :][: len(power)] / math.log(2.0)
    return np.asarray(np.divide(power, around, out=np.zeros_like(power), where=around > 0.0))
