# SPDX-License-Identifier: Apache-2.0
"""
Where an amplifier gave less current than it was asked for: has it folded back?

It holds the commands of all three lines within its continuous current, I_c, once its integral (3.3) of
I^2 - I_c^2 is used up, (3.2). So the level is that at which the commands, cut off there, come nearest to
the currents as they were soon after they became short,

    i_k = c_k - (c_1 + c_2 + c_3) / 3,    c_k = min(max(I phasing_k, -I_c), I_c),

phasing_k the direction that the currents had just before; and the integral up to that moment is what the
drive allows. A fit cannot find both from afar: with a level 2 % off, at another moment, the model cuts
off what was not cut off, which is less likely than to cut off nothing. From what is read here it can.

Limits: an amplifier that only meets its peak current, a bus that sags or a voltage at its limit leave
currents short, too. Then what is read is one trial more, which explains nothing. A drive in
field-oriented mode, or with `limit_order` 0, cuts off the command itself: there the level read is up to
a quarter too low (all lines at +-I_c have an amplitude of 4/3 I_c), and the trials of the library are
all there is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from waferbot_copley.limiter import accumulate, i2t_setpoint
from waferbot_twin.effects import i2t_foldback, places
from waferbot_twin.effects.effect import Effect, Values
from waferbot_twin.effects.variant import Variant
from waferbot_twin.residuals.noise_free_motion import amplitude
from waferbot_twin.residuals.problem import Problem
from waferbot_twin.residuals.record import Array, Record

SHORT = 0.01
"""What a current lacks at least, as a share of the largest that was asked for."""

LEAST_TICKS = 6
"""How long it lacks that at least: the current loop follows a new command in three."""

SETTLED = 4
"""
Ticks after which a current has about come to where it is held: the level is then read within 2 % where
10 A were cut off (test_folded_back; four cases on X-Rotate).
"""


def folded_back(problem: Problem) -> list[Effect]:
    """Return the fold-back with what the logs show of it on each axis, where currents were short."""
    folds: dict[str, Values] = {}
    for axis in i2t_foldback.EFFECT.axes(problem.nominal):
        found = [_longest(problem.nominal, axis, record) for record in problem.records]
        ticks, fold = max(found, key=lambda item: item[0])
        if ticks:
            folds[axis] = fold
    return [i2t_foldback.with_folds(folds)] if folds else []


def _longest(variant: Variant, axis: str, record: Record) -> tuple[int, Values]:
    """Return how many ticks a log's longest fold-back has, and its values; 0 without one."""
    if record.terminals is None or record.command is None:
        return 0, {}
    place, timing = record.layout.place(axis), record.timing
    lines = record.terminals.current[:, 2 * place : 2 * place + 2]
    given = amplitude(*lines.T)
    asked = np.repeat(np.abs(record.command[:, place]), timing.servo_divider)[: len(given)]
    short = asked - given[: len(asked)] > SHORT * np.max(asked, initial=0.0)
    first, last = max(_runs(short), key=lambda run: run[1] - run[0], default=(0, 0))
    if last - first < LEAST_TICKS or first == 0:
        return 0, {}
    continuous, time = i2t_foldback.EFFECT.parameters(variant, axis)
    level = _level(lines[first - 1 : last], asked[first - 1 : last])
    if not continuous.low <= level < continuous.high:
        return 0, {}
    peak = min(i2t_foldback.PEAK_OVER_CONTINUOUS * level, places.peak_current(variant, axis))
    used = 0.0
    for current in given[:first]:
        used = accumulate(used, current * current, level, timing.tick_s)
    allowed_s = used / i2t_setpoint(peak, level, 1.0)
    if not time.low <= allowed_s <= time.high:
        return 0, {}
    return last - first, {continuous.name: level, time.name: allowed_s}


def _level(lines: Array, asked: Array) -> float:
    """
    Return where lines (ticks, 2) A are cut off that were asked for an amplitude (ticks,) A.

    The first tick is that before.
    """
    settled = slice(SETTLED, SETTLED + LEAST_TICKS)
    before, *now = ([one, two, -one - two] for one, two in (lines[0], *lines[settled]))
    phasing = np.array(before) / amplitude(*lines[0])
    wanted = asked[settled, None] * phasing

    def off(level: float) -> float:
        cut = np.clip(wanted, -level, level)
        return float(np.sum((cut - cut.mean(axis=1, keepdims=True) - now) ** 2))

    return float(minimize_scalar(off, bounds=(0.0, float(np.max(asked))), method='bounded').x)


def _runs(true: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and behind the last place of everything that is true without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
