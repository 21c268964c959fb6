# SPDX-License-Identifier: Apache-2.0
"""
One-dimensional elements on the coordinates: spring-damper, tension-only cable, dry friction.

Each acts on a deflection e = a z_i + b z_j of one or two minimal coordinates, and comes in two
parts: one that puts it into the equations of an implicit midpoint step (see `plant`), which are

    A dz' = r,    A = M + h/2 B + h^2/4 K,    r = h (forces at the middle without dz'),

and one that books its loss afterwards, once the step's mean speed is known. `step` is h in s,
`matrix` is A (lower triangle), `right` is r; a deflection's mean speed over the step is u.
"""

from __future__ import annotations

from waferbot_lockstep.compiled import compiled
from waferbot_plant.spring_laws import force_and_arms_now, stored_in_law

LONGEST_TABLE = 16
MOST_LOADS = 8
"""Most points over speed, and over load, that a table of friction can have."""


def parameter_fields(springs: int, cables: int, frictions: int) -> list[tuple]:
    """
    Return the dtype fields of the elements.

    A spring or cable deflects by first_ratio * z[first] + second_ratio * z[second] from its
    `rest`; stiffness in N/m (Nm/rad), damping in N s/m (Nm s/rad). A friction acts on `ratio`
    times one coordinate with a table of resistance (N, Nm) over speed, and `breakaway` times its
    first value. A row of the table is for a load; all but the first are for `friction_laws`.
    """
    two_sided = [
        ('first', 'i8'), ('second', 'i8'), ('first_ratio', 'f8'), ('second_ratio', 'f8'),
        ('stiffness', 'f8'), ('damping', 'f8'), ('rest', 'f8'),
    ]  # fmt: skip
    return [
        *((f'spring_{name}', kind, (springs,)) for name, kind in two_sided),
        *((f'cable_{name}', kind, (cables,)) for name, kind in two_sided),
        ('friction_coordinate', 'i8', (frictions,)),
        ('friction_ratio', 'f8', (frictions,)),
        ('friction_points', 'i8', (frictions,)),
        ('friction_speed', 'f8', (frictions, LONGEST_TABLE)),
        ('friction_resistance', 'f8', (frictions, MOST_LOADS, LONGEST_TABLE)),
        ('friction_breakaway', 'f8', (frictions,)),
    ]


def state_fields(springs: int, cables: int, frictions: int, coordinates: int) -> list[tuple]:
    """
    Return the dtype fields of the elements' states and ledgers.

    `sliding` is +1 or -1 with the direction of a sliding coordinate and 0 where it is stuck;
    `friction_force` is what friction does on a coordinate (N, Nm), `cable_force` the mean tension
    of the last step (N). Losses are energies since the start, J.
    """
    return [
        ('sliding', 'i8', (coordinates,)),
        ('friction_force', 'f8', (coordinates,)),
        ('sliding_friction', 'f8', (coordinates,)),
        ('holding_friction', 'f8', (coordinates,)),
        ('friction_now', 'f8', (frictions,)),
        ('cable_force', 'f8', (cables,)),
        ('cable_stiffness', 'f8', (cables,)),
        ('cable_damping', 'f8', (cables,)),
        ('spring_loss', 'f8', (springs,)),
        ('cable_loss', 'f8', (cables,)),
        ('friction_loss', 'f8', (frictions,)),
    ]


@compiled
def add_spring(
    matrix, right, first, second, a, b, stiffness, damping, rest, position, velocity, step
):
    """
    Put a spring-damper force k (e - rest) + d e' into A and r (5.4).

    At the middle of the step e = e_0 + h/2 e'_0 + h^2/4 w.dz'/h and e' = e'_0 + w.dz'/2, with
    w = (a, b): the known part goes to r, the part with dz' to A.
    """
    speed = a * velocity[first] + b * velocity[second]
    deflection = a * position[first] + b * position[second] - rest
    impulse = step * (stiffness * (deflection + 0.5 * step * speed) + damping * speed)
    gain = 0.5 * step * (damping + 0.5 * step * stiffness)
    right[first] -= impulse * a
    matrix[first, first] += gain * a * a
    if b != 0.0:
        right[second] -= impulse * b
        matrix[second, second] += gain * b * b
        matrix[max(first, second), min(first, second)] += gain * a * b


@compiled
def add_springs(s, p, matrix, right, position, velocity, step):
    """Put all spring-dampers into A and r, but for those with a law (see `spring_laws`)."""
    any_law = s['any_spring_law']
    for spring in range(p['springs']):
        if any_law and s['spring_lawful'][spring]:
            continue
        add_spring(
            matrix, right, p['spring_first'][spring], p['spring_second'][spring],
            p['spring_first_ratio'][spring], p['spring_second_ratio'][spring],
            p['spring_stiffness'][spring], p['spring_damping'][spring], p['spring_rest'][spring],
            position, velocity, step,
        )  # fmt: skip


