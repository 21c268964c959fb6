# SPDX-License-Identifier: Apache-2.0
"""
The three amplifiers, one tick at a time.

In one tick of the current loop each amplifier measures two line currents (the third follows from
Kirchhoff's first law), looks up the electrical angle, and turns the current command into three
terminal voltages:

    command -> phasing (3.1) -> offset -> filters 1, 2 -> peak and I2T limit (3.2, 3.3)
            -> PI -> 32 / Vbus -> Vbus / Ipeak -> voltage limit -> dead time -> terminals

This is the order of the thesis (Figs. 3.10 to 3.12, `limit_order` 1). With `limit_order` 0, and
always in field-oriented mode, offset, filters and limit act on the command before the phasing, as
in the drive. The loop closes on lines 1 and 2; the voltage of line 3 is minus their sum, which is
what a third equal loop would give, because its error is minus the sum of theirs.

State and parameters are structured arrays of one element, with one place per axis. The axes do not
touch one another: an amplifier per axis, each in its own process, gives the same bits as one for
all three. Inputs of the drive that are not in the lock-step are fields of the state:
`safe_torque_off`, `following_error_input`, `hall_state`, `motor_temperature`.
"""

from __future__ import annotations

import functools

import numpy as np

from waferbot_copley import faults as fault
from waferbot_copley.commutation import (
    amplitude_squared,
    electrical_turn,
    sine_and_cosine,
    to_lines,
    to_rotor_frame,
)
from waferbot_copley.current_loop import (
    FIELD_ORIENTED,
    UNLIMITED,
    common_mode,
    dead_time_loss,
    loaded_bus,
    voltage_factor,
)
from waferbot_copley.filters import filter_sample
from waferbot_copley.limiter import (
    CONTINUOUS_CURRENT,
    DRIVE,
    PEAK_CURRENT,
    USER,
    VOLTAGE,
    accumulate,
    clamp,
    is_limited,
)
from waferbot_copley.settings import SCALAR, amplifier_parameter_dtype
from waferbot_lockstep.compiled import compiled

__all__ = [
    'amplifier_parameter_dtype',
    'amplifier_state_dtype',
    'changed',
    'follow_voltage',
    'initial_state',
    'open_bridges',
    'report',
    'reset_faults',
    'step',
]


@functools.cache
def amplifier_state_dtype(axes: int) -> np.dtype:
    """Return the dtype of what the amplifiers of so many axes remember from tick to tick."""
    return np.dtype(
        [
            # inputs beside the lock-step, one place per axis
            ('safe_torque_off', 'u1', (axes,)),  # 1: gate drive removed
            (
                'following_error_input',
                'u1',
                (axes,),
            ),  # 1: the position loop reports a following error
            ('hall_state', 'u1', (axes,)),  # bit k - 1: Hall sensor of line k; 0: none fitted
            ('motor_temperature', 'f8', (axes,)),  # degC
            # current loop
            ('starting', 'u1', (axes,)),  # 1: the bridge goes on with the next tick
            ('integrator', 'f8', (axes, 2)),  # of lines 1 and 2, or of d and q; V per 32 / Ipeak
            ('filter_memory', 'f8', (axes, 2, 2, 2)),  # axis, line (or command), filter, delay
            ('pending_voltage', 'f8', (axes, 3)),  # V, waits one tick with update_delay 1
            (
                'bus_power',
                'f8',
                (axes,),
            ),  # W into the motor in the last tick, with a soft supply only
            # limits
            ('i2t_accumulator', 'f8', (axes, 2)),  # A^2 s, of the drive and of the user
            ('i2t_limited', 'u1', (axes, 2)),
            ('heat_sink_temperature', 'f8', (axes,)),  # degC
            # what there is to report
            ('faults', 'u4', (axes,)),
            ('limits', 'u1', (axes,)),  # peak and voltage, since the last report
            ('reported_faults', 'u4', (axes,)),
            ('reported_limits', 'u1', (axes,)),
        ],
        align=True,
    )


