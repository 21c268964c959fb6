# SPDX-License-Identifier: Apache-2.0
"""
Springs that are not linear: backlash, hardening, slack strands, slip, transmission error, charts.

With the deflection e = a z_1 + b z_2 - rest + t(z) and the slipped part q, the force is odd in e - q:

    c = max(|e - q| - gap / 2, 0)                  what is left of the deflection in contact
    f = min(k c (1 + H c^2) - slack part, slip)

- `gap` is the whole play: no force and no damping within half of it on either side of the rest.
- `hardening` H: stiffness k (1 + H c^2), as a secant.
- A belt has two strands of stiffness k / 2 under the pretension F_pre: one gets F_pre + k c / 2, the
  other F_pre - k c / 2, zero at k c = 2 F_pre. From there on only one pulls, and the slope is k / 2.
  In series with other springs: beyond the force `slack_force` the slope is `slack_slope` k.
- At `slip` the rest of the motion goes into q: a clutch, or a belt that jumps teeth or creeps.
- A spring that follows a curve, as a bearing's chart, has f(e) of `spring_curves` and none of the above.
- The transmission error t = A cos(order angle - phase) is by how much the driven end stands ahead,
  unloaded; it acts back on the driving end through the same virtual work.

In a step, the mean force is the mean of f over the way from e_0 to e_1, the difference quotient of
the potential, so that a spring gives back exactly what was stored in it, wherever in the step it
meets or leaves a stop; the damper acts on the change of c. That is implicit in e_1 and found by
Newton's method on the step's equations, all springs together, up to 20 rounds (two or three as a
rule). Limits: one step resolves one impact, not the waves in it; the hardening of springs in series is
to first order in H; strands are equally stiff.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled
from waferbot_plant.spring_curves import LONGEST_CURVE, force_and_slope, work

ROUNDS = 20
"""Most rounds of Newton's method in a step."""

_TOLERANCE = 1e-12


def parameter_fields(springs: int) -> list[tuple]:
    """
    Return the dtype fields, by spring in the unit of its deflection.

    Without effect: zero for `gap` (m, rad), `hardening` (1/m2, 1/rad2), `error_amplitude` (m, rad);
    infinity for `slack_force` and `slip` (N, Nm). `error_wave` is in rad per unit of the minimal
    coordinate that the error follows: the second of the spring if `error_of_driven`, else the first.
    A curve has `curve_points` points, zero without one, of deflection (m, rad), force (N, Nm) and slope.
    """
    return [
        ('spring_gap', 'f8', (springs,)),
        ('spring_hardening', 'f8', (springs,)),
        ('spring_slack_force', 'f8', (springs,)),
        ('spring_slack_slope', 'f8', (springs,)),
        ('spring_slip', 'f8', (springs,)),
        ('spring_error_amplitude', 'f8', (springs,)),
        ('spring_error_wave', 'f8', (springs,)),
        ('spring_error_phase', 'f8', (springs,)),
        ('spring_error_of_driven', 'i8', (springs,)),
        ('spring_curve_points', 'i8', (springs,)),
        *(
            (f'spring_curve_{name}', 'f8', (springs, LONGEST_CURVE))
            for name in ('deflection', 'force', 'slope')
        ),
    ]


def state_fields(springs: int) -> list[tuple]:
    """
    Return the dtype fields: q (m, rad), and a step's linearisation of the mean force.

    force = spring_force_at + spring_slope (e_1 - spring_end), on the arms `spring_arm_*`.
    """
    names = (
        'slipped', 'begin', 'end', 'force_at', 'slope', 'arm_first', 'arm_second', 'force_used',
    )  # fmt: skip
    return [
        ('any_spring_law', 'i8'),
        ('spring_lawful', 'i8', (springs,)),
        *((f'spring_{name}', 'f8', (springs,)) for name in names),
    ]


@compiled
def find_spring_laws(s, p):
    """Find which springs are more than linear."""
    found = False
    for spring in range(p['springs']):
        found |= (
            (p['spring_gap'][spring] != 0.0)
            | (p['spring_hardening'][spring] != 0.0)
            | (p['spring_error_amplitude'][spring] != 0.0)
            | (p['spring_slack_force'][spring] < math.inf)
            | (p['spring_slip'][spring] < math.inf)
            | (p['spring_curve_points'][spring] > 0)
        )
    s['any_spring_law'] = found
    if found:
        for spring in range(p['springs']):
            s['spring_lawful'][spring] = p['spring_stiffness'][spring] > 0.0 and (
                p['spring_gap'][spring] != 0.0
                or p['spring_hardening'][spring] != 0.0
                or p['spring_error_amplitude'][spring] != 0.0
                or p['spring_slack_force'][spring] < math.inf
                or p['spring_slip'][spring] < math.inf
                or p['spring_curve_points'][spring] > 0
            )


