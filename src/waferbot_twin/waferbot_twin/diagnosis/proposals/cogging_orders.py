# SPDX-License-Identifier: Apache-2.0
"""
Which orders a force over the position has: a line spectrum of the plant's residual, over position.

A force F that the model lacks is in the innovation of the plant's observer, for an axis of inertia M,
as F / (M (s^2 + 2 z w s + w^2)) (`plant_block`). So a line of cogging, cos(n phi) at the measured angle
phi, comes out as that filter makes it, whatever the speed does meanwhile; its frequency over time need
not be constant. Lines are taken one after another, each time that which explains most of what is left
(orthogonal matching pursuit), beside what friction and a constant force would leave. Then those of the
M orders are given up again, the weakest first, that do not pay for themselves,

    N ln(S_0 / S_1) < 2 ln N + 4 ln M,

S the sums of squares of N samples without and with a line, whitened by what all lines together leave.
(To whiten before the lines are known would take them out: they are what an autoregression predicts
best.) The amplitudes are fitted afterwards, through the simulation, as for every other effect.

Orders of a turn begin with two: a magnet that is another one meets each tooth of the stator, a tooth
that is another one each pole of the rotor, and neither has less than two. Once a turn is something else:
an imbalance, an eccentricity.

Where nobody described the poles of a motor, orders may be any that the travel and the samples can show:
of its gear as well as of its motor.

Limits: orders are whole numbers per turn (per electrical cycle of a linear motor, per m if that is not
known) and no closer than the travel can tell apart; a travel below an electrical cycle shows none, or
below a period of the order if its poles are not known; M is that of the axis alone. When
an axis moves so slowly that its current only holds against the cogging, a motor without any force
would explain the log as well: a wrong force constant is not allowed for here.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import bilinear, lfilter

from waferbot_twin.effects import places
from waferbot_twin.effects.cogging import NAME, period, with_orders
from waferbot_twin.effects.variant import Variant
from waferbot_twin.estimation.hypothesis import Hypothesis
from waferbot_twin.noise_model.prediction_error import autoregression
from waferbot_twin.residuals.plant_block import OBSERVER_DAMPING, PlantBlock
from waferbot_twin.residuals.problem import PLANT, Cause, Problem
from waferbot_twin.residuals.record import Array

ORDERS_PER_CYCLE = 16
"""Highest order that is looked for, per electrical cycle."""

SLOW = 0.5
"""Share of the way on which a line has two samples in a period at least."""

MOST_ORDERS = 250
MOST_LINES = 10


def orders_of(variant: Variant, blocks: Sequence[PlantBlock]) -> dict[str, tuple[int, ...]]:
    """Return the orders of each axis that the residuals of the logs show, axes without any left out."""
    residuals = [dict(zip(b.channels, b.residuals(variant), strict=True)) for b in blocks]
    every = {
        axis: _orders(variant, axis, blocks, residuals) for axis in places.motor_axes(variant)
    }
    return {axis: tuple(sorted(orders)) for axis, orders in every.items() if orders}


def at_orders(problem: Problem, base: Hypothesis, axes: Collection[str]) -> list[Cause]:
    """
    Return cogging with the orders that stand out in what a hypothesis leaves over, none of it yet.

    With the strongest line alone, with two, and so on: beside the others a weak one may be none. Of
    imported logs; the twin's own machine has the orders that the library tries.
    """
    blocks = measured_by_others(problem)
    left = iter(base.residuals[PLANT])
    own = {id(block): dict(zip(block.channels, left, strict=False)) for block in problem.plants}
    residuals = [own[id(block)] for block in blocks]
    nominal = problem.nominal
    found = []
    for axis in sorted(axes) if blocks else ():
        orders = _orders(nominal, axis, blocks, residuals)
        for count in range(1, len(orders) + 1):
            effect = with_orders({axis: tuple(sorted(orders[:count]))})
            none = {item.name: 0.0 for item in effect.parameters(nominal, axis)}
            found.append(Cause(effect, axis, none))
    return found


def log_prior_of_orders(variant: Variant, cause: Cause) -> float:
    """
    Return ln of the prior probability of the orders of a cause, 0 where the library says them.

    Any k of the M that are looked for on a machine are as probable as any other: 1 / (M over k).
    """
    if not has_orders(cause) or 'order' in cause.values:
        return 0.0
    count = len(cause.values) // 2
    every = max(math.floor(_highest(variant, cause.axis)), count)
    return -math.log(math.comb(every, count))


def has_orders(cause: Cause) -> bool:
    """Return whether a cause is a force with orders over the turns of a motor."""
    return cause.effect.name == NAME


def with_an_order_less(cause: Cause) -> list[Cause]:
    """
    Return a cause without each of its orders, the strongest first; none where it has not several.

    Nor where the library says which they are: harmonics of one order.
    """
    if not has_orders(cause) or 'order' in cause.values:
        return []
    names: dict[int, list[str]] = {}
    for name in cause.values:
        names.setdefault(int(name.rpartition('_')[2]), []).append(name)
    size = {order: math.hypot(*(cause.values[one] for one in own)) for order, own in names.items()}
    found = []
    for order in sorted(size, key=lambda one: -size[one]) if len(size) > 1 else ():
        rest = [one for one in names if one != order]
        values = {name: cause.values[name] for one in rest for name in names[one]}
        found.append(replace(cause, effect=with_orders({cause.axis: rest}), values=values))
    return found


def measured_by_others(problem: Problem) -> list[PlantBlock]:
    """Return the plants of imported logs."""
    return [block for block in problem.plants if block.record.current is not None]


def _orders(
    variant: Variant,
    axis: str,
    blocks: Sequence[PlantBlock],
    residuals: Sequence[Mapping[str, Array]],
) -> tuple[int, ...]:
    """Return the orders that residuals of an axis, by channel in each log, show; strongest first."""
    encoder = places.position_encoder(variant, axis)
    parts = [
        _Part(variant, axis, block, own[encoder])
        for block, own in zip(blocks, residuals, strict=True)
        if encoder in own
    ]
    return tuple(_lines(parts, _candidates(variant, axis, parts))) if parts else ()


class _Part:
    """One channel of one log: its residual, where the motor was, and what else may be in it."""

    def __init__(self, variant: Variant, axis: str, block: PlantBlock, residual: Array) -> None:
        encoder = places.position_encoder(variant, axis)
        per_unit = places.axis_counts(variant, axis)
        time_s = block.times_s(encoder)
        ratio = places.motor_ratio(variant, axis)
        self.residual = residual
        self.order = block.order
        self.turns = ratio * block.measured(encoder) / per_unit / period(variant, axis)
        self._taps = _force_to_innovation(block.observer_hz, time_s)
        speed = np.gradient(block.measured(encoder), time_s)
        smooth = np.convolve(speed, np.ones(9) / 9.0, mode='same')
        columns = [np.ones(len(time_s)), smooth, np.sign(smooth)]
        self.others = np.column_stack([self._seen(column) for column in columns])

    def _seen(self, force: Array) -> Array:
        """Return what a force leaves in the innovation, up to a factor."""
        return np.asarray(lfilter(*self._taps, force))

    def line(self, order: int) -> Array:
        """Return what cosine and sine of an order leave in the innovation (samples, 2)."""
        angle = 2.0 * math.pi * order * self.turns
        return np.column_stack([self._seen(np.cos(angle)), self._seen(np.sin(angle))])


def _force_to_innovation(observer_hz: float, time_s: Array) -> tuple[Array, Array]:
    """Return the discrete filter of w^2 / (s^2 + 2 z w s + w^2) at the rate of the samples."""
    frequency = 2.0 * math.pi * observer_hz
    rate_hz = 1.0 / float(np.median(np.diff(time_s)))
    return bilinear(
        [frequency**2], [1.0, 2.0 * OBSERVER_DAMPING * frequency, frequency**2], rate_hz
    )


def _candidates(variant: Variant, axis: str, parts: Sequence[_Part]) -> list[int]:
    """Return the orders that the travel of the logs can show."""
    travel = max(float(np.ptp(part.turns)) for part in parts)
    known = places.has_poles(variant, axis)
    if not travel > 0.0 or (known and travel * _cycles(variant, axis) < 1.0):
        return []
    step = max(1, round(0.6 / travel))
    # Two samples in a period at least where the axis is slow: there a line shows most.
    slow = min(_slow(part.turns) for part in parts)
    highest = min(_highest(variant, axis), MOST_ORDERS * step, 0.5 / max(slow, 1e-9))
    least = 1.0 if places.motor_rotary(variant, axis) else 0.0
    if not known:
        least = max(least, 1.0 / travel)
    return [order for order in range(step, int(highest) + 1, step) if order > least]


def _highest(variant: Variant, axis: str) -> float:
    """Return the highest order that is looked for: by the poles, where these are known."""
    if not places.has_poles(variant, axis):
        return float(MOST_ORDERS)
    return ORDERS_PER_CYCLE * _cycles(variant, axis)


def _cycles(variant: Variant, axis: str) -> float:
    """Return how many electrical cycles there are in what orders count from."""
    gain = abs(variant.description.motors[axis].electrical_gain)
    return gain * period(variant, axis) / (2.0 * math.pi)


def _slow(turns: Array) -> float:
    """Return the speed, turns per sample, below which `SLOW` of the way is made."""
    speeds = np.sort(np.abs(np.diff(turns)))
    way = np.cumsum(speeds)
    return float(speeds[np.searchsorted(way, SLOW * way[-1])])


def _lines(parts: Sequence[_Part], candidates: Sequence[int]) -> list[int]:
    """Return the orders that pay for themselves, the strongest first."""
    lines = _strongest(parts, candidates)
    while lines:
        worth = _worth(parts, lines)
        lines.sort(key=lambda order: -worth[order])
        samples = sum(len(part.residual) for part in parts)
        if worth[lines[-1]] > 2.0 * math.log(samples) + 4.0 * math.log(len(candidates)):
            break
        lines.pop()
    return lines


def _strongest(parts: Sequence[_Part], candidates: Sequence[int]) -> list[int]:
    """Return the orders that explain most of the residuals, strongest first."""
    scales = [float(np.std(part.residual)) or 1.0 for part in parts]

    def below(signals: Sequence[Array]) -> Array:
        return np.concatenate([one / scale for one, scale in zip(signals, scales, strict=True)])

    basis, _ = np.linalg.qr(_diagonal([part.others for part in parts]))
    right = _beside(basis, below([part.residual for part in parts]))
    waves = [below([part.line(order) for part in parts]) for order in candidates]
    waves = [_beside(basis, wave) for wave in waves]
    taken: list[int] = []
    while len(taken) < min(MOST_LINES, len(candidates)):
        gains = [_explained(wave, right) for wave in waves]
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            break
        taken.append(candidates[best])
        basis, _ = np.linalg.qr(waves[best])
        right = _beside(basis, right)
        waves = [_beside(basis, wave) for wave in waves]
        waves[best] = np.zeros_like(waves[best])
    return taken


def _explained(wave: Array, right: Array) -> float:
    """Return the square of what two columns explain of a signal; 0 if they are hardly there."""
    gram, along = wave.T @ wave, wave.T @ right
    if np.linalg.cond(gram) > 1e8 or gram[0, 0] < 1e-12 * len(right):
        return 0.0
    return float(along @ np.linalg.solve(gram, along))


def _worth(parts: Sequence[_Part], lines: Sequence[int]) -> dict[int, float]:
    """Return N ln(S_0 / S_1) of each line beside all others, whitened."""
    others, waves, residuals = [], [], []
    for part in parts:
        own = np.hstack([part.others, *(part.line(order) for order in lines)])
        value, *_ = np.linalg.lstsq(own, part.residual, rcond=1e-10)
        left = part.residual - own @ value
        taps = autoregression(left, part.order)
        white = lfilter(taps, 1.0, np.column_stack([part.residual, own, left]), axis=0)
        white = white[part.order :] / (float(np.std(white[part.order :, -1])) or 1.0)
        count = part.others.shape[1]
        residuals.append(white[:, 0])
        others.append(white[:, 1 : 1 + count])
        waves.append(white[:, 1 + count : -1])
    right = np.concatenate(residuals)
    matrix = np.hstack([np.concatenate(waves), _diagonal(others)])
    scale = np.sqrt(np.sum(matrix**2, axis=0))
    scale[scale == 0.0] = 1.0
    covariance = np.linalg.pinv((matrix / scale).T @ (matrix / scale), rcond=1e-12)
    value = covariance @ ((matrix / scale).T @ right)
    whole = float(np.sum((right - (matrix / scale) @ value) ** 2))
    worth = {}
    for place, order in enumerate(lines):
        pair = slice(2 * place, 2 * place + 2)
        more = float(value[pair] @ np.linalg.pinv(covariance[pair, pair]) @ value[pair])
        worth[order] = len(right) * math.log1p(more / whole)
    return worth


def _diagonal(blocks: Sequence[Array]) -> Array:
    """Return columns of several logs, each log with values of its own."""
    return np.asarray(block_diag(*blocks))


def _beside(basis: Array, signal: Array) -> Array:
    """Return what of a signal is not in a basis of orthonormal columns."""
    return signal - basis @ (basis.T @ signal)