def initial_state(parameters: np.ndarray) -> np.ndarray:
    """Return the state (`amplifier_state_dtype`, shape (1,)) of cold amplifiers, enabled, at rest."""
    state = np.zeros(1, amplifier_state_dtype(len(parameters['mode'][0])))
    state['starting'] = 1
    state['motor_temperature'] = parameters['ambient_temperature']
    state['heat_sink_temperature'] = parameters['ambient_temperature']
    return state


def reset_faults(state: np.ndarray, axes: int) -> None:
    """Clear the faults of the axes in the mask; a cause that persists is found again."""
    for axis in range(len(state['faults'][0])):
        if axes >> axis & 1:
            state['faults'][0, axis] = 0


@compiled
def step(state, parameters, axes, command, line_currents, counts, voltage):
    """
    Advance the amplifiers whose bit is set in the whole number `axes` by one tick.

    state, parameters  arrays of one element, with places for n axes
    command            float64 (n,): current command in A, peak of the sine, positive forward
    line_currents      float64 (2 n,): measured currents of lines 1 and 2 of each motor in A,
                       positive into the motor
    counts             int64 (encoders,): newest encoder counts
    voltage            float64 (3 n,), out: terminals 1, 2, 3 of each motor in V, against the middle
                       of the bus; places of other axes are left alone

    All inputs must be finite. A bridge that is off (fault or safe torque off) gives zeros; that
    its terminals are then open is for the motor's model to know, from the faults.
    """
    for axis in range(len(parameters[0]['mode'])):
        if axes >> axis & 1:
            _step_axis(state, parameters, axis, command, line_currents, counts, voltage)