@compiled
def _error_row(p, spring):
    """Return the minimal coordinate that the transmission error follows."""
    if p['spring_error_of_driven'][spring]:
        return p['spring_second'][spring]
    return p['spring_first'][spring]


@compiled
def _error(p, spring, place):
    """Return the transmission error (m, rad) and its slope at a minimal coordinate."""
    amplitude = p['spring_error_amplitude'][spring]
    if amplitude == 0.0:
        return 0.0, 0.0
    wave = p['spring_error_wave'][spring]
    angle = wave * place - p['spring_error_phase'][spring]
    return amplitude * math.cos(angle), -amplitude * wave * math.sin(angle)


@compiled
def deflection(p, spring, position):
    """Return e of a spring with a law, m or rad."""
    error, _ = _error(p, spring, position[_error_row(p, spring)])
    return (
        p['spring_first_ratio'][spring] * position[p['spring_first'][spring]]
        + p['spring_second_ratio'][spring] * position[p['spring_second'][spring]]
        - p['spring_rest'][spring]
        + error
    )


@compiled
def _largest_contact(p, spring):
    """Return the contact deflection at which a spring slips; infinite without slip."""
    slip = p['spring_slip'][spring]
    if slip == math.inf:
        return math.inf
    stiffness = p['spring_stiffness'][spring]
    slack = p['spring_slack_force'][spring]
    if slip <= slack:
        contact = slip / stiffness
    else:
        contact = (slack + (slip - slack) / p['spring_slack_slope'][spring]) / stiffness
    if p['spring_hardening'][spring] != 0.0:
        for _ in range(12):
            force, slope = _force_in_contact(p, spring, contact)
            contact -= (force - slip) / slope
    return contact


@compiled
def _force_in_contact(p, spring, contact):
    """Return force and slope at a contact deflection of zero or more, without slip."""
    points = p['spring_curve_points'][spring]
    if points > 0:
        return force_and_slope(
            p['spring_curve_deflection'][spring], p['spring_curve_force'][spring],
            p['spring_curve_slope'][spring], points, contact,
        )  # fmt: skip
    stiffness = p['spring_stiffness'][spring]
    slack = p['spring_slack_force'][spring]
    force, slope = stiffness * contact, stiffness
    if force > slack:
        slope = stiffness * p['spring_slack_slope'][spring]
        force = slack + p['spring_slack_slope'][spring] * (force - slack)
    cubic = stiffness * p['spring_hardening'][spring] * contact * contact
    return force + cubic * contact, slope + 3.0 * cubic


@compiled
def _contact(p, spring, elastic, largest):
    """Return the contact deflection with its sign, limited by slip, and whether it is inside."""
    contact = abs(elastic) - 0.5 * p['spring_gap'][spring]
    if contact <= 0.0:
        # Unloaded, a curve is in contact all the same: it has no gap.
        return 0.0, p['spring_curve_points'][spring] > 0
    if contact >= largest:
        return math.copysign(largest, elastic), False
    return math.copysign(contact, elastic), True


@compiled
def _work(p, spring, low, high, largest):
    """Return the integral of the force over a deflection from `low` to `high`, 0 <= low <= high, J."""
    points = p['spring_curve_points'][spring]
    if points > 0:
        return work(
            p['spring_curve_deflection'][spring], p['spring_curve_force'][spring],
            p['spring_curve_slope'][spring], points, low, high,
        )  # fmt: skip
    half_gap = 0.5 * p['spring_gap'][spring]
    stiffness = p['spring_stiffness'][spring]
    slack = p['spring_slack_force'][spring]
    knee = min(slack / stiffness, largest)
    low, high = max(low - half_gap, 0.0), max(high - half_gap, 0.0)
    total = 0.0
    if low < knee:
        end = min(high, knee)
        total += (end - low) * 0.5 * stiffness * (low + end)
    if knee < largest and high > knee and low < largest:
        start, end = max(low, knee), min(high, largest)
        middle = 0.5 * (start + end)
        total += (end - start) * (
            slack + p['spring_slack_slope'][spring] * (stiffness * middle - slack)
        )
    hardening = p['spring_hardening'][spring]
    if hardening != 0.0 and low < largest:
        end = min(high, largest)
        total += 0.25 * stiffness * hardening * (end - low) * (low + end) * (low * low + end * end)
    if high > largest:
        total += (high - max(low, largest)) * p['spring_slip'][spring]
    return total


