# SPDX-License-Identifier: Apache-2.0
"""
Coordinates that are held: they stay in the model, but do not move.

A rigid connection takes its coordinate out of the model, and another model has to be compiled. A
held one leaves it in, so that one compiled machine serves for every choice of what gives. Two
kinds:

- a coordinate is **held**: z_i' = 0, by solving the step's equations with that entry given;
- two coordinates are **tied** by a held transmission with e = a z_l + b z_f: the follower f moves
  with its leader l as z_f' = g z_l', g = -a / b. With z = T y the equations A dz' = r become
  T' A T dy' = T' r, which adds g times the follower's row and column to the leader's and takes
  the follower out; its mass, motor, springs and friction thus act on the leader.

Both are exact but for rounding: no stiff spring, no correction. Held is what holds now: switched
on while a coordinate is away from home, it stays there; a coordinate that moves stops at once, and
that energy is lost without being booked. Limit: a held cable does not go slack, and no tension is
found for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from waferbot_lockstep.compiled import compiled


def parameter_fields(springs: int, cables: int, coordinates: int) -> list[tuple]:
    """
    Return the dtype fields: 1 where held, 0 where free; they may be changed at any time.

    `held` (n,) holds a coordinate; `spring_held` and `cable_held` hold what the element acts on:
    the coordinate that it is alone on, or the driven one to the driving one.
    """
    return [
        ('held', 'i8', (coordinates,)),
        ('spring_held', 'i8', (springs,)),
        ('cable_held', 'i8', (cables,)),
    ]


def state_fields(coordinates: int) -> list[tuple]:
    """Return the dtype fields of the workings: what holds now, followers and their leaders."""
    return [
        ('any_held', 'i8'),
        ('held_now', 'i8', (coordinates,)),
        ('leader', 'i8', (coordinates,)),
        ('leader_ratio', 'f8', (coordinates,)),
    ]


@compiled
def find_held(s, p):
    """
    Find from the parameters what is held now; `any_held` says whether there is anything.

    A coordinate without a leader leads itself. Leaders of leaders are followed to their first, so
    that no leader follows. What a held follower is tied to is held.
    """
    any_held = 0
    for row in range(len(p['held'])):
        any_held |= p['held'][row]
    for spring in range(len(p['spring_held'])):
        any_held |= p['spring_held'][spring]
    for cable in range(len(p['cable_held'])):
        any_held |= p['cable_held'][cable]
    s['any_held'] = any_held
    if any_held:
        _find_leaders(s, p)


@compiled
def _find_leaders(s, p):
    """Set leaders, their ratios, and what stands still."""
    size = len(s['leader'])
    for row in range(size):
        s['leader'][row] = row
        s['leader_ratio'][row] = 1.0
        s['held_now'][row] = p['held'][row]
    for spring in range(len(p['spring_held'])):
        if p['spring_held'][spring]:
            _tie(
                s, p['spring_first'][spring], p['spring_second'][spring],
                p['spring_first_ratio'][spring], p['spring_second_ratio'][spring],
            )  # fmt: skip
    for cable in range(len(p['cable_held'])):
        if p['cable_held'][cable]:
            _tie(
                s, p['cable_first'][cable], p['cable_second'][cable],
                p['cable_first_ratio'][cable], p['cable_second_ratio'][cable],
            )  # fmt: skip
    for row in range(size):
        while s['leader'][s['leader'][row]] != s['leader'][row]:
            above = s['leader'][row]
            s['leader_ratio'][row] *= s['leader_ratio'][above]
            s['leader'][row] = s['leader'][above]
    for row in range(size):
        if s['held_now'][row]:
            s['held_now'][s['leader'][row]] = 1
    for row in range(size):
        if s['leader'][row] != row:
            s['held_now'][row] = 0


@compiled
def _tie(s, first, second, a, b):
    """Let `second` follow `first`; an element on one coordinate alone holds that."""
    if b == 0.0:
        s['held_now'][first] = 1
    else:
        s['leader'][second] = first
        s['leader_ratio'][second] = -a / b


@compiled
def find_idle(s):
    """Note in `idle` what is held and stands still: it goes on standing, whatever acts on it."""
    for row in range(len(s['idle'])):
        stands = s['velocity'][row] == 0.0 and s['velocity_change'][row] == 0.0
        s['idle'][row] = 1 if s['any_held'] and s['held_now'][row] and stands else 0


@compiled
def impose(s, matrix, right, moving):
    """
    Put what is held into A dz' = r, in place (lower triangle); `solve` it, then `follow`.

    With `moving` 1 the unknown is a change of velocity that brings z' to what is held, with 0 it
    is an acceleration.
    """
    velocity = s['velocity']
    for row in range(len(right)):
        leader = s['leader'][row]
        if leader != row:
            ratio = s['leader_ratio'][row]
            offset = moving * (ratio * velocity[leader] - velocity[row])
            _fold(matrix, right, row, leader, ratio, offset)
    for row in range(len(right)):
        if s['held_now'][row] and not s['idle'][row]:
            lock(matrix, right, row, -moving * velocity[row])


@compiled
def _fold(matrix, right, follower, leader, ratio, offset):
    """Replace x_follower by ratio x_leader + offset in matrix x = right, symmetrically."""
    size = len(right)
    for row in range(size):
        right[row] -= matrix[max(row, follower), min(row, follower)] * offset
    right[leader] += ratio * right[follower]
    between = matrix[max(leader, follower), min(leader, follower)]
    matrix[leader, leader] += ratio * (2.0 * between + ratio * matrix[follower, follower])
    for row in range(size):
        if row not in (leader, follower):
            matrix[max(row, leader), min(row, leader)] += (
                ratio * matrix[max(row, follower), min(row, follower)]
            )
    for row in range(size):
        matrix[max(row, follower), min(row, follower)] = 0.0
    matrix[follower, follower] = 1.0
    right[follower] = 0.0


@compiled
def lock(matrix, right, locked, value):
    """Make `value` the solution's entry `locked`, exactly, and leave the equations symmetric."""
    for column in range(locked):
        right[column] -= matrix[locked, column] * value
        matrix[locked, column] = 0.0
    for row in range(locked + 1, len(right)):
        right[row] -= matrix[row, locked] * value
        matrix[row, locked] = 0.0
    matrix[locked, locked] = 1.0
    right[locked] = value


