# SPDX-License-Identifier: Apache-2.0
"""
The mechanism: one mass, or a motor and a load with what is between them, integrated from event to event.

Positions q (m, rad) and forces (N, Nm) of the motor are those at the axis: the motor's angle over the
ratio of its gear, its torque times that, its inertia times the square.

    M1 q1'' = F - T - R1(q1') + C(q1)                                   motor
    M2 q2'' = T - R2(q2') + G(q2) + N(t)                                load
    C(q)  = sum of a_n cos(n q) + b_n sin(n q)                          cogging
    G(q)  = constant + cosine cos q + sine sin q                        from outside; imbalance
    R(v)  = viscous v + sign(v) (coulomb + breakaway exp(-(v / v_s)^2)) coulomb by direction
    T     = k p + d e', with e = q1 - q2 and p = e - gap/2 beyond a flank; 0 between flanks and where it
            would pull: flanks push only. Without a gap T = k e + d e'.

Without elasticity q1 = q2 and everything acts on M1 + M2.

At rest dry friction holds what is within its limits, and the mass stands exactly. So motion is smooth
between events: a speed comes to zero, a force breaks away, a flank is touched or left. Each smooth piece
is integrated by the classical Runge-Kutta method (order 4); a step in which the set of what sticks and
touches would change is divided at that event, found by bisection to 2^-40 of the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

STUCK, FREE = 0, 2
"""Dry friction of a mass: holds; +1, -1 while it slides; there is none."""

APART, SPRING = 0, 2
"""Transmission: between the flanks; +1, -1 on one of them; no gap at all."""

BISECTIONS = 40
MOST_EVENTS = 60
"""Events within one step beyond which it is taken as it is, and counted (`MotionEnd.forced`)."""


class Physics(NamedTuple):
    """Parameters of the mechanism, all at the axis; units are N, kg, m or Nm, kg m2, rad, and s."""

    motor_mass: float
    load_mass: float
    elastic: bool
    stiffness: float
    damping: float
    gap: float
    coulomb_forward: float
    coulomb_backward: float
    breakaway: float
    stribeck_speed: float
    viscous: float
    motor_coulomb: float
    motor_viscous: float
    constant_force: float
    gravity_cosine: float
    gravity_sine: float
    cogging: np.ndarray
    """(n, 3): wave number 1/m or 1/rad, cosine, sine."""


@numba.njit(cache=True)
def dry_friction(physics, sliding, speed):
    """Return the dry friction against the load's sliding direction, both masses' if they are one."""
    if sliding in (FREE, STUCK):
        return 0.0
    level = physics.coulomb_forward if sliding > 0 else physics.coulomb_backward
    if physics.breakaway > 0.0:
        level += physics.breakaway * math.exp(-((speed / physics.stribeck_speed) ** 2))
    if not physics.elastic:
        level += physics.motor_coulomb
    return sliding * level


@numba.njit(cache=True)
def transmitted(physics, contact, deflection, rate):
    """Return the force from motor to load."""
    if contact == APART:
        return 0.0
    penetration = deflection
    if contact != SPRING:
        penetration -= contact * 0.5 * physics.gap
    return physics.stiffness * penetration + physics.damping * rate


@numba.njit(cache=True)
def applied_forces(physics, drive, noise, contact, q1, v1, q2, v2):
    """Return the forces on motor and load without dry friction; all on the load if they are one."""
    motor = drive - physics.motor_viscous * v1
    for row in range(physics.cogging.shape[0]):
        phase = physics.cogging[row, 0] * q1
        motor += physics.cogging[row, 1] * math.cos(phase)
        motor += physics.cogging[row, 2] * math.sin(phase)
    load = noise + physics.constant_force - physics.viscous * v2
    if physics.gravity_cosine != 0.0 or physics.gravity_sine != 0.0:
        load += physics.gravity_cosine * math.cos(q2) + physics.gravity_sine * math.sin(q2)
    if not physics.elastic:
        return 0.0, motor + load
    force = transmitted(physics, contact, q1 - q2, v1 - v2)
    return motor - force, load + force


@numba.njit(cache=True)
def accelerations(physics, drive, noise, slide1, slide2, contact, q1, v1, q2, v2):
    """Return the accelerations of both masses in a mode."""
    motor, load = applied_forces(physics, drive, noise, contact, q1, v1, q2, v2)
    if not physics.elastic:
        if slide2 == STUCK:
            return 0.0, 0.0
        both = (load - dry_friction(physics, slide2, v2)) / (
            physics.motor_mass + physics.load_mass
        )
        return both, both
    first = second = 0.0
    if slide1 != STUCK:
        against = 0.0 if slide1 == FREE else slide1 * physics.motor_coulomb
        first = (motor - against) / physics.motor_mass
    if slide2 != STUCK:
        second = (load - dry_friction(physics, slide2, v2)) / physics.load_mass
    return first, second


@numba.njit(cache=True)
def smooth_step(physics, step, drives, noise, slide1, slide2, contact, q1, v1, q2, v2):
    """Return the state after one Runge-Kutta step in a mode; drive forces at its start, middle, end."""
    a1, a2 = accelerations(physics, drives[0], noise, slide1, slide2, contact, q1, v1, q2, v2)
    half = 0.5 * step
    p1, w1, p2, w2 = q1 + half * v1, v1 + half * a1, q2 + half * v2, v2 + half * a2
    b1, b2 = accelerations(physics, drives[1], noise, slide1, slide2, contact, p1, w1, p2, w2)
    r1, x1, r2, x2 = q1 + half * w1, v1 + half * b1, q2 + half * w2, v2 + half * b2
    c1, c2 = accelerations(physics, drives[1], noise, slide1, slide2, contact, r1, x1, r2, x2)
    s1, y1, s2, y2 = q1 + step * x1, v1 + step * c1, q2 + step * x2, v2 + step * c2
    d1, d2 = accelerations(physics, drives[2], noise, slide1, slide2, contact, s1, y1, s2, y2)
    sixth = step / 6.0
    return (
        q1 + sixth * (v1 + 2.0 * w1 + 2.0 * x1 + y1),
        v1 + sixth * (a1 + 2.0 * b1 + 2.0 * c1 + d1),
        q2 + sixth * (v2 + 2.0 * w2 + 2.0 * x2 + y2),
        v2 + sixth * (a2 + 2.0 * b2 + 2.0 * c2 + d2),
    )


@numba.njit(cache=True)
def limits(physics, of_load):
    """Return what dry friction holds at rest, backward (negative) and forward."""
    if not of_load:
        return -physics.motor_coulomb, physics.motor_coulomb
    more = physics.breakaway
    if not physics.elastic:
        more += physics.motor_coulomb
    return -(physics.coulomb_backward + more), physics.coulomb_forward + more


@numba.njit(cache=True)
def next_slide(slide, speed, force, low, high):
    """Return the sliding mode after a state, and whether the speed is to be put to zero."""
    if slide == FREE:
        return FREE, False
    if slide == STUCK:
        if force > high:
            return 1, False
        return (-1, False) if force < low else (STUCK, False)
    if slide * speed >= 0.0:
        return slide, False
    if force > high:
        return 1, True
    return (-1, True) if force < low else (STUCK, True)


@numba.njit(cache=True)
def next_contact(physics, q1, v1, q2, v2):
    """Return which flank pushes in a state."""
    if not physics.elastic or physics.gap == 0.0:
        return SPRING
    deflection = q1 - q2
    side = 1 if deflection > 0.0 else -1
    if side * deflection <= 0.5 * physics.gap:
        return APART
    pushes = side * transmitted(physics, side, deflection, v1 - v2) > 0.0
    return side if pushes else APART


@numba.njit(cache=True)
def next_mode(physics, drive, noise, slide1, slide2, contact, q1, v1, q2, v2):
    """Return the mode (both slides, contact) that a state belongs to, and which speeds are zero."""
    contact = next_contact(physics, q1, v1, q2, v2)
    motor, load = applied_forces(physics, drive, noise, contact, q1, v1, q2, v2)
    low, high = limits(physics, True)
    slide2, zero2 = next_slide(slide2, v2, load, low, high)
    if not physics.elastic:
        return slide2, slide2, contact, zero2, zero2
    low, high = limits(physics, False)
    slide1, zero1 = next_slide(slide1, v1, motor, low, high)
    return slide1, slide2, contact, zero1, zero2


@numba.njit(cache=True)
def drive_at(begin, final, decay_s, since_s):
    """Return the force of a drive that goes exponentially from `begin` to `final`."""
    if decay_s <= 0.0:
        return final
    return final + (begin - final) * math.exp(-since_s / decay_s)


@numba.njit(cache=True)
def advance(physics, step, begin, final, decay_s, noise, mode, state):
    """
    Advance `state` (q1, v1, q2, v2) and `mode` (slides, contact) in place by a step.

    The drive's force goes from `begin` exponentially towards `final`. Returns 1 if the step had too many
    events and was taken without looking at more of them, else 0.
    """
    done, events = 0.0, 0
    drives = np.empty(3)
    q1, v1, q2, v2 = state[0], state[1], state[2], state[3]
    slide1, slide2, contact = mode[0], mode[1], mode[2]
    while done < step:
        left = step - done
        low, high, first = 0.0, left, True
        found1, found2, found_c, zero1, zero2 = slide1, slide2, contact, False, False
        p1, w1, p2, w2 = q1, v1, q2, v2
        for _ in range(BISECTIONS):
            part = high if first else 0.5 * (low + high)
            for place in range(3):
                drives[place] = drive_at(begin, final, decay_s, done + 0.5 * place * part)
            n1, m1, n2, m2 = smooth_step(
                physics, part, drives, noise, slide1, slide2, contact, q1, v1, q2, v2
            )
            t1, t2, tc, z1, z2 = next_mode(
                physics, drives[2], noise, slide1, slide2, contact, n1, m1, n2, m2
            )
            same = t1 == slide1 and t2 == slide2 and tc == contact and not z1 and not z2
            if first and (same or events > MOST_EVENTS):
                p1, w1, p2, w2 = n1, m1, n2, m2
                break
            first = False
            if same:
                low = part
            else:
                high = part
                p1, w1, p2, w2 = n1, m1, n2, m2
                found1, found2, found_c, zero1, zero2 = t1, t2, tc, z1, z2
        q1, v1, q2, v2 = p1, w1, p2, w2
        if first:
            done = step
        else:
            done += high
            events += 1
            slide1, slide2, contact = found1, found2, found_c
            if zero1:
                v1 = 0.0
            if zero2:
                v2 = 0.0
    state[0], state[1], state[2], state[3] = q1, v1, q2, v2
    mode[0], mode[1], mode[2] = slide1, slide2, contact
    return 1 if events > MOST_EVENTS else 0


@numba.njit(cache=True)
def first_mode(physics, state):
    """Return the mode of a motion that begins in a state."""
    mode = np.empty(3, np.int64)
    low, high = limits(physics, False)
    mode[0] = FREE if low == 0.0 and high == 0.0 else STUCK
    if state[1] != 0.0 and mode[0] != FREE:
        mode[0] = 1 if state[1] > 0.0 else -1
    low, high = limits(physics, True)
    mode[1] = FREE if low == 0.0 and high == 0.0 else STUCK
    if state[3] != 0.0 and mode[1] != FREE:
        mode[1] = 1 if state[3] > 0.0 else -1
    if not physics.elastic:
        mode[0] = mode[1]
    mode[2] = next_contact(physics, state[0], state[1], state[2], state[3])
    return mode


@numba.njit(cache=True)
def motion_under(physics, state, forces, step):
    """
    Return the motion (steps + 1, 4) under given forces, each held for a step; for tests.

    The second result is the number of steps that were forced through.
    """
    path = np.empty((len(forces) + 1, 4))
    path[0] = state
    now = state.copy()
    mode = first_mode(physics, now)
    forced = 0
    for place in range(len(forces)):
        force = forces[place]
        forced += advance(physics, step, force, force, 0.0, 0.0, mode, now)
        path[place + 1] = now
    return path, forced


class Encoder(NamedTuple):
    """
    An encoder: counts = floor or round of (x(t - delay) + error + noise) / resolution.

    `x` is `ratio` times the coordinate, the error cosine cos k x + sine sin k x, k = 2 pi / period;
    the delay is in steps of the integrator, the noise in counts.
    """

    ratio: float
    resolution: float
    rounds: bool
    cosine: float
    sine: float
    period: float
    delay_steps: int


@numba.njit(cache=True)
def reading(encoder, position, noise):
    """Return what an encoder shows, in units of x, for its coordinate's true position."""
    shown = encoder.ratio * position
    if encoder.cosine != 0.0 or encoder.sine != 0.0:
        phase = 2.0 * math.pi * shown / encoder.period
        shown += encoder.cosine * math.cos(phase) + encoder.sine * math.sin(phase)
    counts = shown / encoder.resolution + noise
    counts = math.floor(counts + 0.5) if encoder.rounds else math.floor(counts)
    return counts * encoder.resolution