@compiled
def _step_axis(state, parameters, axis, command, line_currents, counts, voltage):
    """Advance one amplifier by one tick; arguments as in `step`."""
    s = state[0]
    p = parameters[0]
    current_1 = line_currents[2 * axis]
    current_2 = line_currents[2 * axis + 1]
    counts_of_motor = counts[p['commutation_encoder'][axis]]
    turn = electrical_turn(
        counts_of_motor, p['counts_per_electrical_cycle'][axis], p['commutation_offset_turn'][axis]
    )
    sine, cosine = sine_and_cosine(turn)

    current_squared = amplitude_squared(current_1, current_2)
    _warm_heat_sink(s, p, axis, current_squared)
    limit = _current_limit(s, p, axis, current_squared)
    bus_voltage = p['bus_voltage'][axis]
    if p['bus_resistance'][axis] > 0.0:
        bus_voltage = loaded_bus(bus_voltage, p['bus_resistance'][axis], s['bus_power'][axis])
    _watch(s, p, axis, current_1, current_2, sine, cosine, bus_voltage)
    if s['faults'][axis] & fault.DISABLING:
        _switch_off(s, axis, voltage)
        return

    field_oriented = p['mode'][axis] == FIELD_ORIENTED
    if field_oriented or p['limit_order'][axis] == SCALAR:
        wanted = _condition(s, p, axis, 0, command[axis])
        wanted = _limited(s, axis, wanted, limit, p['peak_limit'][axis])
        wanted_1, wanted_2 = to_lines(0.0, wanted, sine, cosine)
    else:
        wanted = 0.0
        wanted_1, wanted_2 = to_lines(0.0, command[axis], sine, cosine)
        wanted_1 = _condition(s, p, axis, 0, wanted_1)
        wanted_2 = _condition(s, p, axis, 1, wanted_2)
        wanted_3 = -(wanted_1 + wanted_2)
        wanted_1 = _limited(s, axis, wanted_1, limit, p['peak_limit'][axis])
        wanted_2 = _limited(s, axis, wanted_2, limit, p['peak_limit'][axis])
        wanted_3 = _limited(s, axis, wanted_3, limit, p['peak_limit'][axis])
        # Three clipped sines need not sum to zero; a motor without neutral takes only what does.
        common = (wanted_1 + wanted_2 + wanted_3) / 3.0
        wanted_1 -= common
        wanted_2 -= common

    if field_oriented:
        current_d, current_q = to_rotor_frame(current_1, current_2, sine, cosine)
        error_1, error_2 = -current_d, wanted - current_q
    else:
        error_1, error_2 = wanted_1 - current_1, wanted_2 - current_2
    if s['starting'][axis]:
        s['starting'][axis] = 0
        _start(s, p, axis, current_1, current_2, sine, cosine)
    output_1 = p['proportional'][axis] * error_1 + s['integrator'][axis, 0]
    output_2 = p['proportional'][axis] * error_2 + s['integrator'][axis, 1]

    voltage_1 = output_1 * p['bus_compensation'][axis] * p['bus_gain'][axis]
    voltage_2 = output_2 * p['bus_compensation'][axis] * p['bus_gain'][axis]
    if field_oriented:
        voltage_1, voltage_2 = to_lines(voltage_1, voltage_2, sine, cosine)
    if p['bus_resistance'][axis] > 0.0 and not p['bus_feedforward'][axis]:
        sag = bus_voltage / p['bus_voltage'][axis]
        voltage_1 *= sag
        voltage_2 *= sag
    factor = voltage_factor(voltage_1, voltage_2, bus_voltage, p['voltage_limit'][axis])

    s['integrator'][axis, 0] += p['integral'][axis] * error_1
    s['integrator'][axis, 1] += p['integral'][axis] * error_2
    if factor < 1.0:
        s['limits'][axis] |= VOLTAGE
        s['integrator'][axis, 0] += p['tracking'][axis] * (factor - 1.0) * output_1
        s['integrator'][axis, 1] += p['tracking'][axis] * (factor - 1.0) * output_2
        voltage_1 *= factor
        voltage_2 *= factor
    voltage_3 = -(voltage_1 + voltage_2)
    if p['voltage_limit'][axis] != UNLIMITED:
        common = common_mode(voltage_1, voltage_2, voltage_3)
        voltage_1 += common
        voltage_2 += common
        voltage_3 += common
    if p['update_delay'][axis]:
        pending = s['pending_voltage'][axis]
        voltage_1, pending[0] = pending[0], voltage_1
        voltage_2, pending[1] = pending[1], voltage_2
        voltage_3, pending[2] = pending[2], voltage_3
    if p['dead_time_voltage'][axis] != 0.0:
        lost, full = p['dead_time_voltage'][axis], p['dead_time_current'][axis]
        voltage_1 -= dead_time_loss(current_1, lost, full)
        voltage_2 -= dead_time_loss(current_2, lost, full)
        voltage_3 -= dead_time_loss(-(current_1 + current_2), lost, full)
    if p['bus_resistance'][axis] > 0.0:
        s['bus_power'][axis] = (voltage_1 - voltage_3) * current_1 + (
            voltage_2 - voltage_3
        ) * current_2
    voltage[3 * axis] = voltage_1
    voltage[3 * axis + 1] = voltage_2
    voltage[3 * axis + 2] = voltage_3


@compiled
def _warm_heat_sink(s, p, axis, current_squared):
    """Let the heat sink follow ambient + rise * current^2 in degC with its time constant."""
    final = p['ambient_temperature'][axis] + p['heat_sink_rise'][axis] * current_squared
    share = p['heat_sink_share'][axis]
    s['heat_sink_temperature'][axis] += share * (final - s['heat_sink_temperature'][axis])


@compiled
def _current_limit(s, p, axis, current_squared):
    """Advance both I2T accumulators; return the limit of the current that holds now, in A."""
    limit = p['peak_limit'][axis]
    for owner in (DRIVE, USER):
        continuous = p['continuous_limit'][axis, owner]
        accumulator = accumulate(
            s['i2t_accumulator'][axis, owner], current_squared, continuous, p['tick_s']
        )
        limited = is_limited(
            s['i2t_limited'][axis, owner], accumulator, p['i2t_setpoint'][axis, owner]
        )
        s['i2t_accumulator'][axis, owner] = accumulator
        s['i2t_limited'][axis, owner] = limited
        if limited:
            limit = min(limit, continuous)
    return limit