@compiled
def _mean_force(p, spring, start, end, largest):
    """Return the mean of the force over the way between two elastic deflections, and its slope."""
    force, slope = _force_at(p, spring, end, largest)
    way = end - start
    if abs(way) <= 1e-6 * (abs(start) + abs(end)):
        return _force_at(p, spring, 0.5 * (start + end), largest)[0], 0.5 * slope
    low, high = min(start, end), max(start, end)
    if low >= 0.0:
        work = _work(p, spring, low, high, largest)
    elif high <= 0.0:
        work = -_work(p, spring, -high, -low, largest)
    else:
        work = _work(p, spring, 0.0, high, largest) - _work(p, spring, 0.0, -low, largest)
    mean = work / (high - low)
    return mean, max((force - mean) / way, 0.0)


@compiled
def _force_at(p, spring, elastic, largest):
    """Return the force and its slope at an elastic deflection."""
    contact, inside = _contact(p, spring, elastic, largest)
    if contact == 0.0 and not inside:
        return 0.0, 0.0
    force, slope = _force_in_contact(p, spring, abs(contact))
    return math.copysign(force, contact), slope if inside else 0.0


@compiled
def _linearise(s, p, spring, position, end_position, step):
    """Write the linearisation of a spring about a step that ends at e_1 = `end_position`'s."""
    begin = deflection(p, spring, position)
    end = deflection(p, spring, end_position)
    slipped = s['spring_slipped'][spring]
    largest = _largest_contact(p, spring)
    force, slope = _mean_force(p, spring, begin - slipped, end - slipped, largest)
    before, _ = _contact(p, spring, begin - slipped, largest)
    after, inside = _contact(p, spring, end - slipped, largest)
    damping = p['spring_damping'][spring] / step
    s['spring_begin'][spring] = begin
    s['spring_end'][spring] = end
    s['spring_force_at'][spring] = force + damping * (after - before)
    s['spring_slope'][spring] = slope + (damping if inside else 0.0)
    row = _error_row(p, spring)
    error_begin, tangent = _error(p, spring, position[row])
    error_end, _ = _error(p, spring, end_position[row])
    way = end_position[row] - position[row]
    if abs(way * p['spring_error_wave'][spring]) > 1e-6:
        tangent = (error_end - error_begin) / way
    of_driven = p['spring_error_of_driven'][spring]
    s['spring_arm_first'][spring] = p['spring_first_ratio'][spring] + (
        0.0 if of_driven else tangent
    )
    s['spring_arm_second'][spring] = p['spring_second_ratio'][spring] + (
        tangent if of_driven else 0.0
    )


@compiled
def begin_rounds(s, p, step):
    """Linearise all springs with a law about the end of the step expected from the last one."""
    position = s['position']
    end = s['end_position']
    for row in range(p['coordinates']):
        end[row] = position[row] + step * s['middle_velocity'][row]
    for spring in range(p['springs']):
        if s['spring_lawful'][spring]:
            _linearise(s, p, spring, position, end, step)


@compiled
def add_laws(s, p, matrix, right, velocity, step):
    """Put the linearised springs into A and r."""
    for spring in range(p['springs']):
        if s['spring_lawful'][spring]:
            first, second = p['spring_first'][spring], p['spring_second'][spring]
            a, b = s['spring_arm_first'][spring], s['spring_arm_second'][spring]
            slope = s['spring_slope'][spring]
            coasting = s['spring_begin'][spring] + step * (
                a * velocity[first] + b * velocity[second]
            )
            impulse = step * (
                s['spring_force_at'][spring] + slope * (coasting - s['spring_end'][spring])
            )
            gain = 0.5 * step * step * slope
            right[first] -= impulse * a
            matrix[first, first] += gain * a * a
            if b != 0.0:
                right[second] -= impulse * b
                matrix[second, second] += gain * b * b
                matrix[max(first, second), min(first, second)] += gain * a * b


@compiled
def linearised_force(s, p, spring, mean, step):
    """Return the mean force of the linearised spring at the mean speeds (n,) of a step, N or Nm."""
    end = s['spring_begin'][spring] + step * (
        s['spring_arm_first'][spring] * mean[p['spring_first'][spring]]
        + s['spring_arm_second'][spring] * mean[p['spring_second'][spring]]
    )
    return s['spring_force_at'][spring] + s['spring_slope'][spring] * (
        end - s['spring_end'][spring]
    )