class Loop(NamedTuple):
    """
    Controller and drive. Gains at the axis; positions by one encoder, speeds by another or the same.

    Cascade: v_ref = velocity_feedforward v_r + position_gain e;
    u = velocity_gain ((v_ref - v) + integral_rate * integral of (v_ref - v)) + mass_feedforward a_r.
    PID: u = position_gain e + velocity_gain (velocity_feedforward v_r - v)
    + position_gain integral_rate * integral of e + mass_feedforward a_r.
    The current follows u / known_constant after `delay_steps`, with the lag `lag_s`; the force is
    true_constant times it. The command is limited, and the integral stands at the limit; it begins at
    `bias`, which the machine is known to need to be held.
    """

    cascade: bool
    position_gain: float
    velocity_gain: float
    integral_rate: float
    velocity_feedforward: float
    mass_feedforward: float
    filter_share: float
    position_on_motor: bool
    velocity_on_motor: bool
    known_constant: float
    true_constant: float
    limit: float
    delay_steps: int
    lag_s: float
    bias: float


@numba.njit(cache=True)
def run_loop(
    physics, loop, load_encoder, motor_encoder, reference, force_noise, counts_noise, tick_s, steps
):
    """
    Return a run of the whole machine.

    `reference` (ticks, 3): position, speed, acceleration; `force_noise` (ticks, m): forces on the load,
    each held for an m-th of a tick; `counts_noise` (ticks, 2): of load and motor encoder. `steps` per
    tick. Returns readings (ticks, 2), commands and currents at the ticks (A), the motion at every step
    (ticks * steps + 1, 4), the drive's force there, and the number of forced steps.
    """
    ticks = len(reference)
    step = tick_s / steps
    readings = np.empty((ticks, 2))
    commands, currents = np.empty(ticks), np.empty(ticks)
    motion = np.empty((ticks * steps + 1, 4))
    forces = np.empty(ticks * steps + 1)
    now = np.array([reference[0, 0], 0.0, reference[0, 0], 0.0])
    mode = first_mode(physics, now)
    motion[0] = now
    forces[0] = 0.0
    integral, speed, before = loop.bias, 0.0, 0.0
    current = loop.bias / loop.known_constant
    forced = 0
    parts = force_noise.shape[1]
    for tick in range(ticks):
        seen = max(0, tick * steps - load_encoder.delay_steps)
        load = reading(load_encoder, motion[seen, 2], counts_noise[tick, 0])
        seen = max(0, tick * steps - motor_encoder.delay_steps)
        motor = reading(motor_encoder, motion[seen, 0], counts_noise[tick, 1])
        readings[tick, 0], readings[tick, 1] = load, motor
        at = motor / motor_encoder.ratio if loop.position_on_motor else load
        other = motor / motor_encoder.ratio if loop.velocity_on_motor else load
        if tick == 0:
            before = other
        speed += loop.filter_share * ((other - before) / tick_s - speed)
        before = other
        error = reference[tick, 0] - at
        wanted = loop.velocity_feedforward * reference[tick, 1]
        if loop.cascade:
            wanted += loop.position_gain * error
            share = wanted - speed
            gain = loop.velocity_gain * loop.integral_rate
            force = loop.velocity_gain * share
        else:
            share = error
            gain = loop.position_gain * loop.integral_rate
            force = loop.position_gain * error + loop.velocity_gain * (wanted - speed)
        force += loop.mass_feedforward * reference[tick, 2]
        more = integral + gain * share * tick_s
        command = (force + more) / loop.known_constant
        if abs(command) <= loop.limit:
            integral = more
        commands[tick] = min(max(command, -loop.limit), loop.limit)
        currents[tick] = current
        for part in range(steps):
            place = tick * steps + part
            given = place - loop.delay_steps
            wanted_current = commands[given // steps] if given >= 0 else commands[0]
            noise = force_noise[tick, part * parts // steps]
            begin = loop.true_constant * current
            final = loop.true_constant * wanted_current
            forced += advance(physics, step, begin, final, loop.lag_s, noise, mode, now)
            current = drive_at(current, wanted_current, loop.lag_s, step)
            motion[place + 1] = now
            forces[place + 1] = loop.true_constant * current
    return readings, commands, currents, motion, forces, forced