@compiled
def book_springs(s, p, mean_speed, step):
    """Add the step's loss d u^2 of every linear spring-damper to its ledger."""
    any_law = s['any_spring_law']
    for spring in range(p['springs']):
        if any_law and s['spring_lawful'][spring]:
            continue
        speed = (
            p['spring_first_ratio'][spring] * mean_speed[p['spring_first'][spring]]
            + p['spring_second_ratio'][spring] * mean_speed[p['spring_second'][spring]]
        )
        s['spring_loss'][spring] += p['spring_damping'][spring] * speed * speed * step


@compiled
def cable_elongation(p, cable, position):
    """Return the elongation of a cable from its unstretched length, m; negative when slack."""
    return (
        p['cable_first_ratio'][cable] * position[p['cable_first'][cable]]
        + p['cable_second_ratio'][cable] * position[p['cable_second'][cable]]
        - p['cable_rest'][cable]
    )


@compiled
def judge_cables(s, p, middle, speed):
    """
    Decide for each cable how it acts in this step, from the predicted middle of it.

    Appendix C of the thesis: in tension f = k e + f_d with f_d = d e' bounded by the spring force,
    |f_d| <= k e; slack f = 0. So within its bound it is a spring-damper; at the bounds it is a
    spring of 2 k while it stretches fast, and no force while it shortens fast: a damper never
    makes a cable push.
    """
    for cable in range(p['cables']):
        elongation = cable_elongation(p, cable, middle)
        rate = (
            p['cable_first_ratio'][cable] * speed[p['cable_first'][cable]]
            + p['cable_second_ratio'][cable] * speed[p['cable_second'][cable]]
        )
        stiffness = p['cable_stiffness'][cable]
        damping = p['cable_damping'][cable]
        s['cable_force'][cable] = 0.0
        if elongation <= 0.0 or damping * rate < -stiffness * elongation:
            s['cable_stiffness'][cable] = 0.0
            s['cable_damping'][cable] = 0.0
        elif damping * rate > stiffness * elongation:
            s['cable_stiffness'][cable] = 2.0 * stiffness
            s['cable_damping'][cable] = 0.0
        else:
            s['cable_stiffness'][cable] = stiffness
            s['cable_damping'][cable] = damping


@compiled
def add_cables(s, p, matrix, right, position, velocity, step):
    """Put the cables into A and r, as they were judged, and tensions that are fixed already."""
    for cable in range(p['cables']):
        first = p['cable_first'][cable]
        second = p['cable_second'][cable]
        a = p['cable_first_ratio'][cable]
        b = p['cable_second_ratio'][cable]
        if s['cable_stiffness'][cable] > 0.0:
            add_spring(
                matrix, right, first, second, a, b, s['cable_stiffness'][cable],
                s['cable_damping'][cable], p['cable_rest'][cable], position, velocity, step,
            )  # fmt: skip
        else:
            right[first] -= step * s['cable_force'][cable] * a
            right[second] -= step * s['cable_force'][cable] * b


@compiled
def tension_in_crossing(start, free_end, compliance, stiffness):
    """
    Return the mean tension of a cable that goes slack or becomes taut within a step, N.

    `start` and `free_end` are the elongations at both ends of the step, the latter without any
    tension (m), of opposite sign; each newton of mean tension shortens the end by `compliance`
    (m/N). The tension is the difference quotient of the stored energy U(e) = k max(e, 0)^2 / 2
    over the step, so that the cable gives back exactly what was stored in it, wherever in the step
    the change falls.
    """
    if start > 0.0:
        # slack at the end: f (start - free_end + f c) = k start^2 / 2
        span = start - free_end
        stored = 0.5 * stiffness * start * start
        return 2.0 * stored / (span + (span * span + 4.0 * compliance * stored) ** 0.5)
    # taut at the end: f (e - start) = k e^2 / 2 with e = free_end - f c
    square = compliance + 0.5 * stiffness * compliance * compliance
    line = free_end - start + stiffness * compliance * free_end
    constant = 0.5 * stiffness * free_end * free_end
    root = line * line - 4.0 * square * constant
    return 2.0 * constant / (line + root**0.5)


@compiled
def stored_in_cable(p, cable, elongation):
    """Return the energy k max(e, 0)^2 / 2 stored in a cable, J."""
    taut = max(elongation, 0.0)
    return 0.5 * p['cable_stiffness'][cable] * taut * taut


