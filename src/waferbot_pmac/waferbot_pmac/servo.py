# SPDX-License-Identifier: Apache-2.0
"""
The servo loop of the Turbo PMAC: from encoder counts and commanded position to current.

The law (Turbo PMAC User Manual, "Actual PID Algorithm"), in 16-bit DAC units and counts:

    CMD(n) = 2^-19 Ixx30 { Ixx08 [ FE(n) + (Ixx32 CV(n) + Ixx35 CA(n)) / 128 + Ixx33 IE(n) / 2^23 ]
                           - Ixx31 Ixx09 AV(n) / 128 }

    FE(n) = CP(n) - AP(n)           following error, position encoder (Ixx03)
    AV(n) = AVP(n) - AVP(n-1)       actual velocity, velocity encoder (Ixx04), counts per cycle
    CV(n) = CP(n) - CP(n-1)         commanded velocity, counts per cycle
    CA(n) = CV(n) - CV(n-1)         commanded acceleration, counts per cycle^2
    IE(n) = FE(0) + ... + FE(n-1)   over the cycles in which integration was active

A cycle is Ixx60 + 1 servo interrupts long. Thesis, Figs. 3.7 to 3.9, is the same loop, simplified.

Registers
---------
As on the controller, position is held in 1 / (32 Ixx08) count and velocity feedback in 1 / (32
Ixx09) count per cycle; `CMD` is then 2^-24 Ixx30 times a sum of such registers. The gains are
24-bit integers, so the sum has whole and binary-fraction parts only, and float64 carries it
exactly while it stays below 2^53 of its smallest unit: positions up to 2^53 / (32 Ixx08) counts
(2.9e12 at Ixx08 = 96), the integrator up to 2^30 registers (3.5e5 counts at Ixx08 = 96). Beyond
that it rounds by one part in 10^16, as the last product by Ixx30 and the notch always do. The
command leaves as a 24-bit word whose upper 16 bits are the DAC units: rounded down to 1/256 DAC
unit.

Order of one cycle
------------------
Read the encoders and filter them (`feedback_filter`); CP, CV, CA; following error and its fatal and
warning limits (Ixx11, Ixx12, and Ixx63 < 0); limit the error (Ixx67); deadband (Ixx64, Ixx65); sum of
P, I, feedforwards and D, times Ixx30; notch (Ixx36-39); friction feedforward (Ixx68), bias (Ixx29)
and `offset` (`compensation`); output limit (Ixx69); integrator for the next cycle; current
protection (Ixx57, Ixx58); current, `command_delay` servo interrupts later.

Filter and delay are off by default. The filter is the exponential one of the encoder conversion
table, run at every servo interrupt,

    y(n) = y(n-1) + (x(n) - y(n-1)) / (1 + tau)

with tau in servo interrupts: at low frequencies a delay by tau, at high ones an attenuation of
1 / (1 + 2 tau). Its result goes on with 5 binary fractions of a count, as the table's entries do. The
delay acts on what leaves the controller, the state reports the servo's result without it; a motor
that is killed is off at once. At the start the delayed command is the first result.

Assumptions where the manuals are silent: the commanded position is rounded to the nearest register
unit; the deadband acts on the error that both the proportional term and the integrator see; fatal
limits are checked on the error before Ixx67; the protections act in the cycle in which they find
their fault, where the controller checks in the background, some milliseconds later.
"""

from __future__ import annotations

import functools

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.layout import MOST_ENCODERS
from waferbot_pmac.i_variables import (
    LONGEST_COMMAND_DELAY,
    servo_parameter_dtype,
    servo_parameters,
)

__all__ = [
    'AMPLIFIER_I2T',
    'FATAL_FOLLOWING_ERROR',
    'INTEGRATOR_ACTIVE',
    'INTEGRATOR_LIMITED',
    'MOTOR_KILLED',
    'MOVING',
    'OUTPUT_LIMITED',
    'WARNING_FOLLOWING_ERROR',
    'initial_state',
    'prime',
    'servo_parameter_dtype',
    'servo_parameters',
    'servo_state_dtype',
    'step',
]

