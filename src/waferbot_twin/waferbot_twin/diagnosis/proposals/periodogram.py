# SPDX-License-Identifier: Apache-2.0
"""
Forces that come back at one frequency: a floor that shakes.

In a log of T seconds such a force shows within 1 / T of its frequency and nowhere else; no way leads
there from another one. But once what the plant leaves over is white, its periodogram

    P(f) = |sum over n of w[n] exp(-2 pi i f n / rate)|^2 / N

says for every frequency what a force there promises: 2 P in 2 ln L, and for noise alone P has an
exponential distribution with mean 1. So an effect with a frequency is tried at those that stand out, all
logs together (with them the distribution of the sum is a gamma distribution).

A strong tone is predictable: whitening takes it for the colour of the noise, the more the stronger it
is. So it is looked for in what is left over as it is, too, whose periodogram is divided by its running
median (that of an exponential distribution with mean 1 is ln 2). There noise that wanders slowly stands
out of the median near zero frequency: what has not `LEAST_PERIODS` in the longest log is no tone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.stats import gamma

from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.residuals.problem import PLANT, Cause, Problem
from waferbot_twin.residuals.record import Array

MOST_TONES = 3
"""How many frequencies are tried: each costs a simulation for every parameter and log."""

FINER = 4
"""Frequencies of a periodogram for each independent one, at least."""

AROUND = 41
"""Independent frequencies whose median is what is around one."""

LEAST_PERIODS = 5.0
"""Of a tone in what is not white; noise that wanders at 1 to 10 Hz had some with up to 3.8."""

WAYS = 2
"""In how many ways tones are looked for."""

CHANCE = 0.01
"""Probability at most that white noise alone has a tone: the sum of those of all frequencies."""


def at_tones(problem: Problem, base: Hypothesis, rivals: Sequence[Cause]) -> list[Cause]:
    """Return every effect that has a frequency at each one that stands out."""
    having = {cause.name: cause for cause in rivals if cause.effect.tone}
    frequencies_hz = tones(problem, base) if having else []
    return [
        tuned
        for cause in having.values()
        for tuned in tuned_to(problem, cause, cause.effect.tone, frequencies_hz)
    ]


def tuned_to(
    problem: Problem, cause: Cause, name: str, values: Iterable[float]
) -> Iterator[Cause]:
    """Give a cause with a parameter at each of some values that are possible, free and narrow there."""
    (item,) = (
        item for item in cause.effect.parameters(problem.nominal, cause.axis) if item.name == name
    )
    held = tuple(other for other in cause.held if other != name)
    for value in values:
        if item.low < value < item.high:
            yield replace(cause.with_values({name: value}), held=held, narrow=(name,))


@dataclass(frozen=True, order=True)
class Tone:
    """A frequency that stands out in a channel, and how probable it is that noise alone has one."""

    chance: float
    frequency_hz: float
    channel: str


def tones(problem: Problem, base: Hypothesis) -> list[float]:
    """Return the frequencies, Hz, that stand out most in what the plant leaves over."""
    chosen: list[float] = []
    for tone in _all_tones(problem, base):
        apart = all(abs(tone.frequency_hz - other) > _width_hz(problem, base) for other in chosen)
        if apart and len(chosen) < MOST_TONES:
            chosen.append(tone.frequency_hz)
    return chosen


def _all_tones(problem: Problem, base: Hypothesis) -> list[Tone]:
    """Return every tone in what the plant leaves over, the least probable first."""
    if not problem.channel_names(PLANT):
        return []
    as_it_is = _standing_out(problem, base.residuals[PLANT], _flat_periodogram)
    least_hz = 0.5 * LEAST_PERIODS * _width_hz(problem, base)
    return sorted(
        [
            *_standing_out(problem, base.fits[PLANT].whitened, _periodogram),
            *(tone for tone in as_it_is if tone.frequency_hz >= least_hz),
        ]
    )


def _width_hz(problem: Problem, base: Hypothesis) -> float:
    """Return how near two frequencies are one in the longest log."""
    return 2.0 * max(problem.plant_rates_hz) / max(len(one) for one in base.residuals[PLANT])


def _standing_out(
    problem: Problem, left: Sequence[Array], periodogram: Callable[[Array, int], Array]
) -> Iterator[Tone]:
    """Give the peaks in what is left over, channel by channel."""
    channels = problem.channel_names(PLANT)
    rates_hz = problem.plant_rates_hz
    rate_hz = max(rates_hz)
    points = FINER * max(len(one) for one in left)
    frequency_hz = np.fft.rfftfreq(points, 1.0 / rate_hz)
    for name in dict.fromkeys(channels):
        own = [
            one
            for one, channel, rate in zip(left, channels, rates_hz, strict=True)
            if channel == name and abs(rate / rate_hz - 1.0) < 1e-6
        ]
        if not own:
            continue
        power = np.sum([periodogram(one, points) for one in own], axis=0)
        lines = WAYS * len(frequency_hz) * len(set(channels))
        chance = gamma(len(own)).sf(power) * lines
        peaks = 1 + np.flatnonzero(
            (power[1:-1] >= np.maximum(power[:-2], power[2:])) & (chance[1:-1] < CHANCE)
        )
        yield from (Tone(float(chance[peak]), float(frequency_hz[peak]), name) for peak in peaks)


def _periodogram(white: Array, points: int) -> Array:
    """Return the power of white noise with a variance of one, whose mean is one."""
    return np.asarray(np.abs(np.fft.rfft(white, points)) ** 2 / len(white))


def _flat_periodogram(left: Array, points: int) -> Array:
    """Return the power of coloured noise over that around it; a window keeps strong lines narrow."""
    window = np.hanning(len(left))
    power = np.abs(np.fft.rfft(window * (left - left.mean()), points)) ** 2
    around = median_filter(power, AROUND * FINER, mode='reflect') / math.log(2.0)
    return np.asarray(np.divide(power, around, out=np.zeros_like(power), where=around > 0.0))
