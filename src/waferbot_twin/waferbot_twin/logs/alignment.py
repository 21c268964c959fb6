# SPDX-License-Identifier: Apache-2.0
"""
Times of the channels of a log against one another: a skew between drive and position, a wrong time base.

**Skew.** Whatever an axis is, its motion follows

    M q'' = k u - b q' - c sign(q') - g_1 sin q - g_2 cos q - g_0 - cogging(q) - drag(q, q'),

with position q and drive u, and that must hold at the same instant. (Drag is d_1 q' |q'| + (d_2 q +
d_3 q^2) q': what bends with speed or changes along the way. Cogging: sines and cosines once,
twice, three and six times per electrical cycle of the motor, where that is known.) If the drive stands
in the log later than the position by T, it holds for u(t + T), and T can be found without knowing M, k,
b, c or g. Noisy positions need not be differentiated for that: multiplied by a function p that vanishes
with its first derivative at both ends of a window, and integrated by parts, the equation becomes

    int q p'' = (k / M) int u p - (b / M) int (-q p') - (c / M) int sign(q') p - ...

one equation for each window, linear in all but T: linear least squares in the others, a search in T
alone. Since p is known at any time, T may be any fraction of a sample, and samples may be uneven. Here
p = 64 (x (1 - x))^3 over a window of 16 to 256 samples, that which gives T best. What the equation
lacks draws T in windows of one length otherwise than in those of another: so windows half or twice as
long must show T, too, and by how much theirs differ is an error of it.

At rest dry friction is any force up to c, so windows with much of it say nothing.

Limits: an axis whose drive hardly changes shows no skew; a controller that answers to noise of the
position within its own delay draws T towards that delay, less in long windows; what the equation lacks
(a resonance, play) shifts T as its own delay would.

**Time base.** If a log runs by another clock than its commands, position and commanded position are one
path, passed at different speeds: q(t) = r((t - t_0) s). Both are found by least squares.

Sources: M. Shinbrot, On the analysis of linear and nonlinear systems, Trans. ASME 79 (1957), modulating
functions; standard errors from sums over blocks of windows, since neighbours overlap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from waferbot_twin.logs.measured import Signal
from waferbot_twin.logs.timebase import median_step_s

Array = NDArray[np.float64]

WINDOWS = 64.0 * Polynomial([0.0, 1.0, -1.0]) ** 3
"""p over its window from 0 to 1, 1 in the middle."""

SAMPLES = (16, 32, 64, 128, 256)
"""Lengths of windows, in steps of the slower signal."""

MOST_WINDOWS = 1000
LEAST_WINDOWS = 24
BLOCKS = 12

STEPS_AT_REST, RESTS = 2.0, 0.25
"""Steps that an axis at rest moves in a quarter of a window; share of a window that it may rest."""

LONGEST_STEPS = 6.0
"""Skew that is looked for on either side, in steps of the slower signal."""

LEAST_ERROR_STEPS = 0.05
"""Standard error of a skew at least, in steps."""

COGGING = (1, 2, 3, 6)
"""How often per electrical cycle a motor may cog; those count of which half a period is passed."""

SIGNIFICANT = 4.0
"""Standard errors that a skew must be from zero to be believed."""

SAME_CLOCK = 0.01
"""Relative difference of clocks that is reported."""


@dataclass(frozen=True)
class Skew:
    """How much later than the position the drive stands in a log, s, with its standard error."""

    late_s: float
    standard_error_s: float

    @property
    def significant(self) -> bool:
        """Whether it is beyond doubt that there is one."""
        return abs(self.late_s) > SIGNIFICANT * self.standard_error_s

    def __str__(self) -> str:
        """Return the skew with twice its standard error, in ms: 0.50 ± 0.10 ms late."""
        size = f'{1e3 * abs(self.late_s):.2f} ± {2e3 * self.standard_error_s:.2f} ms'
        return f'{size} {"late" if self.late_s >= 0.0 else "early"}'


def skew(position: Signal, drive: Signal, cycle: float = math.inf) -> Skew | None:
    """
    Return the skew of a drive against a position, None if too little moves to tell.

    `cycle` is how far the axis goes, m or rad, in an electrical cycle of its motor.
    """
    step_s = max(median_step_s(signal.time_s) for signal in (position, drive))
    begin_s = max(position.time_s[0], drive.time_s[0]) + LONGEST_STEPS * step_s
    end_s = min(position.time_s[-1], drive.time_s[-1]) - LONGEST_STEPS * step_s
    found: list[Skew | None] = []
    for samples in SAMPLES:
        length_s = samples * step_s
        count = min(MOST_WINDOWS, int(2.0 * (end_s - begin_s) / length_s) - 1)
        if count < LEAST_WINDOWS:
            break
        starts = np.linspace(begin_s, end_s - length_s, count)
        clear = (
            _moving(position, starts, length_s)
            & _without_gaps(position, starts, length_s)
            & _without_gaps(
                drive, starts - LONGEST_STEPS * step_s, length_s + 2.0 * LONGEST_STEPS * step_s
            )
        )
        if clear.sum() >= LEAST_WINDOWS:
            found.append(
                _skew_in(position, drive, starts[clear], length_s, LONGEST_STEPS * step_s, cycle)
            )
    return _confirmed(found, LEAST_ERROR_STEPS * step_s)


def common_skew(pairs: Sequence[tuple[Signal, Signal]], cycle: float = math.inf) -> Skew | None:
    """
    Return the one skew of several logs of a machine, from pairs of position and drive, in s.

    A logger's channels are as late in one log as in the next, so all logs tell one number: the mean of
    theirs, weighted by the inverse of their variances. Where they scatter more than their errors say,
    the error is that of the scatter (R. T. Birge, Phys. Rev. 40, 1932). A log that shows none does not
    count; None if none does. Logs of different loggers, or with different kinds of drive, do not belong
    together.
    """
    found = [one for pair in pairs if (one := skew(*pair, cycle)) is not None]
    if not found:
        return None
    late_s = np.array([one.late_s for one in found])
    weight = np.array([one.standard_error_s**-2 for one in found])
    mean_s = float(weight @ late_s / weight.sum())
    error_s = float(weight.sum() ** -0.5)
    if len(found) > 1:
        scatter = float(weight @ (late_s - mean_s) ** 2) / (len(found) - 1.0)
        error_s *= max(1.0, math.sqrt(scatter))
    return Skew(mean_s, error_s)


def _confirmed(found: Sequence[Skew | None], least_error_s: float) -> Skew | None:
    """
    Return the best of the skews in windows of rising lengths, if those of the next length show it, too.

    None if they do not. Where a log is so short that it has windows of one length only, that one counts.
    """
    known = [(one.standard_error_s, place) for place, one in enumerate(found) if one is not None]
    _, place = min(known, default=(0.0, 0))
    best = found[place] if known else None
    if best is None:
        return None
    nearby = [found[other] for other in (place - 1, place + 1) if 0 <= other < len(found)]
    apart_s = [
        max(abs(one.late_s - best.late_s) - one.standard_error_s, 0.0)
        for one in nearby
        if one is not None
    ]
    if nearby and not apart_s:
        return None
    error_s = math.hypot(best.standard_error_s, min(apart_s, default=0.0), least_error_s)
    return Skew(best.late_s, error_s)


def _skew_in(
    position: Signal,
    drive: Signal,
    starts: Array,
    length_s: float,
    longest_s: float,
    cycle: float,
) -> Skew | None:
    """
    Return the skew as windows of one length that begin at `starts` show it.

    When friction turns is known to a sample only: what a sample earlier or later makes of the skew is an
    error of it.
    """
    shown = [
        _skew_beside(
            *_of_position(position, starts, length_s, cycle, turns),
            drive,
            starts,
            length_s,
            longest_s,
        )
        for turns in (0, -1, 1)
    ]
    best, *others = shown
    if best is None:
        return None
    apart_s = max(
        (abs(one.late_s - best.late_s) for one in others if one is not None), default=0.0
    )
    return Skew(best.late_s, math.hypot(best.standard_error_s, apart_s))


def _skew_beside(
    right: Array, others: Array, drive: Signal, starts: Array, length_s: float, longest_s: float
) -> Skew | None:
    """Return the skew that explains int q p'' best, beside the integrals that it does not touch."""
    basis, _ = np.linalg.qr(others)

    def beside_others(column: Array) -> Array:
        return column - basis @ (basis.T @ column)

    right = beside_others(right)

    def left_over(late_s: float) -> Array:
        column = beside_others(_of_drive(drive, starts + late_s, length_s))
        square = float(column @ column)
        gain = max(float(column @ right) / square, 0.0) if square > 0.0 else 0.0
        return right - gain * column

    tried = np.linspace(-longest_s, longest_s, 25)
    best = int(np.argmin([np.sum(left_over(late_s) ** 2) for late_s in tried]))
    if best in (0, len(tried) - 1):
        return None
    late_s = float(
        minimize_scalar(
            lambda value: float(np.sum(left_over(value) ** 2)),
            bounds=(tried[best - 1], tried[best + 1]),
            method='bounded',
            options={'xatol': 1e-4 * longest_s},
        ).x
    )
    rest = left_over(late_s)
    probe_s = 0.02 * longest_s
    slope = (left_over(late_s + probe_s) - left_over(late_s - probe_s)) / (2.0 * probe_s)
    square = float(slope @ slope)
    if square == 0.0 or np.sum(rest**2) > 0.5 * np.sum(right**2):
        return None  # the drive hardly explains the motion
    sums = [float(np.sum(part)) for part in np.array_split(slope * rest, BLOCKS)]
    error = np.sqrt(np.sum(np.square(sums)) * BLOCKS / (BLOCKS - 1.0)) / square
    return Skew(late_s, float(error))


def _of_position(
    position: Signal, starts: Array, length_s: float, cycle: float, turns: int
) -> tuple[Array, Array]:
    """
    Return int q p'' (windows,) and the integrals that the skew does not touch (windows, terms).

    Friction turns as many samples earlier as `turns`.
    """
    row, place, weight = _samples(position.time_s, starts, length_s)
    value = position.value[row]
    from_mean = weight * (value - np.mean(value, axis=1, keepdims=True))
    right = np.sum(from_mean * WINDOWS.deriv(2)(place), axis=1) / length_s**2
    damping = np.sum(from_mean * WINDOWS.deriv(1)(place), axis=1) / length_s
    window = weight * WINDOWS(place)
    smooth = _speed(position, row.shape[1])
    turned = smooth[np.clip(np.arange(len(smooth)) + turns, 0, len(smooth) - 1)]
    terms = [damping, np.sum(window * np.sign(turned)[row], axis=1), window.sum(axis=1)]
    # Drag that bends with speed, or changes along the way, would else be taken for a time.
    way = (position.value - np.mean(position.value)) / max(float(np.ptp(position.value)), 1e-300)
    for drag in (smooth * np.abs(smooth), smooth * way, smooth * way**2):
        terms.append(np.sum(window * drag[row], axis=1))
    if position.unit == 'rad':
        terms += [np.sum(window * np.sin(value), axis=1), np.sum(window * np.cos(value), axis=1)]
    for order in COGGING:
        if 2.0 * order * np.ptp(position.value) > cycle:
            angle = 2.0 * np.pi * order / cycle * value
            terms += [np.sum(window * wave(angle), axis=1) for wave in (np.sin, np.cos)]
    return right, np.column_stack(terms)


def _speed(position: Signal, samples: int) -> Array:
    """Return the speed (n,) as means over a quarter of a window of so many samples."""
    reach = max(1, int(samples / 4))
    speed = np.gradient(position.value, position.time_s)
    return np.asarray(np.convolve(speed, np.ones(reach) / reach, mode='same'))


def _moving(position: Signal, starts: Array, length_s: float) -> NDArray[np.bool_]:
    """Return which windows are not at rest for more than `RESTS` of their time."""
    row, _, _ = _samples(position.time_s, starts, length_s)
    way = 0.25 * length_s * np.abs(_speed(position, row.shape[1]))
    return np.asarray(np.mean(way[row] <= STEPS_AT_REST * position.resolution, axis=1) <= RESTS)


def _of_drive(drive: Signal, starts: Array, length_s: float) -> Array:
    """Return int u p of every window; a held drive stands until the next sample."""
    row, place, weight = _samples(drive.time_s, starts, length_s)
    if not drive.held:
        return np.asarray(np.sum(weight * drive.value[row] * WINDOWS(place), axis=1))
    after = drive.time_s[np.minimum(row + 1, len(drive.time_s) - 1)]
    until = np.clip((after - starts[:, None]) / length_s, 0.0, 1.0)
    area = WINDOWS.integ(1)
    share = area(until) - area(np.clip(place, 0.0, 1.0))
    return np.asarray(np.sum(drive.value[row] * share, axis=1) * length_s)


def _samples(
    time_s: Array, starts: Array, length_s: float
) -> tuple[NDArray[np.intp], Array, Array]:
    """
    Return rows of samples in each window, where in it they are (0 to 1) and their trapezoid weights.

    Arrays are (windows, samples); a window's rows begin one before it and may end behind it. Outside
    the weight is zero.
    """
    first = np.searchsorted(time_s, starts, side='right') - 1
    last = np.searchsorted(time_s, starts + length_s, side='left')
    row = first[:, None] + np.arange(int((last - first).max()) + 1)
    row = np.clip(row, 0, len(time_s) - 1)
    place = (time_s[row] - starts[:, None]) / length_s
    inside = (place >= 0.0) & (place <= 1.0)
    return row, place, np.where(inside, np.gradient(time_s)[row], 0.0)


def _without_gaps(signal: Signal, starts: Array, length_s: float) -> NDArray[np.bool_]:
    """Return which windows have no gap of a signal in them."""
    clear = np.ones(len(starts), np.bool_)
    for begin_s, end_s in signal.gaps():
        clear &= (starts + length_s < begin_s) | (starts > end_s)
    return clear


def clock_ratio(position: Signal, commanded: Signal) -> float | None:
    """
    Return s of q(t) = r((t - t_0) s): how much faster the position runs than its commands.

    None if the position does not follow the command at any ratio between 0.7 and 1.4 to within a
    tenth of its path, or not plainly better (half the error) than at 1, or if neither moves.
    """
    span = float(np.ptp(position.value))
    if span == 0.0 or float(np.ptp(commanded.value)) < 0.1 * span:
        return None
    middle_s = 0.5 * (position.time_s[0] + position.time_s[-1])

    def error(change: Array) -> Array:
        ratio, shift_s = change
        at_s = middle_s + (position.time_s - middle_s) * ratio - shift_s
        return np.asarray(np.interp(at_s, commanded.time_s, commanded.value) - position.value)

    ratios = np.linspace(0.7, 1.4, 29)
    duration_s = position.time_s[-1] - position.time_s[0]
    # The clocks may have been started together; then a ratio moves the middle.
    begins = [(r, middle_s - (position.time_s[0] + 0.5 * duration_s * r)) for r in ratios]
    best = min(begins, key=lambda begin: float(np.sum(error(np.array(begin)) ** 2)))
    fit = least_squares(error, best, x_scale=(0.01, 0.01 * duration_s))
    same = least_squares(lambda shift: error(np.array([1.0, shift[0]])), [0.0])
    left, with_same = (float(np.sqrt(np.mean(one.fun**2))) for one in (fit, same))
    if left > 0.1 * span or left > 0.5 * with_same:
        return None
    return float(fit.x[0])
