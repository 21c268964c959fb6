# SPDX-License-Identifier: Apache-2.0
"""
Misfit: what a model lacks is no noise, and the same in all logs.

A force that nothing in a library explains is a function of the state of its axis, whichever log it is
seen in. So of what a model leaves over, e, white, that part counts as misfit which such functions span:
piecewise linear ones, of position beside speed, of speed (closer to one another near rest), and of
acceleration by direction (`StateFunctions`), as orthonormal columns Q (N, k) over all logs,

    phi = max(1, |Q' e|^2 / (k - t)),        t = |Q' U|^2,                                         (1)

t of the k what was fitted has taken, U its columns (`leverage`). White noise has phi = 1; misfit has as
much more as its power in each of these directions is: the variance of a Gaussian process over the state,
of low rank, found from the residual itself (empirical Bayes; for why it has to be there M. Kennedy, A.
O'Hagan, J. R. Stat. Soc. B 63, 2001). A change d of the model, of which the share
rho = |Q' d|^2 / |d|^2 lies among these directions, might as well be a part of the misfit: along d there
is the power

    lambda = 1 + rho (phi - 1),        known with nu = (k - t) (lambda / (lambda - 1))^2           (2)

degrees of freedom. So a cause has to gain more than what is left over in other directions of its kind
would by chance (`estimation.evidence`).

Limit: what goes with something else than the state of its own axis, with time or another axis, is noise
here; so is a ripple that is finer than the functions over position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from waferbot_twin.noise_model.gram import spanning
from waferbot_twin.noise_model.motion_basis import smooth
from waferbot_twin.noise_model.power import Power

Array = NDArray[np.float64]

POSITIONS = 8
"""Points over the way of an axis."""

SPEEDS = (-1.0, -0.5, -0.2, -0.08, -0.03, -0.01, 0.0, 0.01, 0.03, 0.08, 0.2, 0.5, 1.0)
SLOPES = (-1.0, -0.1, 0.0, 0.1, 1.0)
"""Points over its speed, alone and beside its position, as shares of the largest."""

ACCELERATIONS = (-1.0, -0.3, -0.1, -0.02, 0.0, 0.02, 0.1, 0.3, 1.0)
"""Points over its acceleration, likewise."""

FEWEST = 10
"""Samples for each function at least; with fewer, functions of every second point."""

MEANS_HZ = 250.0
"""Rate of the means of samples on which all this is done: a state changes more slowly."""


@dataclass(frozen=True)
class StateFunctions:
    """The functions of the state of one axis in some logs: its positions, and their rates in Hz."""

    positions: tuple[Array, ...]
    rates_hz: tuple[float, ...]

    @cached_property
    def columns(self) -> list[Array]:
        """Q of every log, (n, k): orthonormal over all logs together. k is 0 of an axis that stands."""
        states = [
            _state(_sums(position, every) / every, rate_hz / every)
            for position, rate_hz, every in zip(
                self.positions, self.rates_hz, self.every, strict=True
            )
        ]
        whole = np.concatenate(states)
        nothing = [np.zeros((len(one), 0)) for one in states]
        if not np.all(np.ptp(whole, axis=0) > 0.0):
            return nothing
        together = _functions(whole, 1)
        if len(together) < FEWEST * together.shape[1]:
            together = _functions(whole, 2)
        if len(together) < FEWEST * together.shape[1]:
            return nothing
        size = np.linalg.norm(together, axis=0)
        scaled = together / np.where(size > 0.0, size, 1.0)
        basis = scaled @ spanning(scaled.T @ scaled)
        return np.split(basis, np.cumsum([len(one) for one in states])[:-1])

    @property
    def every(self) -> list[int]:
        """How many samples a mean is of, log by log."""
        return [max(1, round(rate_hz / MEANS_HZ)) for rate_hz in self.rates_hz]


@dataclass(frozen=True)
class InLog:
    """The functions of a state in one of the logs that they were made for."""

    functions: StateFunctions
    place: int

    def along(self, white: Array) -> Array:
        """Return Q' of this log times a channel (n,) or (n, m), white; of its last samples if fewer."""
        means, own = self._aligned(white)
        return np.asarray(own.T @ means)

    def along_parts(self, white: Array, parts: int) -> tuple[Array, Array]:
        """Return what `along` is of each part of a channel (n,), and the squares of Q, (parts, k)."""
        pairs = [
            (few, rows)
            for few, rows in zip(
                *(np.array_split(one, parts) for one in self._aligned(white)), strict=True
            )
        ]
        return (
            np.array([rows.T @ few for few, rows in pairs]),
            np.array([np.sum(rows**2, axis=0) for _, rows in pairs]),
        )

    def _aligned(self, white: Array) -> tuple[Array, Array]:
        """Return means of a channel and the rows of Q at their times."""
        every = self.functions.every[self.place]
        means = _sums(white, every) / math.sqrt(every)
        own = self.functions.columns[self.place]
        return means, own[len(own) - len(means) :]

    @property
    def count(self) -> int:
        """How many functions there are: k."""
        return int(self.functions.columns[self.place].shape[1])