@compiled
def book_cables(s, p, before, after, mean_speed, step):
    """
    Note the mean tension of the step, and book the loss: work put in less what is stored.

    `before` and `after` (n,) are the coordinates at both ends of the step.
    """
    for cable in range(p['cables']):
        start = cable_elongation(p, cable, before)
        end = cable_elongation(p, cable, after)
        rate = (
            p['cable_first_ratio'][cable] * mean_speed[p['cable_first'][cable]]
            + p['cable_second_ratio'][cable] * mean_speed[p['cable_second'][cable]]
        )
        if s['cable_stiffness'][cable] > 0.0:
            s['cable_force'][cable] = (
                s['cable_stiffness'][cable] * 0.5 * (start + end)
                + s['cable_damping'][cable] * rate
            )
        s['cable_loss'][cable] += s['cable_force'][cable] * rate * step - (
            stored_in_cable(p, cable, end) - stored_in_cable(p, cable, start)
        )


@compiled
def resistance_at(p, friction, row, speed):
    """Return dry friction (N, Nm) from a row of its table, at a speed (m/s, rad/s) of zero or more."""
    last = p['friction_points'][friction] - 1
    if speed >= p['friction_speed'][friction, last]:
        return p['friction_resistance'][friction, row, last]
    point = 0
    while speed >= p['friction_speed'][friction, point + 1]:
        point += 1
    low = p['friction_speed'][friction, point]
    high = p['friction_speed'][friction, point + 1]
    start = p['friction_resistance'][friction, row, point]
    rise = p['friction_resistance'][friction, row, point + 1] - start
    return start + rise * (speed - low) / (high - low)


@compiled
def limit_friction(s, p, speed):
    """
    Set, for each coordinate, how strongly friction resists sliding and how strongly it holds.

    All frictions of a coordinate act together. `speed` (n,) is that expected in the middle of the
    step; friction is taken at its magnitude, as the table is.
    """
    for coordinate in range(p['coordinates']):
        s['sliding_friction'][coordinate] = 0.0
        s['holding_friction'][coordinate] = 0.0
    for friction in range(p['frictions']):
        coordinate = p['friction_coordinate'][friction]
        ratio = abs(p['friction_ratio'][friction])
        at_rest = p['friction_resistance'][friction, 0, 0]
        moving = resistance_at(p, friction, 0, ratio * abs(speed[coordinate]))
        s['friction_now'][friction] = ratio * moving
        s['sliding_friction'][coordinate] += ratio * moving
        s['holding_friction'][coordinate] += ratio * at_rest * p['friction_breakaway'][friction]


@compiled
def book_frictions(s, p, mean_speed, step):
    """Add the step's friction loss to the ledgers, shared among a coordinate's frictions."""
    for friction in range(p['frictions']):
        coordinate = p['friction_coordinate'][friction]
        share = s['friction_now'][friction]
        total = s['sliding_friction'][coordinate]
        if total > 0.0:
            loss = -s['friction_force'][coordinate] * mean_speed[coordinate] * step
            s['friction_loss'][friction] += loss * share / total


@compiled
def cable_tension(s, p, cable, position, velocity):
    """Return the tension of a cable at one instant, as judged there, N."""
    rate = (
        p['cable_first_ratio'][cable] * velocity[p['cable_first'][cable]]
        + p['cable_second_ratio'][cable] * velocity[p['cable_second'][cable]]
    )
    elongation = cable_elongation(p, cable, position)
    return s['cable_stiffness'][cable] * elongation + s['cable_damping'][cable] * rate


@compiled
def subtract_instant_forces(s, p, position, velocity, right):
    """Subtract the forces of springs and cables at one instant from `right` (n,), N or Nm."""
    for spring in range(p['springs']):
        force, a, b = force_and_arms_now(s, p, spring, position, velocity)
        right[p['spring_first'][spring]] -= a * force
        right[p['spring_second'][spring]] -= b * force
    judge_cables(s, p, position, velocity)
    for cable in range(p['cables']):
        force = cable_tension(s, p, cable, position, velocity)
        right[p['cable_first'][cable]] -= p['cable_first_ratio'][cable] * force
        right[p['cable_second'][cable]] -= p['cable_second_ratio'][cable] * force


@compiled
def elastic_energy(s, p, position):
    """Return the energy in springs and cables, sum of k e^2 / 2 where linear, J."""
    energy = 0.0
    for spring in range(p['springs']):
        if s['any_spring_law'] and s['spring_lawful'][spring]:
            energy += stored_in_law(s, p, spring, position)
            continue
        deflection = (
            p['spring_first_ratio'][spring] * position[p['spring_first'][spring]]
            + p['spring_second_ratio'][spring] * position[p['spring_second'][spring]]
            - p['spring_rest'][spring]
        )
        energy += 0.5 * p['spring_stiffness'][spring] * deflection * deflection
    for cable in range(p['cables']):
        energy += stored_in_cable(p, cable, cable_elongation(p, cable, position))
    return energy