# Bits of `flags`, as in waferbot_msgs/msg/ServoState
OUTPUT_LIMITED = 1
INTEGRATOR_LIMITED = 2
INTEGRATOR_ACTIVE = 4
MOVING = 8
FATAL_FOLLOWING_ERROR = 16
WARNING_FOLLOWING_ERROR = 32
AMPLIFIER_I2T = 64
MOTOR_KILLED = 128

REGISTERS_PER_COUNT = 32  # times Ixx08 or Ixx09
REGISTERS_PER_SIXTEENTH = REGISTERS_PER_COUNT // 16  # times Ixx08, for limits in 1/16 count
VELOCITY_GAIN = 2.0**-7  # of Ixx31, Ixx32 and Ixx35
INTEGRATOR_UNITS = 2.0**23  # integrator register units per position register unit
OUTPUT_GAIN = 2.0**-24  # DAC units per register unit and Ixx30
DAC_RANGE = 32768.0
TABLE_FRACTION = 32.0  # the encoder conversion table has 5 bits below the count
DAC_WORD_FRACTION = 256.0  # the 24-bit command word has 8 bits below the DAC's 16

KILL_SCOPE_SHIFT = 21  # of Ixx24
KILL_SCOPE_MASK = 3
KILL_ONLY_THIS = 2  # and 3
INTEGRATOR_IN_VELOCITY_LOOP = 2  # bit 1 of Ixx96


@functools.cache
def servo_state_dtype(motors: int) -> np.dtype:
    """Return the dtype of what the servo of so many motors remembers: fields of shape (motors, ...)."""
    return np.dtype(
        [
            # what the ServoState message reports
            ('commanded_position', 'f8', (motors,)),  # counts
            ('following_error', 'f8', (motors,)),  # counts, before Ixx67 and the deadband
            ('output', 'f8', (motors,)),  # DAC units, after Ixx69
            ('integrator', 'f8', (motors,)),  # counts, as it enters the proportional gain
            ('flags', 'u1', (motors,)),
            # status beyond the message
            ('in_position', 'u1', (motors,)),  # closed, not moving, and within Ixx28
            ('killed', 'u1', (motors,)),
            ('faults', 'u1', (motors,)),  # latched flags of what killed the motor
            # memory of the law, in register units
            ('previous_command', 'f8', (motors,)),
            ('previous_command_velocity', 'f8', (motors,)),
            ('previous_velocity_feedback', 'f8', (motors,)),
            ('integrator_register', 'f8', (motors,)),  # sum of Ixx33 times error registers
            # notch, DAC units: its input and output one and two cycles ago
            ('notch_input', 'f8', (motors, 2)),
            ('notch_output', 'f8', (motors, 2)),
            ('current_integral', 'f8', (motors,)),  # of the I2T protection, in units of Ixx58
            ('interrupts_to_wait', 'i8', (motors,)),  # until the next cycle of this motor (Ixx60)
            (
                'filtered_feedback',
                'f8',
                (motors, 2),
            ),  # counts: of the position, the velocity encoder
            # DAC units: results that wait to go out, the newest at place 0; none if `delaying` is 0
            ('waiting_output', 'f8', (motors, LONGEST_COMMAND_DELAY)),
            ('delaying', 'u1', (motors,)),
            # DAC units, set from outside before a cycle: what is added to the output beside Ixx29
            ('offset', 'f8', (motors,)),
        ],
        align=True,
    )


def initial_state(parameters: np.ndarray) -> np.ndarray:
    """
    Return a state (`servo_state_dtype`, shape (1,)) with all loops closed at count zero.

    Call `prime` with the first counts before the first `step`. `parameters` is the array that the state
    will be used with.
    """
    motors = len(parameters['Ixx03'][0])
    state = np.zeros(1, servo_state_dtype(motors))
    prime(state, parameters, np.zeros(MOST_ENCODERS, np.int64), np.zeros(motors))
    return state


