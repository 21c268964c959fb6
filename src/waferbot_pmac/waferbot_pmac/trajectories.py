# SPDX-License-Identifier: Apache-2.0
"""
Commanded positions, one per servo cycle: test signals and the moves of the Turbo PMAC.

Every function is pure and takes `times`, the instants of the servo cycles in seconds (float64,
shape (n,), rising, from `cycle_times`), and returns the commanded position at each, float64 (n,).
Positions are in any one unit - counts as the servo wants them, or metres, or radians - and
velocities and accelerations in that unit per second and per second squared.

Signals (thesis, Fig. 4.2): `constant`, `step`, `bidirectional_step`, `random`, `swept_sine`,
and `multisine`.

Moves (Turbo PMAC User Manual, "Linear Blended Moves" and "Rapid-Mode Moves"). A move along a
straight line is a piecewise constant velocity, smoothed by an acceleration of the total time TA
that rises for TS, stays for TA - 2 TS and falls for TS:

    peak acceleration = dV / (TA - TS)        jerk = dV / ((TA - TS) TS)

A LINEAR move over a distance d at the speed F has the velocity d / TM for TM = max(d / F, TA), and
lasts TM + TA. When TM = TA the velocity profile is a triangle. Consecutive LINEAR moves blend:
each change of velocity is spread over TA around the corner, so corners are rounded. TA is at least
2 TS. Limits (Ixx16, Ixx17, Ixx19) lengthen TM, or TA and TS in proportion so that the shape of the
profile stays; never the path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LIMIT_TOLERANCE = 1e-12
"""Relative accuracy to which the shortest acceleration time within the limits is found."""


def cycle_times(duration_s: float, servo_rate_hz: float) -> Floats:
    """Return the instants k / servo_rate_hz, in s, of the cycles in `duration_s`, from k = 0."""
    return np.arange(round(duration_s * servo_rate_hz)) / servo_rate_hz


def _from(times: Floats, start_s: float) -> NDArray[np.bool_]:
    """
    Tell which cycles are at or after `start_s`.

    A cycle counts as at `start_s` if it is a billionth of a second early, because neither 0.02 s
    nor 45 / 2250 s is a binary fraction.
    """
    return np.asarray(times >= start_s - 1e-9)


def constant(times: Floats, position: float = 0.0) -> Floats:
    """Return `position` at all times."""
    return np.full(times.shape, float(position))


def step(times: Floats, start_s: float, amplitude: float) -> Floats:
    """
    Jump from zero to `amplitude` in the first cycle at or after `start_s`.

    The commanded velocity is a pulse of one cycle, and with it the velocity feedforward; the
    acceleration is a pulse up and one down.
    """
    return np.where(_from(times, start_s), float(amplitude), 0.0)


def bidirectional_step(times: Floats, start_s: float, return_s: float, amplitude: float) -> Floats:
    """Jump to `amplitude` at `start_s` and back to zero at `return_s`, in s."""
    return step(times, start_s, amplitude) - step(times, return_s, amplitude)


def random(times: Floats, start_s: float, amplitude: float, hold_s: float, seed: int) -> Floats:
    """
    Jump every `hold_s` seconds to a random position, evenly distributed in +-`amplitude`.

    The numbers are the doubles of NumPy's PCG64 generator with that seed, so a seed is one signal
    for ever. The spectrum falls as (sin(x)/x)^2 with x = pi f hold_s; the first zero is at
    1 / hold_s. Each jump is a step with the velocity pulse described there.
    """
    late = times[_from(times, start_s)]
    signal = np.zeros(times.shape)
    if late.size:
        hold = np.floor((late - start_s) / hold_s + 1e-9).astype(np.int64)
        hold = np.maximum(hold, 0)
        draws = np.random.Generator(np.random.PCG64(seed)).random(int(hold[-1]) + 1)
        signal[times.size - late.size :] = amplitude * (2.0 * draws[hold] - 1.0)
    return signal


def swept_sine(
    times: Floats,
    start_s: float,
    end_s: float,
    amplitude: float,
    first_frequency_hz: float,
    last_frequency_hz: float,
    corner_frequency_hz: float = 0.0,
    fade_s: float = 0.0,
) -> Floats:
    """
    Sweep a sine logarithmically from the first to the last frequency, from `start_s` to `end_s`.

    With tau = t - start_s, T = end_s - start_s, r = ln(last / first), the phase is 2 pi first T /
    r (exp(r tau / T) - 1); every octave gets the same time. Above `corner_frequency_hz` (0:
    nowhere) the amplitude falls as 1 / (1 + (f / corner)^2), which keeps the commanded
    acceleration, and so the current, below amplitude (2 pi corner)^2. `fade_s` at each end is
    faded in and out by half a cosine. Both frequencies must be positive and different.
    """
    length = end_s - start_s
    rate = np.log(last_frequency_hz / first_frequency_hz)
    tau = times - start_s
    inside = (tau > 0.0) & (tau < length)
    progress = np.where(inside, tau / length, 0.0)
    growth = np.exp(rate * progress)
    frequency = first_frequency_hz * growth
    phase = 2.0 * np.pi * first_frequency_hz * length / rate * (growth - 1.0)
    envelope = amplitude * _fade(tau, length, fade_s)
    if corner_frequency_hz > 0.0:
        envelope = envelope / (1.0 + (frequency / corner_frequency_hz) ** 2)
    return np.where(inside, envelope * np.sin(phase), 0.0)


def multisine(
    times: Floats,
    start_s: float,
    amplitude: float,
    period_s: float,
    first_frequency_hz: float,
    last_frequency_hz: float,
    corner_frequency_hz: float = 0.0,
    fade_s: float = 0.0,
    seed: int | None = None,
) -> Floats:
    """
    Sum all harmonics of 1 / `period_s` from the first to the last frequency.

    They are equally strong, or fall as 1 / (1 + (f / corner)^2) with `corner_frequency_hz`, as
    those of `swept_sine` do. Periodic, so a frequency response from whole periods has no leakage.
    Phases after Schroeder, -pi k (k - 1) / K, which keep the crest factor low if all are equally
    strong, or random by `seed` (doubles of PCG64). The sum is scaled so that its largest value in
    one period is `amplitude`. It starts at `start_s` and is faded in over `fade_s`.
    """
    harmonics = harmonics_between(period_s, first_frequency_hz, last_frequency_hz)
    order = np.arange(1, harmonics.size + 1)
    if seed is None:
        phases = -np.pi * order * (order - 1) / harmonics.size
    else:
        phases = 2.0 * np.pi * np.random.Generator(np.random.PCG64(seed)).random(harmonics.size)

    strengths = np.ones(harmonics.size)
    if corner_frequency_hz > 0.0:
        strengths /= 1.0 + (harmonics / (period_s * corner_frequency_hz)) ** 2
    tau = times - start_s
    total = np.zeros(tau.shape)
    for harmonic, phase, strength in zip(harmonics, phases, strengths, strict=True):
        total += strength * np.sin(2.0 * np.pi * harmonic * tau / period_s + phase)
    total *= amplitude / _peak_of_sines(harmonics, phases, strengths)
    return np.where(_from(times, start_s), total * _fade(tau, np.inf, fade_s), 0.0)


def harmonics_between(
    period_s: float, first_frequency_hz: float, last_frequency_hz: float
) -> NDArray[np.int64]:
    """Return the numbers of the harmonics of 1 / `period_s` between two frequencies, inclusive."""
    first = int(np.ceil(first_frequency_hz * period_s - 1e-9))
    last = int(np.floor(last_frequency_hz * period_s + 1e-9))
    return np.arange(max(first, 1), last + 1)


def _peak_of_sines(harmonics: NDArray[np.int64], phases: Floats, strengths: Floats) -> float:
    """Return the largest absolute value of a sum of sines (16 points per fastest period)."""
    grid = 16 * int(harmonics[-1])
    spectrum = np.zeros(grid // 2 + 1, dtype=np.complex128)
    spectrum[harmonics] = -0.5j * strengths * np.exp(1j * phases) * grid
    return float(np.max(np.abs(np.fft.irfft(spectrum, grid))))


def _fade(tau: Floats, length: float, fade_s: float) -> Floats:
    """Return 0 to 1 over the first `fade_s` of `length`, and back over the last: half a cosine."""
    if fade_s <= 0.0:
        return np.ones(tau.shape)
    edge = np.clip(np.minimum(tau, length - tau) / fade_s, 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(np.pi * edge)


@dataclass(frozen=True)
class Acceleration:
    """Acceleration time TA and S-curve time TS in s, as the move is carried out."""

    total_s: float
    s_curve_s: float

    def stretched(self, total_s: float) -> Acceleration:
        """Return the same shape with the total time `total_s`."""
        return Acceleration(total_s, self.s_curve_s * (total_s / self.total_s))

    def peak(self, velocity_change: float) -> float:
        """Return the peak acceleration of a change of velocity."""
        return abs(velocity_change) / (self.total_s - self.s_curve_s)


def acceleration(total_s: float, s_curve_s: float) -> Acceleration:
    """
    Return TA and TS as the controller uses them: TA at least 2 TS.

    Raises `ValueError` if both are zero (the controller would divide by zero) or one is negative.
    """
    if total_s < 0.0 or s_curve_s < 0.0 or (total_s == 0.0 and s_curve_s == 0.0):
        raise ValueError('acceleration time and S-curve time must not be negative nor both zero')
    return Acceleration(max(total_s, 2.0 * s_curve_s), s_curve_s)


@dataclass(frozen=True)
class LinearPath:
    """
    A blended sequence of LINEAR moves of several motors, planned and ready to be evaluated.

    `positions` has shape (moves + 1, motors), the corners, the first being the start;
    `move_times_s` is TM of each move. The whole lasts sum(TM) + TA.
    """

    positions: Floats
    move_times_s: Floats
    acceleration: Acceleration

    @property
    def duration_s(self) -> float:
        """Time from start to standstill, s."""
        return float(np.sum(self.move_times_s)) + self.acceleration.total_s

    @property
    def velocities(self) -> Floats:
        """Velocity of each motor in each move between the accelerations, shape (moves, motors)."""
        return np.diff(self.positions, axis=0) / self.move_times_s[:, None]

    def at(self, times: Floats, start_s: float = 0.0) -> Floats:
        """
        Return the commanded positions, shape (len(times), motors), for a start at `start_s`.

        Exactly the first position before, and exactly the last one after the move.
        """
        standstill = np.zeros((1, self.positions.shape[1]))
        changes = np.diff(np.vstack([standstill, self.velocities, standstill]), axis=0)
        corners_s = start_s + np.concatenate([[0.0], np.cumsum(self.move_times_s)])
        result = np.tile(self.positions[0], (times.size, 1))
        for corner_s, change in zip(corners_s, changes, strict=True):
            result += _ramp(times - corner_s, self.acceleration)[:, None] * change
        result[_from(times, start_s + self.duration_s)] = self.positions[-1]
        return result


def _ramp(tau: Floats, acceleration: Acceleration) -> Floats:
    """
    Return the distance made by a unit change of velocity that begins at tau = 0.

    Third-order polynomials over TS, TA - 2 TS and TS, and tau - TA / 2 afterwards.
    """
    total, s = acceleration.total_s, acceleration.s_curve_s
    inside = np.clip(tau, 0.0, total)
    after = np.maximum(tau - total, 0.0)
    if s == 0.0:
        return inside**2 / (2.0 * total) + after
    steady_s = max(total - 2.0 * s, 0.0)
    rising = np.minimum(inside, s)
    steady = np.clip(inside - s, 0.0, steady_s)
    falling = np.clip(inside - (total - s), 0.0, s)
    peak = 1.0 / (total - s)
    speed_1 = peak * s / 2.0
    speed_2 = speed_1 + peak * steady_s
    distance = peak * rising**3 / (6.0 * s)
    distance += speed_1 * steady + peak * steady**2 / 2.0
    distance += speed_2 * falling + peak * (falling**2 / 2.0 - falling**3 / (6.0 * s))
    return distance + after


def linear(
    corners: Sequence[Sequence[float]],
    move_times_s: Sequence[float],
    requested: Acceleration,
    max_velocity: Sequence[float],
    max_acceleration: Sequence[float],
) -> LinearPath:
    """
    Plan LINEAR moves through `corners` (start first), without segmentation or lookahead.

    corners: (moves + 1, motors). move_times_s: the requested TM of each move, s; 0 asks for the
    fastest that the limits allow. max_velocity (Ixx16) and max_acceleration (Ixx17): per motor.

    TM is lengthened to TA and until no motor exceeds Ixx16; TA and TS are lengthened until no
    motor exceeds Ixx17, neither at a corner nor in the stop that the controller has to be able to
    make at the end of each move. One TA and TS, the longest that any corner needs, serves the
    whole sequence; the controller may choose them move by move.
    """
    positions = np.array(corners, dtype=np.float64)
    distances = np.abs(np.diff(positions, axis=0))
    limits = np.asarray(max_acceleration, dtype=np.float64)
    fastest_s = np.max(distances / np.asarray(max_velocity, dtype=np.float64), axis=1)
    shortest_s = np.maximum(np.asarray(move_times_s, dtype=np.float64), fastest_s)

    def planned(total_s: float) -> LinearPath:
        return LinearPath(positions, np.maximum(shortest_s, total_s), requested.stretched(total_s))

    def excess(path: LinearPath) -> float:
        stops = np.abs(path.velocities)
        corners = np.abs(np.diff(path.velocities, axis=0))
        return path.acceleration.peak(float(np.max(np.vstack([stops, corners]) / limits)))

    return _shortest_within_limit(planned, excess, requested.total_s)


def _shortest_within_limit(
    planned: Callable[[float], LinearPath], excess: Callable[[LinearPath], float], total_s: float
) -> LinearPath:
    """
    Return the plan with the shortest acceleration time from `total_s` on that keeps the limit.

    `planned(TA)` makes a plan, `excess(plan)` is its peak acceleration in units of the limit. The
    limit is met for all long enough TA; bisection keeps its upper end within the limit.
    """
    plan = planned(total_s)
    if excess(plan) <= 1.0:
        return plan
    low = high = total_s
    while excess(plan) > 1.0:
        low, high = high, 2.0 * high
        plan = planned(high)
    while high - low > LIMIT_TOLERANCE * high:
        middle = 0.5 * (low + high)
        if excess(planned(middle)) <= 1.0:
            high = middle
        else:
            low = middle
    return planned(high)


def jog(
    start: float,
    end: float,
    speed: float,
    requested: Acceleration,
    max_acceleration: float,
) -> LinearPath:
    """
    Plan a jog of one motor: speed Ixx22, acceleration time Ixx20, S-curve time Ixx21, limit Ixx19.

    The acceleration time is that for the full speed even if the move is too short to reach it; a
    short jog is then a triangle. (The manual computes it from speed and times alone and says no
    more about short jogs.) Velocity and acceleration in units of position per s and s^2. The
    controller's calculation time before a jog starts (Ixx92, 10 ms) is not included.
    """
    total_s = max(
        requested.total_s,
        requested.total_s * requested.peak(speed) / max_acceleration,
    )
    used = requested.stretched(total_s)
    move_time_s = max(abs(end - start) / speed, total_s)
    return LinearPath(np.array([[start], [end]]), np.array([move_time_s]), used)


def brought_to_rest(velocity: float, deceleration: float, cycle_s: float) -> Floats:
    """
    Return the way of a motor that is stopped, one position a cycle, from 0 at the first on.

    It decelerates evenly from `velocity` (per s) by `deceleration` (per s^2); the last position is where
    it stands, velocity^2 / (2 deceleration) away.
    """
    stop_s = abs(velocity) / deceleration
    times = np.minimum(np.arange(np.ceil(stop_s / cycle_s) + 1) * cycle_s, stop_s)
    way: Floats = velocity * times - 0.5 * np.sign(velocity) * deceleration * times**2
    return way


def rapid(
    start: Sequence[float],
    end: Sequence[float],
    speed: Sequence[float],
    requested: Sequence[Acceleration],
    max_acceleration: Sequence[float],
) -> list[LinearPath]:
    """
    Plan a RAPID move: a jog of every motor, arranged to take about the same time.

    Only the motor that needs longest goes at its speed (Ixx16); the others are slowed so that
    distance / speed is the same for all. Each keeps its own acceleration times, so the path is
    only roughly straight and the motors stop at slightly different times, as on the controller.
    Returns one path per motor. All arguments are per motor.
    """
    distances = [abs(b - a) for a, b in zip(start, end, strict=True)]
    longest_s = max(d / v for d, v in zip(distances, speed, strict=True))
    paths = []
    motors = zip(start, end, distances, requested, max_acceleration, strict=True)
    for a, b, distance, times, limit in motors:
        if distance == 0.0:
            paths.append(LinearPath(np.array([[a], [b]]), np.array([times.total_s]), times))
        else:
            paths.append(jog(a, b, distance / longest_s, times, limit))
    return paths