@compiled
def end_round(s, p, step, last):
    """
    Return whether the step that was found bears its linearisations out; if not, linearise again.

    The force used is noted for the books. On the `last` round the linearisation is kept, and what is
    missing is booked with the loss.
    """
    position = s['position']
    end = s['end_position']
    mean = s['middle_velocity']
    for row in range(p['coordinates']):
        mean[row] = s['velocity'][row] + 0.5 * s['velocity_change'][row]
        end[row] = position[row] + step * mean[row]
    fit = True
    for spring in range(p['springs']):
        if s['spring_lawful'][spring]:
            used = linearised_force(s, p, spring, mean, step)
            s['spring_force_used'][spring] = used
            if last:
                continue
            a, b = s['spring_arm_first'][spring], s['spring_arm_second'][spring]
            _linearise(s, p, spring, position, end, step)
            turned = abs(s['spring_arm_first'][spring] - a) + abs(
                s['spring_arm_second'][spring] - b
            )
            scale = abs(used) + p['spring_stiffness'][spring] * abs(
                s['spring_end'][spring] - s['spring_begin'][spring]
            )
            missed = abs(s['spring_force_at'][spring] - used)
            if missed > _TOLERANCE * scale or turned > _TOLERANCE * (abs(a) + abs(b)):
                fit = False
    return fit


@compiled
def book_laws(s, p, before, after, step):
    """Book work less what is stored as lost, and let springs beyond their limit slip."""
    for spring in range(p['springs']):
        if not s['spring_lawful'][spring]:
            continue
        begin, end = deflection(p, spring, before), deflection(p, spring, after)
        stored = _stored(p, spring, begin - s['spring_slipped'][spring])
        work = s['spring_force_used'][spring] * (end - begin)
        limit = _largest_contact(p, spring) + 0.5 * p['spring_gap'][spring]
        elastic = end - s['spring_slipped'][spring]
        if abs(elastic) > limit:
            s['spring_slipped'][spring] = end - math.copysign(limit, elastic)
            elastic = math.copysign(limit, elastic)
        s['spring_loss'][spring] += work - (_stored(p, spring, elastic) - stored)


@compiled
def _stored(p, spring, elastic):
    """Return the energy in a spring at an elastic deflection, J."""
    return _work(p, spring, 0.0, abs(elastic), _largest_contact(p, spring))


@compiled
def stored_in_law(s, p, spring, position):
    """Return the energy in a spring with a law, J."""
    return _stored(p, spring, deflection(p, spring, position) - s['spring_slipped'][spring])


@compiled
def slope_now(s, p, spring, position):
    """Return the slope of a spring's force at one instant: zero in a gap and where it slips."""
    if not (s['any_spring_law'] and s['spring_lawful'][spring]):
        return p['spring_stiffness'][spring]
    elastic = deflection(p, spring, position) - s['spring_slipped'][spring]
    return _force_at(p, spring, elastic, _largest_contact(p, spring))[1]


@compiled
def stiffness_now(s, p, spring, position):
    """Return the slope of a spring's force at one instant; k where there is none to go by."""
    slope = slope_now(s, p, spring, position)
    return slope if slope > 0.0 else p['spring_stiffness'][spring]


@compiled
def force_and_arms_now(s, p, spring, position, velocity):
    """Return force (N, Nm) at one instant, and the arms by which it acts on its coordinates."""
    first, second = p['spring_first'][spring], p['spring_second'][spring]
    a, b = p['spring_first_ratio'][spring], p['spring_second_ratio'][spring]
    if not (s['any_spring_law'] and s['spring_lawful'][spring]):
        e = a * position[first] + b * position[second] - p['spring_rest'][spring]
        rate = a * velocity[first] + b * velocity[second]
        return p['spring_stiffness'][spring] * e + p['spring_damping'][spring] * rate, a, b
    _, tangent = _error(p, spring, position[_error_row(p, spring)])
    if p['spring_error_of_driven'][spring]:
        b += tangent
    else:
        a += tangent
    elastic = deflection(p, spring, position) - s['spring_slipped'][spring]
    largest = _largest_contact(p, spring)
    force, _ = _force_at(p, spring, elastic, largest)
    _, inside = _contact(p, spring, elastic, largest)
    rate = a * velocity[first] + b * velocity[second]
    return force + (p['spring_damping'][spring] * rate if inside else 0.0), a, b