@compiled
def _watch(s, p, axis, current_1, current_2, sine, cosine, bus_voltage):
    """Find the faults of this tick, keep those that latch."""
    highest = max(abs(current_1), abs(current_2), abs(current_1 + current_2))
    found = 0
    if highest > p['over_current'][axis]:
        found |= fault.OVER_CURRENT
    if s['heat_sink_temperature'][axis] > p['drive_over_temperature'][axis]:
        found |= fault.DRIVE_OVER_TEMPERATURE
    if s['motor_temperature'][axis] > p['motor_over_temperature'][axis]:
        found |= fault.MOTOR_OVER_TEMPERATURE
    if bus_voltage > p['over_voltage'][axis]:
        found |= fault.OVER_VOLTAGE
    if bus_voltage < p['under_voltage'][axis]:
        found |= fault.UNDER_VOLTAGE
    if fault.disagrees_with_halls(
        sine, cosine, s['hall_state'][axis], p['phasing_tolerance_sine'][axis]
    ):
        found |= fault.PHASING
    if s['following_error_input'][axis]:
        found |= fault.FOLLOWING_ERROR
    if p['i2t_fault'][axis] and (s['i2t_limited'][axis, DRIVE] or s['i2t_limited'][axis, USER]):
        found |= fault.I2T
    if s['safe_torque_off'][axis]:
        found |= fault.SAFE_TORQUE_OFF
    s['faults'][axis] = found | (s['faults'][axis] & p['latched_faults'][axis])


@compiled
def _start(s, p, axis, current_1, current_2, sine, cosine):
    """
    Begin with the voltage that keeps up the present current: R i in the integrators, no bump.

    A motor without current (or a drive that was not told its resistance) starts from zero volts.
    """
    to_integrator = p['motor_line_resistance'][axis] / (
        p['bus_compensation'][axis] * p['bus_gain'][axis]
    )
    voltage_1 = p['motor_line_resistance'][axis] * current_1
    voltage_2 = p['motor_line_resistance'][axis] * current_2
    if p['mode'][axis] == FIELD_ORIENTED:
        current_1, current_2 = to_rotor_frame(current_1, current_2, sine, cosine)
    s['integrator'][axis, 0] = to_integrator * current_1
    s['integrator'][axis, 1] = to_integrator * current_2
    s['pending_voltage'][axis, 0] = voltage_1
    s['pending_voltage'][axis, 1] = voltage_2
    s['pending_voltage'][axis, 2] = -(voltage_1 + voltage_2)


@compiled
def follow_voltage(state, parameters, counts, error, share):
    """
    Take a share of a voltage that is missing into the integrators: the drive as an observer of another.

    error  float64 (3 n,): terminals of the other drive less those of this one in the last `step`, V;
    what
           is common to the three of a motor is left out
    counts as in `step`

    An integrator never forgets what it began with, nor a small error of its input. Here it does so in
    about 1 / `share` ticks, so that a drive that was met in the middle of its work can be followed.
    """
    s = state[0]
    p = parameters[0]
    for axis in range(len(p['mode'])):
        if s['starting'][axis]:
            continue
        common = (error[3 * axis] + error[3 * axis + 1] + error[3 * axis + 2]) / 3.0
        first, second = error[3 * axis] - common, error[3 * axis + 1] - common
        if p['mode'][axis] == FIELD_ORIENTED:
            turn = electrical_turn(
                counts[p['commutation_encoder'][axis]],
                p['counts_per_electrical_cycle'][axis],
                p['commutation_offset_turn'][axis],
            )
            first, second = to_rotor_frame(first, second, *sine_and_cosine(turn))
        scale = share / (p['bus_compensation'][axis] * p['bus_gain'][axis])
        s['integrator'][axis, 0] += scale * first
        s['integrator'][axis, 1] += scale * second


