# SPDX-License-Identifier: Apache-2.0
"""
The mathematical plant driven by voltages: Appendix B's equations with the motors of chapter 3.

    q'' = M(q)^-1 (Q - h(q, q'))        Q by (2.30) to (2.34) from the motors' forces
    L di_w/dt = u_w - R i_w - k s_w v    force = sum of k s_w i_w        (3.4) to (3.15)

State of a step: q, q' (3,), winding currents (3, 3). Integrated by the classical Runge-Kutta method of
fourth order over a tick with the voltages held, so that neither the equations nor the way they are
solved are those of the multibody plant. Electrical energy, copper loss and work from outside are
integrated with them. Fills the same fields of the plant's state, so sensors and nodes see no difference.

Not in it: anything that gives, rubs or disturbs, imperfect or warming motors (`from_description`).
Stable while the step is short beside L/R and the loops' time constants: 56 us beside 4 ms here.
"""

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_plant.motors import DELTA, NONE, winding_phases

from .dynamics import forward_dynamics, generalised_forces, motor_angle

MOTORS = 3  # of the one machine whose equations these are

_CURRENT = 6
_ENERGY = _CURRENT + 3 * MOTORS
_HEAT = _ENERGY + MOTORS
_WORK = _HEAT + MOTORS
_SIZE = _WORK + 1


@compiled
def advance_lagrange(s, p, voltage, step):
    """Advance state `s` by `step` seconds with the terminal voltages (9,) held."""
    _open_terminals(s, p)
    stages = np.zeros((6, _SIZE))
    start, middle = stages[4], stages[5]
    for place in range(3):
        start[place] = s['position'][place]
        start[3 + place] = s['velocity'][place]
    for motor in range(MOTORS):
        for winding in range(3):
            start[_CURRENT + 3 * motor + winding] = s['winding_current'][motor, winding]
    _slope(s, p, voltage, start, stages[0])
    for stage in range(1, 4):
        share = step if stage == 3 else 0.5 * step
        for place in range(_SIZE):
            middle[place] = start[place] + share * stages[stage - 1, place]
        _slope(s, p, voltage, middle, stages[stage])
    for place in range(_SIZE):
        start[place] += (
            step
            / 6.0
            * (stages[0, place] + 2.0 * (stages[1, place] + stages[2, place]) + stages[3, place])
        )
    for place in range(3):
        s['velocity_change'][place] = start[3 + place] - s['velocity'][place]
        s['position'][place] = start[place]
        s['velocity'][place] = start[3 + place]
    for motor in range(MOTORS):
        for winding in range(3):
            s['winding_current'][motor, winding] = start[_CURRENT + 3 * motor + winding]
        s['electrical_energy'][motor] += start[_ENERGY + motor]
        s['copper_loss'][motor] += start[_HEAT + motor]
    s['external_work'] += start[_WORK]
    s['steps'] += 1


@compiled
def _slope(s, p, voltage, y, slope):
    """Write into `slope` the rates of everything in `y`: positions, speeds, currents, energies."""
    record = p['lagrange']
    force = np.zeros(3)
    total = np.zeros(3)
    for motor in range(MOTORS):
        position, speed = y[motor], y[3 + motor]
        if motor == 2:
            position, speed = motor_angle(position, record), motor_angle(speed, record)
        if p['winding'][motor] != NONE:
            force[motor] = _windings(s, p, motor, voltage, position, speed, y, slope)
    generalised_forces(force, record, total)
    work = 0.0
    for place in range(3):
        slope[place] = y[3 + place]
        total[place] += s['external_force'][place]
        work += s['external_force'][place] * y[3 + place]
    slope[_WORK] = work
    forward_dynamics(y[:3], y[3:6], total, record, slope[3:6])


@compiled
def _windings(s, p, motor, voltage, position, speed, y, slope):
    """Write the rates of a motor's currents and energies; return its force, N or Nm."""
    winding = p['winding'][motor]
    back_emf = p['back_emf'][motor]
    resistance = p['resistance'][motor]
    phases = winding_phases(winding, p['electrical_gain'][motor] * position)
    first = _CURRENT + 3 * motor
    star = 0.0
    if winding != DELTA:  # perfect phases and currents sum to zero, so (3.12) to (3.14) do as well
        star = (voltage[3 * motor] + voltage[3 * motor + 1] + voltage[3 * motor + 2]) / 3.0
    force = heat = power = 0.0
    for place in range(3):
        current = y[first + place]
        across = voltage[3 * motor + place] - star
        if winding == DELTA:
            across = voltage[3 * motor + place] - voltage[3 * motor + (place + 1) % 3]
        emf = back_emf * phases[place] * speed
        if s['terminals_open'][motor]:
            across = emf  # no current but that round a delta, which perfect phases do not drive
        slope[first + place] = (across - resistance * current - emf) / p['inductance'][motor]
        force += back_emf * phases[place] * current
        heat += resistance * current * current
        power += 0.0 if s['terminals_open'][motor] else across * current
    slope[_ENERGY + motor] = power
    slope[_HEAT + motor] = heat
    return force


@compiled
def _open_terminals(s, p):
    """Take the line currents out of motors whose terminals are open; what stays circulates."""
    for motor in range(MOTORS):
        if s['terminals_open'][motor] == 0 or p['winding'][motor] == NONE:
            continue
        current = s['winding_current'][motor]
        circulating = 0.0
        if p['winding'][motor] == DELTA:
            circulating = (current[0] + current[1] + current[2]) / 3.0
        squares = current[0] * current[0] + current[1] * current[1] + current[2] * current[2]
        s['electrical_energy'][motor] -= (
            0.5 * p['inductance'][motor] * (squares - 3.0 * circulating * circulating)
        )
        current[0] = current[1] = current[2] = circulating
