# SPDX-License-Identifier: Apache-2.0
"""Reference motions: position, speed and acceleration at the ticks of a controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Reach:
    """What a motion may use: length (m, rad) either way from `start`, speed and acceleration."""

    start: float
    stroke: float
    speed: float
    acceleration: float


def trapezoid(distance: float, speed: float, acceleration: float, tick_s: float) -> Array:
    """
    Return a move (ticks, 3) from 0 to `distance`: constant acceleration, speed, deceleration.

    A short move is a triangle; times are whole ticks, so that it ends exactly at its distance.
    """
    length = abs(distance)
    peak = min(speed, np.sqrt(length * acceleration))
    rise = max(2, round(peak / acceleration / tick_s))
    flat = max(0, round((length / peak - peak / acceleration) / tick_s))
    peak = length / ((rise + flat) * tick_s)
    slope = peak / (rise * tick_s)
    time = np.arange(2 * rise + flat) * tick_s
    up, down = rise * tick_s, (rise + flat) * tick_s
    rates = np.where(time < up, slope, np.where(time < down, 0.0, -slope))
    speeds = np.minimum(np.minimum(slope * time, peak), peak - slope * (time - down))
    after = np.clip(time - down, 0.0, None)
    first, flat_time = np.minimum(time, up), np.clip(time - up, 0.0, down - up)
    positions = 0.5 * slope * first**2 + peak * flat_time + peak * after - 0.5 * slope * after**2
    return np.sign(distance) * np.column_stack([positions, speeds, rates])


def _moves(
    reach: Reach, random: np.random.Generator, ticks: int, tick_s: float, targets: Callable
) -> Array:
    found, at, length = [], 0.0, 0
    while length < ticks:
        target = targets(len(found) // 2)
        share = random.uniform(0.5, 1.0)
        move = trapezoid(target - at, share * reach.speed, share * reach.acceleration, tick_s)
        move[:, 0] += at
        at = target
        rest = np.zeros((round(random.uniform(0.05, 0.4) / tick_s), 3))
        rest[:, 0] = at
        found += [move, rest]
        length += len(move) + len(rest)
    return np.concatenate(found)[:ticks] + [reach.start, 0.0, 0.0]


def trapezoids(reach: Reach, random: np.random.Generator, ticks: int, tick_s: float) -> Array:
    """Return moves there and back over the whole stroke."""
    return _moves(
        reach,
        random,
        ticks,
        tick_s,
        lambda place: (0.5 if place % 2 == 0 else -0.5) * reach.stroke,
    )


def random_moves(reach: Reach, random: np.random.Generator, ticks: int, tick_s: float) -> Array:
    """Return moves to random places."""
    return _moves(
        reach, random, ticks, tick_s, lambda place: random.uniform(-0.5, 0.5) * reach.stroke
    )


def sines(reach: Reach, random: np.random.Generator, ticks: int, tick_s: float) -> Array:
    """Return a sum of two to four sines that begins gently."""
    count = int(random.integers(2, 5))
    hertz = np.exp(random.uniform(np.log(0.2), np.log(4.0), count))
    omega = 2.0 * np.pi * hertz
    share = random.uniform(0.5, 1.0, count) / count
    size = np.minimum.reduce(
        [
            np.full(count, 0.5 * reach.stroke),
            reach.speed / omega,
            reach.acceleration / omega**2,
        ]
    )
    time = (np.arange(ticks) * tick_s)[:, None]
    phase = random.uniform(0.0, 2.0 * np.pi, count)
    waves = np.stack(
        [
            share * size * omega**order * np.sin(omega * time + phase + order * np.pi / 2.0)
            for order in range(3)
        ]
    ).sum(axis=2)
    # A smooth step from 0 to 1 within half a second, and its derivatives by the product rule.
    ramp_s = 0.5
    x = np.clip(time[:, 0] / ramp_s, 0.0, 1.0)
    window = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    first = 30.0 * x**2 * (1.0 - x) ** 2 / ramp_s
    second = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp_s**2
    position = window * waves[0]
    speed = window * waves[1] + first * waves[0]
    acceleration = window * waves[2] + 2.0 * first * waves[1] + second * waves[0]
    return np.column_stack([reach.start + position, speed, acceleration])


def steps(reach: Reach, random: np.random.Generator, ticks: int, tick_s: float) -> Array:
    """Return small steps of the command, up and down, which the controller has to follow."""
    found = np.zeros((ticks, 3))
    at, place = 0.0, 0
    size = min(0.02 * reach.stroke, reach.acceleration / (2.0 * np.pi * 10.0) ** 2)
    while place < ticks:
        rest = round(random.uniform(0.15, 0.5) / tick_s)
        found[place : place + rest, 0] = at
        place += rest
        at = 0.0 if at != 0.0 else random.choice([-1.0, 1.0]) * random.uniform(0.4, 1.0) * size
    return found + [reach.start, 0.0, 0.0]


MOTIONS = {
    'trapezoids': trapezoids,
    'random moves': random_moves,
    'sines': sines,
    'steps': steps,
}
"""Every kind of motion: a function of reach, generator, ticks and their length (s)."""
