# SPDX-License-Identifier: Apache-2.0
"""
What makes real dry friction differ from a table of resistance over speed.

The table T(|u|) of a friction, or its map T(|u|, |F_m|), with u the speed of its coordinate x, is made

    R = (T + b |u|^p + mu |F_m| + nu P) max(0, 1 + A cos(k x - phase)) (1 + C exp(-t / tau))
        (1 + a sign(u))

growing with a power of the speed (p = 1 viscous, 2/3 a rolling bearing in oil), load-dependent by
the force or torque F_m of the motors on the same coordinate, position-dependent (a bent rail, an
eccentric seal), cold at the start of the run (a ferrofluid that warms), and dependent on direction.
At rest T is the table's first value times `breakaway`. It stays set-valued: whatever is within the
limits of both directions sticks exactly.

A **map** has rows T_j at loads L_j from zero up. With T_j(|u|) the row as a table, and |F_m| from L_j to
L_j+1, it is bilinear,

    T = T_j(|u|) + (T_j+1(|u|) - T_j(|u|)) (|F_m| - L_j) / (L_j+1 - L_j),

and held constant beyond the last load and speed. At constant speed F_m is what goes in, and T what does
not come out: a gearbox on a test bench is known so, whatever is inside (thesis, chapter 7).

A friction that **follows a bearing** has the load P (N) that the bearing bears at the moment, see
`bearing_loads`, in the place of |F_m| in its map, and the rolling friction nu P: nu is the coefficient
mu_roll of a guide, N per N, or mu_roll D/2 of a ring, Nm per N.

mu may differ with who drives: mu_d where the motor does (F_m u > 0), mu_b where the load does
(F_m u < 0). For a gear or screw of efficiencies eta_d and eta_b the loss is the part of what comes
in that does not go out, in terms of the motor's force

    mu_d = 1 - eta_d,    mu_b = (1 - eta_b) / eta_b,

exactly so at constant speed; F_m includes what speeds up the motor's own rotor, which no mesh
carries. Source: G. Niemann, H. Winter, Maschinenelemente II, Springer 2003 (efficiency of screws
and worm gears in both directions).

**Presliding** (stiffness sigma_0 > 0) turns a friction into the model of LuGre instead,

    z' = u - sigma_0 |u| / R(u) z,    F = sigma_0 z + sigma_1 z',

with the deflection z of the bristles: a spring before it slides, hysteresis in between, and R in
steady sliding, so R is also what Stribeck and viscous parts belong in. Its limit at rest is R(0)
(`breakaway` has no meaning for it). The step is linear in the mean speed u: with the rate
l = sigma_0 |u_p| / R at the speed u_p expected from the last step, z' = u - l z is solved exactly,

    mean of z = z_0 p + u (1 - p) / l,    p = (1 - exp(-l h)) / (l h),

so that no stiffness and no speed makes it unstable. Second order in h while u_p is.

Source: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, A new model for control of
systems with friction, IEEE Trans. Automatic Control 40 (1995). Limits: F_m and P are those expected in
the middle of the step; LuGre drifts under a vibrating force below breakaway, which real contacts do
less; with sigma_1 large it is not passive at a reversal.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled
from waferbot_plant.bearing_loads import bearing_load
from waferbot_plant.elements import MOST_LOADS, resistance_at
from waferbot_plant.motors import NONE, force_and_damping


def parameter_fields(frictions: int) -> list[tuple]:
    """
    Return the dtype fields; zero is without effect, in each of them.

    In the order of the equation: b (N or Nm at 1 m/s or rad/s), p (-), mu_d (-), mu_b - mu_d (-),
    A (-), k (rad per m or rad of x), phase (rad), C (-), 1 / tau (1/s), a (-); sigma_0 in N/m or
    Nm/rad, sigma_1 in N s/m or Nm s/rad. Of a map, the number of rows (1 for a table) and their loads,
    N or Nm.
    """
    names = (
        'drag', 'drag_exponent', 'per_motor_force', 'more_when_driven',
        'position_amplitude', 'position_wave', 'position_phase', 'cold_amplitude',
        'cold_rate', 'asymmetry', 'bristle_stiffness', 'bristle_damping',
    )  # fmt: skip
    return [
        *((f'friction_{name}', 'f8', (frictions,)) for name in names),
        ('friction_loads', 'i8', (frictions,)),
        ('friction_load', 'f8', (frictions, MOST_LOADS)),
    ]


def state_fields(frictions: int, coordinates: int) -> list[tuple]:
    """
    Return the dtype fields: bristles' deflection (m, rad) and the workings of a step.

    A tilt is what the limit of friction is higher forward and lower backward, N or Nm.
    """
    return [
        ('any_friction_law', 'i8'),
        ('friction_tilt_now', 'f8', (frictions,)),
        ('sliding_tilt', 'f8', (coordinates,)),
        ('holding_tilt', 'f8', (coordinates,)),
        ('bristle', 'f8', (frictions,)),
        ('bristle_rate', 'f8', (frictions,)),
        ('bristle_force', 'f8', (frictions,)),
        ('bristle_slope', 'f8', (frictions,)),
    ]


@compiled
def find_friction_laws(s, p):
    """Find whether any friction is more than its table; forget tilts when none is any more."""
    found = False
    for friction in range(p['frictions']):
        found |= (
            (p['friction_drag'][friction] != 0.0)
            | (p['friction_per_motor_force'][friction] != 0.0)
            | (p['friction_more_when_driven'][friction] != 0.0)
            | (p['friction_position_amplitude'][friction] != 0.0)
            | (p['friction_cold_amplitude'][friction] != 0.0)
            | (p['friction_asymmetry'][friction] != 0.0)
            | (p['friction_bristle_stiffness'][friction] != 0.0)
            | (p['friction_loads'][friction] > 1)
            | (p['friction_bearing'][friction] != 0)
        )
    if s['any_friction_law'] and not found:
        for row in range(p['coordinates']):
            s['sliding_tilt'][row] = s['holding_tilt'][row] = 0.0
    s['any_friction_law'] = found


@compiled
def _factor(s, p, friction, place, time):
    """Return by what position and cold multiply a friction; `place` is x in m or rad."""
    factor = 1.0
    if p['friction_position_amplitude'][friction] != 0.0:
        angle = p['friction_position_wave'][friction] * place
        wave = math.cos(angle - p['friction_position_phase'][friction])
        factor = max(0.0, 1.0 + p['friction_position_amplitude'][friction] * wave)
    if p['friction_cold_amplitude'][friction] != 0.0:
        cold = math.exp(-time * p['friction_cold_rate'][friction])
        factor *= 1.0 + p['friction_cold_amplitude'][friction] * cold
    return factor


@compiled
def by_motor_force(p, friction):
    """Return whether a friction depends on F_m: in proportion, or by a map over loads."""
    return (
        (p['friction_per_motor_force'][friction] != 0.0)
        | (p['friction_more_when_driven'][friction] != 0.0)
        | (p['friction_loads'][friction] > 1)
    )


@compiled
def _motor_force(s, p, friction, mean):
    """
    Return F_m, N or Nm on x; zero where the friction does not depend on it.

    A motor with open terminals makes no force. What pushes its coordinate from outside then stands for
    it: that is how a plant is driven by measured currents.
    """
    if not by_motor_force(p, friction):
        return 0.0
    coordinate = p['friction_coordinate'][friction]
    total = 0.0
    outside = 0.0
    for motor in range(len(p['winding'])):
        if p['winding'][motor] != NONE and p['motor_coordinate'][motor] == coordinate:
            if s['terminals_open'][motor]:
                outside = s['external_force'][coordinate]
            ratio = p['motor_ratio'][motor]
            force, damping = force_and_damping(s, p, motor)
            total += ratio * (force - damping * ratio * mean[coordinate])
    return (total + outside) / p['friction_ratio'][friction]


@compiled
def _load_part(p, friction, force):
    """
    Return what the motors' force F_m adds to the table, N or Nm on x: the mean of both directions, and
    by how much the limit is higher in the positive direction of x than that.
    """
    share = p['friction_per_motor_force'][friction]
    more = 0.5 * p['friction_more_when_driven'][friction]
    if share == 0.0 and more == 0.0:
        return 0.0, 0.0
    return (share + more) * abs(force), -more * force


@compiled
def _load(s, p, friction, force, middle, mean):
    """Return the load of a map, N or Nm: |F_m|, or what the bearing bears; and what the latter adds."""
    if p['friction_bearing'][friction] == 0:
        return abs(force), 0.0
    borne = bearing_load(s, p, friction, middle, mean)
    return borne, p['friction_per_load'][friction] * borne


@compiled
def table_part(p, friction, speed, load):
    """Return T, N or Nm on x, at a speed |u| and a load |F_m| or P of zero or more."""
    last = p['friction_loads'][friction] - 1
    row = 0
    while row < last and load >= p['friction_load'][friction, row + 1]:
        row += 1
    below = resistance_at(p, friction, row, speed)
    if row == last:
        return below
    low = p['friction_load'][friction, row]
    rise = resistance_at(p, friction, row + 1, speed) - below
    return below + rise * (load - low) / (p['friction_load'][friction, row + 1] - low)


@compiled
def _moving_part(p, friction, speed, load):
    """Return T + b |u|^p, N or Nm on x, at a speed |u| and a load |F_m| or P of zero or more."""
    found = table_part(p, friction, speed, load)
    if p['friction_drag'][friction] != 0.0:
        found += p['friction_drag'][friction] * speed ** p['friction_drag_exponent'][friction]
    return found


@compiled
def limit_lawful_friction(s, p, middle, mean, step):
    """
    Do what `limit_friction` does, with the laws: strengths of sliding and holding, and tilts.

    `middle` and `mean` (n,) are positions and speeds expected in the middle of the step.
    """
    time = (s['steps'] + 0.5) * step
    for row in range(p['coordinates']):
        s['sliding_friction'][row] = s['holding_friction'][row] = 0.0
        s['sliding_tilt'][row] = s['holding_tilt'][row] = 0.0
    for friction in range(p['frictions']):
        s['friction_now'][friction] = s['friction_tilt_now'][friction] = 0.0
        if p['friction_bristle_stiffness'][friction] != 0.0:
            continue
        row = p['friction_coordinate'][friction]
        ratio = abs(p['friction_ratio'][friction])
        if ratio == 0.0:
            continue
        factor = ratio * _factor(s, p, friction, p['friction_ratio'][friction] * middle[row], time)
        force = _motor_force(s, p, friction, mean)
        load, uneven = _load_part(p, friction, force)
        borne, rolling = _load(s, p, friction, force, middle, mean)
        load += rolling
        tilt = p['friction_asymmetry'][friction]
        if p['friction_ratio'][friction] < 0.0:
            tilt, uneven = -tilt, -uneven
        # (even + uneven sign) (1 + tilt sign), in even and odd parts.
        uneven *= factor
        even = factor * (_moving_part(p, friction, ratio * abs(mean[row]), borne) + load)
        moving, odd = even + tilt * uneven, tilt * even + uneven
        breakaway = p['friction_breakaway'][friction]
        even = factor * (table_part(p, friction, 0.0, borne) + load) * breakaway
        uneven *= breakaway
        s['friction_now'][friction] = moving
        s['friction_tilt_now'][friction] = odd
        s['sliding_friction'][row] += moving
        s['holding_friction'][row] += even + tilt * uneven
        s['sliding_tilt'][row] += odd
        s['holding_tilt'][row] += tilt * even + uneven


@compiled
def add_presliding(s, p, matrix, right, middle, mean, velocity, step):
    """Put the frictions with bristles into A and r, as -(c_0 + c_1 u) with the mean speed u."""
    time = (s['steps'] + 0.5) * step
    for friction in range(p['frictions']):
        stiffness = p['friction_bristle_stiffness'][friction]
        if stiffness == 0.0:
            continue
        row = p['friction_coordinate'][friction]
        ratio = p['friction_ratio'][friction]
        speed = ratio * mean[row]
        force = _motor_force(s, p, friction, mean)
        load, uneven = _load_part(p, friction, force)
        borne, rolling = _load(s, p, friction, force, middle, mean)
        limit = _moving_part(p, friction, abs(speed), borne) + load + rolling
        limit += uneven if speed >= 0.0 else -uneven
        limit *= _factor(s, p, friction, ratio * middle[row], time)
        tilt = p['friction_asymmetry'][friction]
        limit *= 1.0 + tilt if speed >= 0.0 else 1.0 - tilt
        s['bristle_force'][friction] = s['bristle_slope'][friction] = 0.0
        s['bristle_rate'][friction] = -1.0
        if limit <= 0.0:
            continue
        damping = p['friction_bristle_damping'][friction]
        rate = stiffness * abs(speed) / limit
        kept, gained = _bristle_means(rate, step)
        s['bristle_rate'][friction] = rate
        s['bristle_force'][friction] = (stiffness - damping * rate) * kept * s['bristle'][friction]
        slope = (stiffness - damping * rate) * gained + damping
        s['bristle_slope'][friction] = slope
        right[row] -= step * ratio * (s['bristle_force'][friction] + slope * ratio * velocity[row])
        matrix[row, row] += 0.5 * step * slope * ratio * ratio


@compiled
def _bristle_means(rate, step):
    """Return p and (1 - p) / rate with p = (1 - exp(-x)) / x, x = rate h; a series where x is small."""
    x = rate * step
    if x < 1e-2:
        lost = 0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0)))
        return 1.0 - x * lost, step * lost
    kept = -math.expm1(-x) / x
    return kept, (1.0 - kept) / rate


@compiled
def book_presliding(s, p, mean, step):
    """Move the bristles on, and book their loss: work put in less what is stored in them, J."""
    for friction in range(p['frictions']):
        stiffness = p['friction_bristle_stiffness'][friction]
        if stiffness == 0.0:
            continue
        speed = p['friction_ratio'][friction] * mean[p['friction_coordinate'][friction]]
        force = s['bristle_force'][friction] + s['bristle_slope'][friction] * speed
        before = s['bristle'][friction]
        after = 0.0
        if s['bristle_rate'][friction] >= 0.0:
            kept, gained = _bristle_means(s['bristle_rate'][friction], step)
            held = kept * before + gained * speed
            after = before + step * (speed - s['bristle_rate'][friction] * held)
        s['bristle'][friction] = after
        stored = 0.5 * stiffness * (after * after - before * before)
        s['friction_loss'][friction] += force * speed * step - stored


@compiled
def book_lawful_frictions(s, p, mean, step):
    """Do what `book_frictions` does, with shares that follow the direction."""
    for friction in range(p['frictions']):
        row = p['friction_coordinate'][friction]
        direction = 1.0 if mean[row] > 0.0 else -1.0
        share = s['friction_now'][friction] + direction * s['friction_tilt_now'][friction]
        total = s['sliding_friction'][row] + direction * s['sliding_tilt'][row]
        if total > 0.0:
            loss = -s['friction_force'][row] * mean[row] * step
            s['friction_loss'][friction] += loss * share / total


@compiled
def stored_in_bristles(s, p):
    """Return the energy sigma_0 z^2 / 2 in all bristles, J."""
    energy = 0.0
    for friction in range(p['frictions']):
        z = s['bristle'][friction]
        energy += 0.5 * p['friction_bristle_stiffness'][friction] * z * z
    return energy