@compiled
def follow(s, solution, moving):
    """Give followers their part of a solution found with `impose`, in place (n,)."""
    velocity = s['velocity']
    for row in range(len(solution)):
        leader = s['leader'][row]
        if leader != row:
            ratio = s['leader_ratio'][row]
            solution[row] = ratio * solution[leader] + moving * (
                ratio * velocity[leader] - velocity[row]
            )


@compiled
def give_to_leaders(s, forces):
    """Move the generalised forces (n,) of followers to their leaders; held rows get zero."""
    for row in range(len(forces)):
        leader = s['leader'][row]
        if leader != row:
            forces[leader] += s['leader_ratio'][row] * forces[row]
            forces[row] = 0.0
    for row in range(len(forces)):
        if s['held_now'][row]:
            forces[row] = 0.0


def leaders(state: NDArray[np.void], parameters: NDArray[np.void]) -> NDArray[np.int64]:
    """Return for every coordinate (n,) the one that it follows: mostly itself."""
    s = state[0]
    find_held(s, parameters[0])
    return s['leader'].copy() if s['any_held'] else np.arange(len(s['leader']))


def free_motions(state: NDArray[np.void], parameters: NDArray[np.void]) -> NDArray[np.float64]:
    """Return T (n, m) of z' = T y', with a column for each coordinate that can move by itself."""
    s = state[0]
    size = len(s['position'])
    find_held(s, parameters[0])
    motions = np.eye(size)
    if not s['any_held']:
        return motions
    for row in range(size):
        motions[row, row] = 0.0
        motions[row, s['leader'][row]] = s['leader_ratio'][row]
    moving = [row for row in range(size) if s['leader'][row] == row and not s['held_now'][row]]
    return motions[:, moving]
