# SPDX-License-Identifier: Apache-2.0
"""
Forces from outside the model: constant, periodic, from a table, noise, and a floor that shakes.

Each acts on one coordinate x of the description and is positive in its positive sense; on the
minimal coordinate z with x = a z it is a F. It is taken at the middle of a step, as expected from
the last one, so the step stays of second order.

- constant: F.
- periodic (cogging, an unbalanced rotor): F = c cos(k x) + s sin(k x) with k = 2 pi order / period.
  It has the potential U = (s cos(k x) - c sin(k x)) / k, so what it takes it gives back: it is
  booked as stored, not lost, with an error of order h^2.
- table over position, velocity or time: linear between the points, constant outside. Where it
  falls with velocity it acts as a damper and is taken implicitly, stable at any slope.
- noise: white noise through a first-order low-pass of bandwidth f (an Ornstein-Uhlenbeck process)
  of standard deviation `rms`, held over a tick T: F_k = p F_(k-1) + rms sqrt(1 - p^2) n_k with
  p = exp(-2 pi f T), which is exact at the ticks. n_k follows from seed, slot and tick alone.
- vibration: the floor accelerates by A sin(2 pi f t + phase), the same for all of the machine. In the
  frame of the machine that is gravity less that acceleration; encoders and motors move along with it.

Limits: 24 forces, 64 points. Position tables and periodic forces are explicit: their slope k must
stay below the 4 m / h^2 of the mass m that they act on. The work of all but the periodic ones is
booked as supplied, J.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.noise import normal

SLOTS = 24
"""Most forces that a machine can have."""

LONGEST = 64
"""Most points of a table."""

KINDS = ('none', 'constant', 'periodic', 'position', 'velocity', 'time', 'noise')
"""Names of `disturbance_kind`, in order; the middle three are tables."""

CONSTANT, PERIODIC, POSITION, VELOCITY, TIME, NOISE = range(1, 7)

_FIRST_CHANNEL = 1000

PARAMETER_FIELDS: list[tuple] = [
    ('disturbances', 'i8'),
    ('disturbance_kind', 'i8', (SLOTS,)),
    ('disturbance_coordinate', 'i8', (SLOTS,)),
    ('disturbance_ratio', 'f8', (SLOTS,)),
    ('disturbance_constant', 'f8', (SLOTS,)),
    ('disturbance_cosine', 'f8', (SLOTS,)),
    ('disturbance_sine', 'f8', (SLOTS,)),
    ('disturbance_wave', 'f8', (SLOTS,)),
    ('disturbance_rms', 'f8', (SLOTS,)),
    ('disturbance_pole', 'f8', (SLOTS,)),
    ('disturbance_seed', 'i8', (SLOTS,)),
    ('disturbance_points', 'i8', (SLOTS,)),
    ('disturbance_at', 'f8', (SLOTS, LONGEST)),
    ('disturbance_value', 'f8', (SLOTS, LONGEST)),
    ('vibration_acceleration', 'f8', (3,)),
    ('vibration_frequency', 'f8'),
    ('vibration_phase', 'f8'),
]
"""
`disturbances` counts the slots in use. Forces in N or Nm on x = ratio z; `wave` is k in rad per m
or rad of x; a pole is p; the floor in m/s2, Hz, rad.
"""


def state_fields(coordinates: int) -> list[tuple]:
    """
    Return the dtype fields: time, noise, ledgers, and the workings of a step.

    `steps` counts the steps since the start and is the only clock: t = steps h. In a step a force
    is `disturbance_force + disturbance_slope * speed of x`; `floor_force` (n,) is that of the floor.
    """
    return [
        ('steps', 'i8'),
        ('disturbance_noise', 'f8', (SLOTS,)),
        ('disturbance_force', 'f8', (SLOTS,)),
        ('disturbance_slope', 'f8', (SLOTS,)),
        ('disturbance_work', 'f8', (SLOTS,)),
        ('floor_force', 'f8', (coordinates,)),
        ('floor_work', 'f8'),
    ]


@compiled
def shakes(p):
    """Return whether the floor vibrates."""
    a = p['vibration_acceleration']
    return a[0] != 0.0 or a[1] != 0.0 or a[2] != 0.0


@compiled
def draw_noise(s, p):
    """Give every noise its value of this tick, N or Nm; the first is drawn as if it always ran."""
    tick = s['steps'] // p['substeps']
    for slot in range(p['disturbances']):
        if p['disturbance_kind'][slot] == NOISE:
            pole = p['disturbance_pole'][slot] if tick > 0 else 0.0
            fresh = normal(p['disturbance_seed'][slot], _FIRST_CHANNEL + slot, tick)
            s['disturbance_noise'][slot] = (
                pole * s['disturbance_noise'][slot]
                + p['disturbance_rms'][slot] * math.sqrt(1.0 - pole * pole) * fresh
            )


@compiled
def _table(p, slot, at):
    """Return value and slope of a table at an abscissa."""
    last = p['disturbance_points'][slot] - 1
    if at <= p['disturbance_at'][slot, 0]:
        return p['disturbance_value'][slot, 0], 0.0
    if at >= p['disturbance_at'][slot, last]:
        return p['disturbance_value'][slot, last], 0.0
    point = 0
    while at >= p['disturbance_at'][slot, point + 1]:
        point += 1
    low = p['disturbance_at'][slot, point]
    start = p['disturbance_value'][slot, point]
    slope = (p['disturbance_value'][slot, point + 1] - start) / (
        p['disturbance_at'][slot, point + 1] - low
    )
    return start + slope * (at - low), slope


@compiled
def force_and_slope(s, p, slot, position, velocity, time):
    """
    Return the force on x (N, Nm) at one instant (n,), s, and its slope over the speed of x.

    The slope is that of a table over velocity and zero else.
    """
    kind = p['disturbance_kind'][slot]
    row = p['disturbance_coordinate'][slot]
    ratio = p['disturbance_ratio'][slot]
    if kind == CONSTANT:
        return p['disturbance_constant'][slot], 0.0
    if kind == PERIODIC:
        angle = p['disturbance_wave'][slot] * ratio * position[row]
        return (
            p['disturbance_cosine'][slot] * math.cos(angle)
            + p['disturbance_sine'][slot] * math.sin(angle)
        ), 0.0
    if kind == POSITION:
        return _table(p, slot, ratio * position[row])[0], 0.0
    if kind == VELOCITY:
        return _table(p, slot, ratio * velocity[row])
    if kind == TIME:
        return _table(p, slot, time)[0], 0.0
    if kind == NOISE:
        return s['disturbance_noise'][slot], 0.0
    return 0.0, 0.0


@compiled
def add_disturbances(s, p, matrix, right, middle, mean, velocity, step):
    """Put the forces into A and r, at the middle of the step as expected: `middle`, `mean` (n,)."""
    time = (s['steps'] + 0.5) * step
    for slot in range(p['disturbances']):
        row = p['disturbance_coordinate'][slot]
        ratio = p['disturbance_ratio'][slot]
        force, slope = force_and_slope(s, p, slot, middle, mean, time)
        slope = min(slope, 0.0)
        force -= slope * ratio * mean[row]
        s['disturbance_force'][slot] = force
        s['disturbance_slope'][slot] = slope
        right[row] += step * ratio * (force + slope * ratio * velocity[row])
        matrix[row, row] -= 0.5 * step * slope * ratio * ratio


@compiled
def add_floor(s, p, right, step):
    """
    Put the floor's force -a dC/dz into r, with C the sum of mass times place, kg m.

    Uses the composite bodies that `mass_matrix_and_bias` left in the workspace: C changes by
    m s_linear + s_angular x c with the motion s of a joint that carries the mass m with the first
    moment c.
    """
    time = (s['steps'] + 0.5) * step
    wave = math.sin(2.0 * math.pi * p['vibration_frequency'] * time + p['vibration_phase'])
    ax = p['vibration_acceleration'][0] * wave
    ay = p['vibration_acceleration'][1] * wave
    az = p['vibration_acceleration'][2] * wave
    force = s['floor_force']
    for row in range(p['coordinates']):
        force[row] = 0.0
    for link in range(p['links']):
        s0, s1, s2, s3, s4, s5 = s['motion'][link + 1]
        mass, cx, cy, cz = s['composite'][link + 1, :4]
        force[p['coordinate'][link]] -= p['ratio'][link] * (
            ax * (mass * s3 + s1 * cz - s2 * cy)
            + ay * (mass * s4 + s2 * cx - s0 * cz)
            + az * (mass * s5 + s0 * cy - s1 * cx)
        )
    for row in range(p['coordinates']):
        right[row] += step * force[row]


@compiled
def book_disturbances(s, p, mean, step):
    """Add the step's work of every force but the periodic ones to its ledger, J."""
    for slot in range(p['disturbances']):
        if p['disturbance_kind'][slot] != PERIODIC:
            speed = p['disturbance_ratio'][slot] * mean[p['disturbance_coordinate'][slot]]
            force = s['disturbance_force'][slot] + s['disturbance_slope'][slot] * speed
            s['disturbance_work'][slot] += force * speed * step


@compiled
def book_floor(s, p, mean, step):
    """Add the floor's work of the step to its ledger, J, in the frame of the machine."""
    for row in range(p['coordinates']):
        s['floor_work'] += s['floor_force'][row] * mean[row] * step


@compiled
def add_instant_disturbances(s, p, position, velocity, result):
    """Add the forces at one instant, the state's own time, to `result` (n,); not the floor's."""
    time = s['steps'] * p['step']
    for slot in range(p['disturbances']):
        force, _ = force_and_slope(s, p, slot, position, velocity, time)
        result[p['disturbance_coordinate'][slot]] += p['disturbance_ratio'][slot] * force


@compiled
def stored_in_periodic(p, position):
    """Return the potential of the periodic forces, J; of either sign."""
    energy = 0.0
    for slot in range(p['disturbances']):
        wave = p['disturbance_wave'][slot]
        if p['disturbance_kind'][slot] == PERIODIC and wave != 0.0:
            angle = (
                wave * p['disturbance_ratio'][slot] * position[p['disturbance_coordinate'][slot]]
            )
            energy += (
                p['disturbance_sine'][slot] * math.cos(angle)
                - p['disturbance_cosine'][slot] * math.sin(angle)
            ) / wave
    return energy
