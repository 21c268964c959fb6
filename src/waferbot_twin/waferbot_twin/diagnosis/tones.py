# SPDX-License-Identifier: Apache-2.0
"""
Forces that come back at one frequency: a floor that shakes.

In a log of T seconds such a force shows within 1 / T of its frequency and nowhere else; no way leads
there from another one. But once what the plant leaves over is white, its periodogram

    P(f) = |sum over n of w[n] exp(-2 pi i f n / rate)|^2 / N

says for every frequency what a force there promises: 2 P in 2 ln L, and for noise alone P has an
exponential distribution with mean 1. So an effect with a frequency is tried at those that stand out, all
logs together (with them the distribution of the sum is a gamma distribution).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import gamma

from waferbot_twin.diagnosis.hypothesis import Hypothesis
from waferbot_twin.diagnosis.problem import PLANT, Cause, Problem

MOST_TONES = 3
"""How many frequencies are tried: each costs a simulation for every parameter and log."""

FINER = 4
"""Frequencies of a periodogram for each independent one, at least."""

CHANCE = 0.01
"""Probability at most that white noise alone has a tone: the sum of those of all frequencies."""


def at_tones(problem: Problem, base: Hypothesis, rivals: Sequence[Cause]) -> list[Cause]:
    """Return every effect that has a frequency at each one that stands out."""
    having = {cause.name: cause for cause in rivals if cause.effect.tone}
    found = []
    for frequency_hz in tones(problem, base) if having else []:
        for cause in having.values():
            name = cause.effect.tone
            (item,) = (
                item
                for item in cause.effect.parameters(problem.nominal, cause.axis)
                if item.name == name
            )
            if item.low < frequency_hz < item.high:
                there = cause.with_values({name: frequency_hz})
                found.append(replace(there, narrow=(name,)))
    return found


def tones(problem: Problem, base: Hypothesis) -> list[float]:
    """Return the frequencies, Hz, that stand out most in what the plant leaves over."""
    channels = problem.channel_names(PLANT)
    if not channels:
        return []
    rates_hz = problem.plant_rates_hz
    white = base.fits[PLANT].whitened
    rate_hz = max(rates_hz)
    longest = max(len(one) for one in white)
    points = FINER * longest
    frequency_hz = np.fft.rfftfreq(points, 1.0 / rate_hz)
    found: list[tuple[float, float]] = []
    for name in dict.fromkeys(channels):
        own = [
            one
            for one, channel, rate in zip(white, channels, rates_hz, strict=True)
            if channel == name and abs(rate / rate_hz - 1.0) < 1e-6
        ]
        if not own:
            continue
        powers = [np.abs(np.fft.rfft(one, points)) ** 2 / len(one) for one in own]
        power = np.sum(powers, axis=0)
        chance = gamma(len(own)).sf(power) * len(frequency_hz) * len(set(channels))
        peaks = 1 + np.flatnonzero(
            (power[1:-1] >= np.maximum(power[:-2], power[2:])) & (chance[1:-1] < CHANCE)
        )
        found += [(float(chance[peak]), float(frequency_hz[peak])) for peak in peaks]
    chosen: list[float] = []
    for _, one_hz in sorted(found):
        apart = all(abs(one_hz - other) > 2.0 * rate_hz / longest for other in chosen)
        if apart and len(chosen) < MOST_TONES:
            chosen.append(one_hz)
    return chosen