@compiled
def _switch_off(s, axis, voltage):
    """Put out nothing and forget the past, so that the loop starts afresh when switched on."""
    s['starting'][axis] = 1
    s['integrator'][axis, :] = 0.0
    s['filter_memory'][axis, :, :, :] = 0.0
    s['pending_voltage'][axis, :] = 0.0
    s['bus_power'][axis] = 0.0
    for terminal in range(3):
        voltage[3 * axis + terminal] = 0.0


@compiled
def _condition(s, p, axis, channel, wanted):
    """Add the offset and pass both filters; `channel` picks the filters' memory."""
    wanted += p['current_offset'][axis]
    if p['filtered'][axis]:
        for number in range(2):
            wanted = filter_sample(
                p['filter_coefficients'][axis, number],
                s['filter_memory'][axis, channel, number],
                wanted,
            )
    return wanted


@compiled
def _limited(s, axis, wanted, limit, peak_limit):
    """Return the current held within the limit; note it if that was the peak limit."""
    held = clamp(wanted, limit)
    if held != wanted and limit == peak_limit:
        s['limits'][axis] |= PEAK_CURRENT
    return held


@compiled
def _limits(s, axis):
    """Return the limits to report: peak and voltage since the last report, I2T as it is now."""
    if s['i2t_limited'][axis, DRIVE] or s['i2t_limited'][axis, USER]:
        return s['limits'][axis] | CONTINUOUS_CURRENT
    return s['limits'][axis]


@compiled
def changed(state):
    """
    Return the mask of the axes that have something new to report.

    New is a fault come or gone, I2T run out or recovered, the peak or voltage limit reached. The
    last two may come and go within a few ticks; they count as new only when they were not in the
    last report, and their end waits for the next regular one.
    """
    s = state[0]
    axes = 0
    for axis in range(len(s['faults'])):
        limits, reported = _limits(s, axis), s['reported_limits'][axis]
        if (
            s['faults'][axis] != s['reported_faults'][axis]
            or limits & ~reported
            or (limits ^ reported) & CONTINUOUS_CURRENT
        ):
            axes |= 1 << axis
    return axes


@compiled
def open_bridges(state):
    """
    Return the mask of the axes whose bridge is off (fault, safe torque off).

    The terminals of such a motor float; the zeros that `step` puts out for it are no voltages.
    """
    mask = 0
    for axis in range(len(state[0]['faults'])):
        if state[0]['faults'][axis] & fault.DISABLING:
            mask |= 1 << axis
    return mask


@compiled
def report(state, parameters, axes, accumulator, setpoint, limits, faults):
    """
    Fill the arrays of an `AmplifierState` message for the axes in the mask; begin a new period.

    accumulator, setpoint  float64 (n,) in A^2 s: of the drive or of the user, whichever is nearer
                           to its set point
    limits                 uint8 (n,): peak and voltage limits since the last report, I2T now
    faults                 uint32 (n,): faults that hold now
    """
    s = state[0]
    p = parameters[0]
    for axis in range(len(p['mode'])):
        if not axes >> axis & 1:
            continue
        drive = s['i2t_accumulator'][axis, DRIVE] * p['i2t_setpoint'][axis, USER]
        user = s['i2t_accumulator'][axis, USER] * p['i2t_setpoint'][axis, DRIVE]
        owner = USER if user > drive else DRIVE
        accumulator[axis] = s['i2t_accumulator'][axis, owner]
        setpoint[axis] = p['i2t_setpoint'][axis, owner]
        limits[axis] = _limits(s, axis)
        faults[axis] = s['faults'][axis]
        s['reported_limits'][axis] = limits[axis]
        s['reported_faults'][axis] = s['faults'][axis]
        s['limits'][axis] = 0