def _sums(samples: Array, every: int) -> Array:
    """Return the sums of every so many samples (n,) or (n, m), as many from the end as there are."""
    whole = len(samples) // every * every
    grouped = samples[len(samples) - whole :].reshape(-1, every, *samples.shape[1:])
    return np.asarray(grouped.sum(axis=1))


def _state(position: Array, rate_hz: float) -> Array:
    """Return position, speed and acceleration of an axis, (n, 3)."""
    if len(position) < FEWEST:
        return np.zeros((len(position), 3))
    middle = float(position.mean())
    way = smooth(position - middle)
    speed = np.gradient(way) * rate_hz
    return np.column_stack([way + middle, speed, np.gradient(speed) * rate_hz])


def _functions(state: Array, every: int) -> Array:
    """Return functions of states (n, 3) in all logs, of every so many points."""
    position, speed, acceleration = state.T
    way = np.linspace(position.min(), position.max(), POSITIONS // every)

    def hats(values: Array, shares: Sequence[float]) -> Array:
        return _hats(values, np.abs(values).max() * np.array(shares[::every]))

    over_way, slopes = _hats(position, way), hats(speed, SLOPES)
    harder = hats(acceleration, ACCELERATIONS)
    return np.column_stack(
        [
            (over_way[:, :, None] * slopes[:, None, :]).reshape(len(state), -1),
            hats(speed, SPEEDS),
            harder,
            harder * np.sign(speed)[:, None],
        ]
    )


def _hats(values: Array, points: Array) -> Array:
    """Return the piecewise linear functions that are 1 at one of some points and 0 at the others."""
    return np.column_stack([np.interp(values, points, row) for row in np.eye(len(points))])


def of_axes(states: Sequence[InLog | None]) -> list[tuple[list[int], list[InLog]]]:
    """Return the places of the channels of each axis that moves, and their functions, log by log."""
    found: dict[int, tuple[list[int], list[InLog]]] = {}
    for place, state in enumerate(states):
        if state is not None:
            places, logs = found.setdefault(id(state.functions), ([], []))
            places.append(place)
            logs.append(state)
    return list(found.values())


def power_along(
    left: Sequence[Array], changes: Sequence[Array], logs: Sequence[InLog], taken: float = 0.0
) -> Power:
    """
    Return the power of misfit in a direction, equation (2), in the channels of one axis, log by log.

    `left` and `changes` are e and d, white; `taken` is the t of equation (1).
    """
    square = sum(float(change @ change) for change in changes)
    if not logs[0].count or square == 0.0:
        return Power(1.0, math.inf)
    along = _along(changes, logs)
    power = 1.0 + _excess(left, logs, taken) * min(float(along @ along) / square, 1.0)
    if power == 1.0:
        return Power(1.0, math.inf)
    return Power(power, (logs[0].count - taken) * (power / (power - 1.0)) ** 2)


def covariance_of(
    systems: Sequence[Array], left: Sequence[Array], logs: Sequence[InLog], taken: float = 0.0
) -> Array:
    """
    Return what misfit adds to the covariance of products A' e, in the channels of one axis log by log:

        (phi - 1) (Q' A)' (Q' A)                                                                   (3)

    with the columns A (N, m) of what is fitted, white (`systems`); m by m.
    """
    along = _along(systems, logs)
    return np.asarray(_excess(left, logs, taken) * (along.T @ along))


def taken_by(columns: Sequence[Array]) -> float:
    """Return the t of equation (1) of the products Q' U (k, r) in the channels of one axis."""
    return float(np.sum(np.sum(columns, axis=0) ** 2))


def _excess(left: Sequence[Array], logs: Sequence[InLog], taken: float) -> float:
    """Return phi - 1 of what is left over."""
    count = logs[0].count - taken
    if count < 1.0:  # what is fitted could be all of it
        return 0.0
    misfit = _along(left, logs)
    return max(float(misfit @ misfit) / count - 1.0, 0.0)


def _along(channels: Sequence[Array], logs: Sequence[InLog]) -> Array:
    return np.sum([log.along(one) for log, one in zip(logs, channels, strict=True)], axis=0)