@compiled
def prime(state, parameters, counts, commanded_position):
    """
    Close all loops at the present counts and commanded position, with no history.

    Commanded and actual velocity start at zero, so the first cycle has no derivative or
    feedforward kick; integrator, notch, faults and current protection are cleared.

    state, parameters: (1,), with places for n motors; counts: int64 (encoders,), places of the
    encoders; commanded_position: float64 (n,), counts of each motor's position encoder.
    """
    s = state[0]
    p = parameters[0]
    for i in range(len(p['Ixx03'])):
        scale = REGISTERS_PER_COUNT * p['Ixx08'][i]
        command = np.floor(commanded_position[i] * scale + 0.5)
        s['previous_command'][i] = command
        s['previous_command_velocity'][i] = 0.0
        s['previous_velocity_feedback'][i] = (
            counts[p['Ixx04'][i]] * REGISTERS_PER_COUNT * p['Ixx09'][i]
        )
        s['integrator_register'][i] = 0.0
        for k in range(2):
            s['notch_input'][i, k] = 0.0
            s['notch_output'][i, k] = 0.0
        s['current_integral'][i] = 0.0
        s['interrupts_to_wait'][i] = 0
        s['filtered_feedback'][i, 0] = counts[p['Ixx03'][i]]
        s['filtered_feedback'][i, 1] = counts[p['Ixx04'][i]]
        s['delaying'][i] = 0
        s['commanded_position'][i] = command / scale
        s['following_error'][i] = command / scale - counts[p['Ixx03'][i]]
        s['output'][i] = 0.0
        s['integrator'][i] = 0.0
        s['flags'][i] = 0
        s['in_position'][i] = 0
        s['killed'][i] = 0
        s['faults'][i] = 0
        s['offset'][i] = 0.0


@compiled
def step(state, parameters, counts, commanded_position, current):
    """
    Run one servo interrupt for all motors.

    state: (1,), with places for n motors, advanced in place. parameters: (1,), likewise.
    counts: int64 (encoders,), newest counts, in the order of the machine's encoders.
    commanded_position: float64 (n,), counts of each motor's position encoder, fractions allowed.
    current: float64 (n,), out, A (peak of the sine in a line), positive drives forward; zero for a
    killed motor. It is the DAC units times `amplifier_peak_current` / 32768.

    A motor is killed by its fatal following error (Ixx11), a full integrator with Ixx63 < 0, or
    the current protection (Ixx58), together with the others if its Ixx24 says so; `prime` closes
    the loops again. A motor in the middle of an extended cycle (Ixx60) holds its output.
    """
    s = state[0]
    p = parameters[0]
    kill_all = False
    for i in range(len(p['Ixx03'])):
        position_counts = _feedback(s, p, i, 0, counts[p['Ixx03'][i]])
        velocity_counts = _feedback(s, p, i, 1, counts[p['Ixx04'][i]])
        if s['interrupts_to_wait'][i] > 0:
            s['interrupts_to_wait'][i] -= 1
        else:
            s['interrupts_to_wait'][i] = p['Ixx60'][i]
            _close_loop(s, p, i, position_counts, velocity_counts, commanded_position[i])
        _protect_amplifier(s, p, i)
        if s['faults'][i] != 0:
            s['killed'][i] = 1
            if (p['Ixx24'][i] >> KILL_SCOPE_SHIFT) & KILL_SCOPE_MASK < KILL_ONLY_THIS:
                kill_all = True
    for i in range(len(p['Ixx03'])):
        if kill_all or s['killed'][i] != 0:
            _kill(s, i)
        current[i] = _delayed_output(s, p, i) * p['amplifier_peak_current'][i] / DAC_RANGE


@compiled
def _feedback(s, p, i, place, counts):
    """Return the counts of an encoder as the loop sees them; place 0 position, 1 velocity."""
    if p['feedback_filter'][i] == 0.0:
        return float(counts)
    filtered = s['filtered_feedback'][i, place]
    filtered += (counts - filtered) / (1.0 + p['feedback_filter'][i])
    s['filtered_feedback'][i, place] = filtered
    return np.floor(filtered * TABLE_FRACTION + 0.5) / TABLE_FRACTION


