# SPDX-License-Identifier: Apache-2.0
"""
The gains with which readings hold a plant that gives.

What noise of a motor's current does to a flexible plant is a ring that the model does not know of.
An observer that moves all parts of an axis together leaves that ring as it is, for as long as it
lasts, and the true model then seems wrong by it. So the linearised plant

    M x'' + D x' + K x = forces,        y = C x + noise of the readings                               (1)

is held by its stationary Kalman filter. Readings have noise of one unit of intensity in every encoder;
the disturbances of encoder i accelerate, half of their intensity each,

    all parts of its axis alike,     T e_i,
    what the motors push for that,   M^-1 B (T' B)^-1 (T' M T) e_i,                                (2)

with an intensity w_i^4, the columns of T being how the parts of an axis move together, those of B what
its motor pushes. Where nothing gives, both are the same, each axis has a filter of its own, and its
poles have the frequency w_i and the damping 1 / sqrt(2): the observer of a rigid axis (`plant_block`)
is this filter's limit.

Its variance is that of the Riccati recursion from nothing after 2^k readings (doubling). A solver that
orders the eigenvalues of the symplectic pencil (scipy's) fails at random where some lie next to the unit
circle, as those of modes that ring for long do. Of two models that differ by 1e-6 one then had this
filter and the other none, a jump by 650 to 2660 in ln L (the demonstration's logs).

Source: B. Anderson, J. Moore, Optimal Filtering, 1979, chapters 4 and 6.7; E. Chu, H. Fan, W. Lin, C.
Wang, Int. J. Control 77, 2004. Assumption: small motion about the pose where a log begins; gravity, dry
friction and play are left out.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, eigh, expm

from waferbot_lockstep.errors import UserError
from waferbot_plant import motors, statics
from waferbot_plant.modes import damping_matrix
from waferbot_plant.plant import Machine, mass_matrix
from waferbot_twin.residuals.record import Array

MOST_DOUBLINGS, ROUNDING = 40, 1e-13


def kalman_gains(
    machine: Machine,
    state: NDArray[np.void],
    parameters: NDArray[np.void],
    together: Array,
    behind: NDArray[np.intp],
    standing: NDArray[np.bool_],
    frequency: Array,
    interval_s: Array,
) -> tuple[Array, Array] | None:
    """
    Return by how much a position and a speed change per unit of error of an encoder.

    Both (encoders, coordinates), 1 and 1/s. `together` (encoders, coordinates) says how far each
    coordinate goes with an encoder's if nothing gives, zeros for one that holds no axis; `behind`
    (encoders, 2) which encoder another one of its axis is behind, in the second column, or -1: such
    axes are moved as if nothing gave. Coordinates of `standing` (coordinates,) do not move. `frequency`
    are w_i, rad/s, `interval_s` the times between readings. None where encoders have different
    intervals. Raises `UserError` where numbers are beyond all bounds.
    """
    p = parameters[0]
    used = [
        place for place in range(len(together)) if together[place].any() and behind[place, 1] < 0
    ]
    intervals = {float(interval_s[place]) for place in used}
    if len(intervals) != 1:
        return None
    (step_s,) = intervals
    basis = _freedoms(together, set(behind[:, 1].tolist()), standing, used)
    if basis.shape[1] == len(used):
        found = [_of_rigid(float(frequency[place]), step_s) for place in used]
        positions, speeds = np.zeros_like(together), np.zeros_like(together)
        for place, (position, speed) in zip(used, found, strict=True):
            positions[place], speeds[place] = position * together[place], speed * together[place]
        return positions, speeds
    shapes, stiffness, damping, mass = _modes(machine, state, parameters, basis, step_s)
    patterns = shapes.T @ mass @ together[used].T
    pushed = np.column_stack([_pushed(p, together[place]) for place in used])
    driven = np.any(pushed != 0.0, axis=0)
    acting = shapes.T @ pushed[:, driven]
    rigid_mass = together[used] @ mass @ together[used].T
    shares = np.linalg.solve((together[used] @ pushed[:, driven])[driven], rigid_mass[driven])
    by_motors = np.where(driven, acting @ shares, patterns)
    reads = np.zeros((len(used), len(stiffness)))
    noise = np.zeros((len(stiffness), len(stiffness)))
    for row, place in enumerate(used):
        per_unit = float(p['counts_per_unit'][place])
        reads[row] = shapes[int(p['encoder_coordinate'][place])] * per_unit
        intensity = (frequency[place] ** 2 / per_unit) ** 2
        for direction in (patterns[:, row], by_motors[:, row]):
            noise += 0.5 * intensity * np.outer(direction, direction)
    gains = _stationary(stiffness, damping, noise, reads, float(np.max(frequency[used])), step_s)
    positions, speeds = np.zeros_like(together), np.zeros_like(together)
    for row, place in enumerate(used):
        per_unit = float(p['counts_per_unit'][place])
        positions[place] = shapes @ gains[0][row] * per_unit
        speeds[place] = shapes @ gains[1][row] * per_unit
    return positions, speeds


@functools.lru_cache(maxsize=64)
def _of_rigid(frequency: float, step_s: float) -> tuple[float, float]:
    """Return the gains of an axis that does not give."""
    one = np.ones((1, 1))
    found = _stationary(np.zeros(1), 0.0 * one, frequency**4 * one, one, frequency, step_s)
    return float(found[0][0, 0]), float(found[1][0, 0])


def _modes(
    machine: Machine,
    state: NDArray[np.void],
    parameters: NDArray[np.void],
    basis: Array,
    step_s: float,
) -> tuple[Array, Array, Array, Array]:
    """
    Return shapes (coordinates, modes), their squared frequencies, damping, and the mass matrix.

    Modes of unit mass, up to the Nyquist frequency of the readings: no reading tells of others.
    """
    size = len(basis)
    mass = np.zeros((size, size))
    mass_matrix(state, parameters, mass)
    elastic = statics.elastic_stiffness(machine)
    squares, vectors = eigh(basis.T @ elastic @ basis, basis.T @ mass @ basis)
    shown = squares < (np.pi / step_s) ** 2
    shapes = basis @ vectors[:, shown]
    damping = shapes.T @ damping_matrix(machine) @ shapes
    return shapes, np.maximum(squares[shown], 0.0), damping, mass


def _stationary(
    stiffness: Array, damping: Array, noise: Array, reads: Array, speed: float, step_s: float
) -> tuple[Array, Array]:
    """
    Return the stationary gains (readings, modes) for positions and speeds.

    Speeds are counted in units of `speed`, and positions in the unit of a reading, so that the numbers
    are of a like size.
    """
    count, readings = len(stiffness), len(reads)
    unit = 1.0 / float(np.max(np.abs(reads)))
    zero, one = np.zeros((count, count)), np.eye(count)
    system = np.block([[zero, speed * one], [-np.diag(stiffness) / speed, -damping]])
    entering = np.block([[zero, zero], [zero, noise / (unit * speed) ** 2]])
    shown = np.hstack([unit * reads, np.zeros((readings, count))])
    seen_noise = np.eye(readings) / step_s
    try:
        with np.errstate(over='ignore', invalid='ignore'):  # told below
            after, disturbed = _sampled(system, entering, step_s)
            variance = _variance(after, disturbed, shown, seen_noise)
            seen = shown @ variance @ shown.T + seen_noise
            gain: Array = np.asarray(np.linalg.solve(seen, shown @ variance), np.float64)
    except (LinAlgError, ValueError) as error:
        raise UserError(f'the machine cannot be followed by an observer: {error}') from error
    if not np.isfinite(gain).all():
        raise UserError('the machine cannot be followed by an observer: its gains are not finite')
    return unit * gain[:, :count], unit * speed * gain[:, count:]


def _variance(after: Array, disturbed: Array, shown: Array, seen_noise: Array) -> Array:
    """
    Return the variance (n, n) of what is predicted from all readings before, by doubling.

    It stops where twice as many readings change it by less than rounding; 2^`MOST_DOUBLINGS` readings
    are more than any log has.
    """
    one = np.eye(len(after))
    transition, seen, variance = after.T, shown.T @ np.linalg.solve(seen_noise, shown), disturbed
    for _ in range(MOST_DOUBLINGS):
        inverse = np.linalg.inv(one + seen @ variance)
        more = transition.T @ variance @ inverse @ transition
        seen = seen + transition @ inverse @ seen @ transition.T
        transition = transition @ inverse @ transition
        variance = variance + 0.5 * (more + more.T)
        if np.abs(more).max() <= ROUNDING * np.abs(variance).max():
            break
    return np.asarray(variance)


def _freedoms(
    together: Array, paired: set[int], standing: NDArray[np.bool_], used: list[int]
) -> Array:
    """Return (coordinates, freedoms): what moves by itself; axes of paired encoders as one."""
    alone = ~standing
    columns = []
    for place in used:
        if place in paired:
            columns.append(together[place])
            alone &= together[place] == 0.0
    return np.column_stack([*columns, *np.eye(together.shape[1])[alone]])


def _pushed(p: np.void, pattern: Array) -> Array:
    """Return the generalised force of the motor of an axis, (coordinates,), zero without one."""
    pushed = np.zeros(len(pattern))
    for motor, ratio in enumerate(p['motor_ratio']):
        coordinate = int(p['motor_coordinate'][motor])
        if p['winding'][motor] != motors.NONE and pattern[coordinate] != 0.0:
            pushed[coordinate] += float(ratio)
    return pushed


def _sampled(system: Array, entering: Array, step_s: float) -> tuple[Array, Array]:
    """
    Return the transition and the noise of a system over a time.

    C. Van Loan, IEEE Trans. Automatic Control 23, 1978: both from one exponential.
    """
    count = len(system)
    whole = np.block([[-system, entering], [np.zeros_like(system), system.T]]) * step_s
    exponential = expm(whole)
    after = exponential[count:, count:].T
    noise = after @ exponential[:count, count:]
    return after, 0.5 * (noise + noise.T)
