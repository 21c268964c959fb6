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

Source: B. Anderson, J. Moore, Optimal Filtering, 1979, chapter 4. Assumption: small motion about the
pose where a log begins; gravity, dry friction and play are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from waferbot_plant import motors, statics
from waferbot_plant.modes import damping_matrix
from waferbot_plant.plant import Machine, mass_matrix
from waferbot_twin.residuals.record import Array

UNIT = 1e-6
"""A micrometre or microradian: positions in it, and speeds over w, make numbers of a like size."""


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
    are w_i, rad/s, `interval_s` the times between readings. None where nothing gives, encoders
    have different intervals, or no stationary filter exists.
    """
    p = parameters[0]
    used = [
        place for place in range(len(together)) if together[place].any() and behind[place, 1] < 0
    ]
    paired = set(behind[:, 1].tolist())
    intervals = {float(interval_s[place]) for place in used}
    basis = _freedoms(together, paired, standing, used)
    if len(intervals) != 1 or basis.shape[1] <= len(used):
        return None
    size = together.shape[1]
    mass = np.zeros((size, size))
    mass_matrix(state, parameters, mass)
    m, d, k = (
        basis.T @ matrix @ basis
        for matrix in (mass, damping_matrix(machine), statics.elastic_stiffness(machine))
    )
    inverse = np.linalg.inv(m)
    count = len(m)
    speed = float(np.max(frequency[used]))
    patterns = np.linalg.lstsq(basis, together[used].T, rcond=None)[0]
    pushed = np.column_stack([_pushed(p, basis, together[place]) for place in used])
    driven = np.any(pushed != 0.0, axis=0)
    acting = pushed[:, driven]
    shares = np.linalg.solve(patterns[:, driven].T @ acting, patterns[:, driven].T @ m @ patterns)
    by_motors = np.where(driven, inverse @ acting @ shares, patterns)
    noise = np.zeros((count, count))
    reads = np.zeros((len(used), 2 * count))
    for row, place in enumerate(used):
        per_unit = float(p['counts_per_unit'][place]) * UNIT
        reads[row, :count] = basis[int(p['encoder_coordinate'][place])] * per_unit
        intensity = (frequency[place] ** 2 / (per_unit * speed)) ** 2
        for direction in (patterns[:, row], by_motors[:, row]):
            noise += 0.5 * intensity * np.outer(direction, direction)
    zero, one = np.zeros((count, count)), np.eye(count)
    system = np.block([[zero, speed * one], [-inverse @ k / speed, -inverse @ d]])
    entering = np.block([[zero, zero], [zero, noise]])
    (step_s,) = intervals
    try:
        after, disturbed = _sampled(system, entering, step_s)
        variance = solve_discrete_are(after.T, reads.T, disturbed, np.eye(len(used)) / step_s)
        seen = reads @ variance @ reads.T + np.eye(len(used)) / step_s
        gain = np.linalg.solve(seen, reads @ variance)
    except (LinAlgError, ValueError):
        return None
    if not np.isfinite(gain).all():
        return None
    positions, speeds = np.zeros_like(together), np.zeros_like(together)
    for row, place in enumerate(used):
        per_error = float(p['counts_per_unit'][place]) * UNIT
        positions[place] = basis @ gain[row, :count] * per_error
        speeds[place] = basis @ gain[row, count:] * per_error * speed
    return positions, speeds


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


def _pushed(p: np.void, basis: Array, pattern: Array) -> Array:
    """Return the generalised force of the motor of an axis, (freedoms,), zero without one."""
    pushed = np.zeros(len(basis))
    for motor, ratio in enumerate(p['motor_ratio']):
        coordinate = int(p['motor_coordinate'][motor])
        if p['winding'][motor] != motors.NONE and pattern[coordinate] != 0.0:
            pushed[coordinate] += float(ratio)
    return np.asarray(basis.T @ pushed)


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