@compiled
def _delayed_output(s, p, i):
    """Return the command of motor i that goes out now, DAC units, and keep the newest."""
    delay = p['command_delay'][i]
    newest = s['output'][i]
    if delay == 0 or s['killed'][i] != 0:
        s['delaying'][i] = 0
        return newest
    waiting = s['waiting_output'][i]
    if s['delaying'][i] == 0:
        s['delaying'][i] = 1
        for place in range(LONGEST_COMMAND_DELAY):
            waiting[place] = newest
    out = waiting[delay - 1]
    for place in range(LONGEST_COMMAND_DELAY - 1, 0, -1):
        waiting[place] = waiting[place - 1]
    waiting[0] = newest
    return out


@compiled
def _close_loop(s, p, i, position_counts, velocity_counts, commanded_position):
    """
    Run the servo law once for motor i; leaves its command in `s['output'][i]`, DAC units.

    `position_counts` and `velocity_counts` are those of its encoders, with binary fractions.
    """
    scale = REGISTERS_PER_COUNT * p['Ixx08'][i]
    sixteenth = REGISTERS_PER_SIXTEENTH * p['Ixx08'][i]

    command = np.floor(commanded_position * scale + 0.5)
    command_velocity = command - s['previous_command'][i]
    command_acceleration = command_velocity - s['previous_command_velocity'][i]
    velocity_feedback = velocity_counts * REGISTERS_PER_COUNT * p['Ixx09'][i]
    velocity = velocity_feedback - s['previous_velocity_feedback'][i]
    s['previous_command'][i] = command
    s['previous_command_velocity'][i] = command_velocity
    s['previous_velocity_feedback'][i] = velocity_feedback

    following_error = command - position_counts * scale
    s['commanded_position'][i] = command / scale
    s['following_error'][i] = following_error / scale

    flags = 0
    if command_velocity != 0.0:
        flags |= MOVING
    if s['killed'][i] != 0:
        s['flags'][i] = flags
        return
    if p['Ixx12'][i] > 0.0 and abs(following_error) > p['Ixx12'][i] * sixteenth:
        flags |= WARNING_FOLLOWING_ERROR
    if p['Ixx11'][i] > 0.0 and abs(following_error) > p['Ixx11'][i] * sixteenth:
        flags |= FATAL_FOLLOWING_ERROR
    integrator_limit = abs(p['Ixx63'][i]) * sixteenth * INTEGRATOR_UNITS
    integrator = s['integrator_register'][i]
    if integrator_limit == 0.0:
        integrator = 0.0
    elif p['Ixx63'][i] < 0.0 and abs(integrator) >= integrator_limit:
        flags |= FATAL_FOLLOWING_ERROR | INTEGRATOR_LIMITED
    if flags & FATAL_FOLLOWING_ERROR:
        s['faults'][i] = flags & (
            FATAL_FOLLOWING_ERROR | WARNING_FOLLOWING_ERROR | INTEGRATOR_LIMITED
        )
        s['flags'][i] = flags
        return

    s['in_position'][i] = (
        command_velocity == 0.0 and abs(following_error) < p['Ixx28'][i] * sixteenth
    )

    error_limit = p['Ixx67'][i] * sixteenth
    error = min(max(following_error, -error_limit), error_limit)
    error = _deadband(error, p['Ixx65'][i] * sixteenth, p['Ixx64'][i] / 16.0)

    velocity_terms = VELOCITY_GAIN * (
        p['Ixx32'][i] * command_velocity
        + p['Ixx35'][i] * command_acceleration
        - p['Ixx31'][i] * velocity
    )
    total = error + velocity_terms + integrator / INTEGRATOR_UNITS
    filtered = _notch(s, p, i, OUTPUT_GAIN * p['Ixx30'][i] * total)

    output = filtered + p['Ixx29'][i]
    if command_velocity > 0.0:
        output += p['Ixx68'][i]
    elif command_velocity < 0.0:
        output -= p['Ixx68'][i]
    if s['offset'][i] != 0.0:
        output += s['offset'][i]
    limit = p['Ixx69'][i]
    limited = abs(output) >= limit
    if limited:
        flags |= OUTPUT_LIMITED
        output = min(max(output, -limit), limit)
    s['output'][i] = np.floor(output * DAC_WORD_FRACTION) / DAC_WORD_FRACTION

    # Conditional integration: where it is not allowed the stored value is held, not cleared.
    allowed = p['Ixx33'][i] != 0.0 and integrator_limit > 0.0
    if allowed and not limited and (p['Ixx34'][i] == 0 or command_velocity == 0.0):
        if p['Ixx96'][i] & INTEGRATOR_IN_VELOCITY_LOOP:
            integrator += p['Ixx33'][i] * (error + velocity_terms)
        else:
            integrator += p['Ixx33'][i] * error
        flags |= INTEGRATOR_ACTIVE
    integrator = min(max(integrator, -integrator_limit), integrator_limit)
    if integrator_limit > 0.0 and abs(integrator) >= integrator_limit:
        flags |= INTEGRATOR_LIMITED
    s['integrator_register'][i] = integrator
    s['integrator'][i] = integrator / (INTEGRATOR_UNITS * scale)
    s['flags'][i] = flags


@compiled
def _deadband(error, width, gain):
    """
    Return the error with its gain changed by `gain` (Ixx64 / 16) inside +-width.

    Continuous: inside, error * (1 + gain); outside, error + gain * width * sign(error), so that
    the ratio of both tends to one for large errors, as the manual says. Units of `error`.
    """
    if error > width:
        return error + gain * width
    if error < -width:
        return error - gain * width
    return error * (1.0 + gain)


@compiled
def _notch(s, p, i, x):
    """
    Return the notch filter's output for its input x, both in DAC units.

    y(n) = x(n) + N1 x(n-1) + N2 x(n-2) - D1 y(n-1) - D2 y(n-2). The gain at rest is
    (1 + N1 + N2) / (1 + D1 + D2), which Ixx30 has to make up for.
    """
    y = (
        x
        + p['Ixx36'][i] * s['notch_input'][i, 0]
        + p['Ixx37'][i] * s['notch_input'][i, 1]
        - p['Ixx38'][i] * s['notch_output'][i, 0]
        - p['Ixx39'][i] * s['notch_output'][i, 1]
    )
    s['notch_input'][i, 1] = s['notch_input'][i, 0]
    s['notch_input'][i, 0] = x
    s['notch_output'][i, 1] = s['notch_output'][i, 0]
    s['notch_output'][i, 0] = y
    return y


@compiled
def _protect_amplifier(s, p, i):
    """
    Integrate the command of motor i over one servo interrupt, and note a fault above Ixx58.

    With c = command / 32768 and l = Ixx57 / 32768 the integral grows by c^2 - l^2 (Ixx57 >= 0) or
    by |c| - |l| (Ixx57 < 0) each interrupt, never below zero.
    """
    if p['Ixx58'][i] == 0.0:
        s['current_integral'][i] = 0.0
        return
    command = s['output'][i] / DAC_RANGE
    continuous = p['Ixx57'][i] / DAC_RANGE
    if continuous >= 0.0:
        excess = command * command - continuous * continuous
    else:
        excess = abs(command) - abs(continuous)
    integral = max(s['current_integral'][i] + excess, 0.0)
    s['current_integral'][i] = integral
    if integral >= p['Ixx58'][i]:
        s['faults'][i] |= AMPLIFIER_I2T


@compiled
def _kill(s, i):
    """Open the loop of motor i: no output until `prime`; the reason stays in the flags."""
    s['killed'][i] = 1
    s['output'][i] = 0.0
    s['integrator'][i] = 0.0
    s['in_position'][i] = 0
    s['flags'][i] = (s['flags'][i] & MOVING) | s['faults'][i] | MOTOR_KILLED
