# SPDX-License-Identifier: Apache-2.0
"""
The settings of an amplifier, each declared once, and the parameter array made from them.

A configuration names the axis, then the setting: `{'y_linear': {'peak_current': 40.0, ...}, ...}`;
what it leaves out has the default given here. ROS parameters are called `<axis>.<setting>`.
Currents are the peak of the sine in a line. `fixed` settings can only change while the twin stands
still, because the state of the loop would lose its meaning.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping

import numpy as np

from waferbot_copley import faults, filters
from waferbot_copley.current_loop import DUTY_SCALE
from waferbot_copley.limiter import DRIVE, USER, i2t_setpoint
from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import SHIPPED, Layout
from waferbot_lockstep.parameters import Parameter, Value, check_settings, did_you_mean
from waferbot_lockstep.timing import Timing

SCALAR, EACH_PHASE = 0, 1
"""Values of the setting `limit_order`."""

FILTERS = (1, 2)
FILTER_COEFFICIENTS = ('b0', 'b1', 'b2', 'a1', 'a2')


def _filter_settings(number: int) -> tuple[Parameter, ...]:
    prefix = f'filter_{number}_'
    kinds = 'custom 0, low-pass 1, high-pass 2, notch 3, band-pass 4, disabled 7'
    return (
        Parameter(prefix + 'kind', filters.DISABLED, '', 0, 7,
                  f'Kind of command filter {number}: {kinds}', integer=True),
        Parameter(prefix + 'poles', 2, '', 1, 2,
                  'Poles of a Butterworth low-pass or high-pass', integer=True),
        Parameter(prefix + 'frequency', 1000.0, 'Hz', 0.1, 1e6,
                  'Cutoff, or centre of a notch or band-pass; below half the current loop rate'),
        Parameter(prefix + 'width', 100.0, 'Hz', 0.1, 1e6,
                  'Width of a notch or band-pass between its -3 dB points'),
        *(
            Parameter(prefix + name, default, '', -1e6, 1e6,
                      f'Coefficient {name} of a custom filter; a1 and a2 are added')
            for name, default in zip(FILTER_COEFFICIENTS, filters.PASS_THROUGH, strict=True)
        ),
    )  # fmt: skip


SETTINGS = (
    # Ratings of the drive and limits of the user
    Parameter('peak_current', 40.0, 'A', 0.1, 1000.0,
              'Peak current of the drive; also scales the current loop', fixed=True),
    Parameter('continuous_current', 20.0, 'A', 0.1, 1000.0,
              'Continuous current of the drive, at most the peak current'),
    Parameter('i2t_time', 1.0, 's', 0.001, 1000.0,
              'Time for which the drive allows its peak current'),
    Parameter('user_peak_current', 0.0, 'A', 0.0, 1000.0,
              'Peak current for this motor, at most that of the drive; 0: as the drive'),
    Parameter('user_continuous_current', 0.0, 'A', 0.0, 1000.0,
              'Continuous current for this motor, at most that of the drive; 0: as the drive'),
    Parameter('user_i2t_time', 0.0, 's', 0.0, 1000.0,
              'Time for which this motor allows its peak current; 0: as the drive'),
    Parameter('i2t_fault', 0, '', 0, 1,
              'What happens when I2T runs out: 0 limits to the continuous current, 1 is a fault',
              integer=True),
    # Current loop
    Parameter('bus_voltage', 325.0, 'V', 1.0, 1000.0, 'Direct voltage of the bus'),
    Parameter('bus_resistance', 0.0, 'ohm', 0.0, 10.0,
              'Resistance of the supply behind the bus, which sags with the power of the tick before; '
              'to be used with a voltage_limit'),
    Parameter('bus_feedforward', 0, '', 0, 1,
              'Duty worked out from the bus voltage 0 as set, so that a sag weakens the loop, '
              '1 as it is; no difference without bus_resistance', integer=True),
    Parameter('dead_time_voltage', 0.0, 'V', -100.0, 100.0,
              'Lost at each terminal against the sign of its current, by the dead time of the '
              'bridge; negative: more than made up for'),
    Parameter('dead_time_current', 0.5, 'A', 0.01, 100.0,
              'Current from which the whole dead_time_voltage is lost, in proportion below it; '
              'voltage over current should stay below the inductance times the loop rate'),
    Parameter('proportional_gain', 750, '', 0, 32767, 'Cp, as set in the drive', integer=True),
    Parameter('integral_gain', 300, '', 0, 32767, 'Ci, as set in the drive', integer=True),
    Parameter('gain_scale', 1.0 / 64.0, 'V', 1e-6, 1e3,
              'Worth of one step of Cp: 32 times this, over the peak current, in V/A'),
    Parameter('integral_scale', 0.25, '', 1e-6, 1e3,
              'Worth of one step of Ci per tick, in steps of Cp'),
    Parameter('motor_resistance', 0.0, 'ohm', 0.0, 1000.0,
              'Resistance of the motor from lead to lead, from its data; with it the loop starts at '
              'the voltage that keeps up the present current (0: starts from zero volts)'),
    Parameter('mode', 0, '', 0, 1,
              'Loop: 0 on the line currents (thesis), 1 field-oriented', integer=True, fixed=True),
    Parameter('voltage_limit', 0, '', 0, 2,
              'Limit of the voltage: 0 none (thesis), 1 circular, 2 hexagonal', integer=True),
    Parameter('update_delay', 0, 'ticks', 0, 1,
              'Ticks from the measured current to the voltage that answers it', integer=True,
              fixed=True),
    # Command
    Parameter('current_offset', 0.0, 'A', -1000.0, 1000.0,
              'Added to the command: before the phasing it pushes the axis, after it (see '
              'limit_order) it is a direct current in lines 1 and 2'),
    Parameter('limit_order', EACH_PHASE, '', 0, 1,
              'Offset, filters and limits act 0 on the command before the phasing, 1 on each line '
              'after it (thesis; clips the sine); field-oriented mode always takes 0',
              integer=True, fixed=True),
    *(setting for number in FILTERS for setting in _filter_settings(number)),
    # Commutation
    Parameter('commutation_encoder', 0, '', 0, 3,
              'Encoder that gives the electrical angle, in the order of the encoders topic',
              integer=True, fixed=True),
    Parameter('counts_per_electrical_cycle', 100000.0, 'counts', -1e12, 1e12,
              'Counts of that encoder in one electrical cycle (pole pair or electrical pitch); '
              'negative if it counts against the motor', fixed=True),
    Parameter('commutation_offset', 0.0, 'rad', -math.pi, math.pi,
              'Added to the electrical angle; it is zero at count 0 without it'),
    # Faults
    Parameter('over_current_ratio', 2.0, '', 1.0, 10.0,
              'Line current that is taken for a short circuit, in peak currents of the drive'),
    Parameter('over_voltage', 400.0, 'V', 1.0, 2000.0, 'Bus voltage above which the drive faults'),
    Parameter('under_voltage', 60.0, 'V', 0.0, 1000.0, 'Bus voltage below which the drive faults'),
    Parameter('drive_over_temperature', 70.0, 'degC', 0.0, 200.0,
              'Heat sink temperature above which the drive faults'),
    Parameter('motor_over_temperature', 130.0, 'degC', 0.0, 300.0,
              'Motor temperature above which the drive faults'),
    Parameter('ambient_temperature', 25.0, 'degC', -40.0, 100.0, 'Air about the heat sink'),
    Parameter('bridge_resistance', 0.1, 'ohm', 0.0, 10.0,
              'Resistance of one line of the bridge that stands for its losses'),
    Parameter('heat_sink_resistance', 0.5, 'K/W', 0.0, 10.0,
              'Temperature rise of the heat sink per watt'),
    Parameter('heat_sink_time_constant', 300.0, 's', 0.1, 1e5,
              'Time constant of the heat sink'),
    Parameter('phasing_tolerance', math.pi / 6, 'rad', 0.0, math.pi / 2,
              'Electrical angle by which the Hall sensors may contradict the encoder'),
    Parameter('latched_faults', faults.LATCHED_BY_DEFAULT, '', 0, faults.ALL_FAULTS,
              'Faults that stay until they are reset (bit mask); others go with their cause',
              integer=True),
)  # fmt: skip
"""Every setting of one amplifier."""


@functools.cache
def amplifier_parameter_dtype(axes: int) -> np.dtype:
    """Return the dtype of what one tick of so many amplifiers needs, worked out from the settings."""
    return np.dtype(
        [
            ('tick_s', 'f8'),
            # one place per axis
            ('mode', 'i8', (axes,)),
            ('limit_order', 'i8', (axes,)),
            ('update_delay', 'i8', (axes,)),
            ('commutation_encoder', 'i8', (axes,)),
            ('counts_per_electrical_cycle', 'f8', (axes,)),
            ('commutation_offset_turn', 'f8', (axes,)),
            ('current_offset', 'f8', (axes,)),
            ('filtered', 'u1', (axes,)),  # whether any filter is enabled
            ('filter_coefficients', 'f8', (axes, 2, 5)),  # filter 1 and 2: b0 b1 b2 a1 a2
            ('peak_limit', 'f8', (axes,)),  # A
            ('continuous_limit', 'f8', (axes, 2)),  # A, of the drive and of the user
            ('i2t_setpoint', 'f8', (axes, 2)),  # A^2 s, likewise
            ('i2t_fault', 'u1', (axes,)),
            ('proportional', 'f8', (axes,)),  # V per unit of 32 / Ipeak: s Cp
            ('integral', 'f8', (axes,)),  # per tick: s c Ci
            ('tracking', 'f8', (axes,)),  # Ki / Kp of the back-calculation, at most 1
            ('bus_compensation', 'f8', (axes,)),  # 32 / Vbus
            ('bus_gain', 'f8', (axes,)),  # Vbus / Ipeak
            ('motor_line_resistance', 'f8', (axes,)),  # ohm: half of that from lead to lead
            ('bus_voltage', 'f8', (axes,)),
            ('bus_resistance', 'f8', (axes,)),
            ('bus_feedforward', 'u1', (axes,)),
            ('dead_time_voltage', 'f8', (axes,)),
            ('dead_time_current', 'f8', (axes,)),
            ('voltage_limit', 'i8', (axes,)),
            ('over_current', 'f8', (axes,)),  # A
            ('over_voltage', 'f8', (axes,)),
            ('under_voltage', 'f8', (axes,)),
            ('drive_over_temperature', 'f8', (axes,)),
            ('motor_over_temperature', 'f8', (axes,)),
            ('ambient_temperature', 'f8', (axes,)),
            ('heat_sink_rise', 'f8', (axes,)),  # K per A^2 of amplitude squared, in the long run
            (
                'heat_sink_share',
                'f8',
                (axes,),
            ),  # share of the way to the final temperature in one tick
            ('phasing_tolerance_sine', 'f8', (axes,)),
            ('latched_faults', 'u4', (axes,)),
        ],
        align=True,
    )


def settings_of(axis: str, layout: Layout = SHIPPED) -> tuple[Parameter, ...]:
    """
    Return the settings of one axis of a machine; only those of the commutation encoder differ.

    It is the one on the motor where there are two; it is one of those that there are.
    """
    encoder = layout.encoder_place(layout.encoders_of(axis)[-1])
    last = len(layout.encoders) - 1
    return tuple(
        dataclasses.replace(setting, default=encoder, high=last)
        if setting.name == 'commutation_encoder'
        else setting
        for setting in SETTINGS
    )


def amplifier_parameters(
    settings: Mapping[str, Mapping[str, object]],
    timing: Timing | None = None,
    where: str = 'amplifier',
    layout: Layout = SHIPPED,
) -> np.ndarray:
    """
    Return the parameter array (`amplifier_parameter_dtype`, shape (1,)) of a machine for
    `settings[axis][name]`.

    Axes and settings left out have their defaults; `timing` gives the rate of the current loop.
    Raises `UserError`, beginning with `where` and naming axis and setting, for an unknown name, a
    value out of its range, limits that contradict each other, or an impossible filter.
    """
    timing = timing or Timing()
    for axis in settings:
        if axis not in layout.axes:
            raise UserError(f'{where}: unknown axis {axis!r}{did_you_mean(axis, layout.axes)}')
    parameters = np.zeros(1, amplifier_parameter_dtype(len(layout.axes)))
    parameters['tick_s'] = timing.tick_s
    for index, axis in enumerate(layout.axes):
        place = f'{where}: {axis}'
        values = check_settings(settings_of(axis, layout), settings.get(axis, {}), place)
        for name, value in _parameters_of_axis(values, timing, place).items():
            parameters[name][0, index] = value
    return parameters


def _parameters_of_axis(
    values: Mapping[str, Value], timing: Timing, where: str
) -> dict[str, object]:
    """Return the fields of `amplifier_parameter_dtype` for one axis."""
    names = amplifier_parameter_dtype(1).names or ()
    result: dict[str, object] = {name: values[name] for name in names if name in values}

    peak, bus = values['peak_current'], values['bus_voltage']
    ratings = [_rating(values, '', where), _rating(values, 'user_', where)]
    result['peak_limit'] = ratings[USER][0]
    result['continuous_limit'] = [ratings[DRIVE][1], ratings[USER][1]]
    result['i2t_setpoint'] = [i2t_setpoint(*rating) for rating in ratings]

    proportional = values['gain_scale'] * values['proportional_gain']
    integral = values['gain_scale'] * values['integral_scale'] * values['integral_gain']
    result['proportional'], result['integral'] = proportional, integral
    result['tracking'] = 1.0 if integral >= proportional else integral / proportional
    result['motor_line_resistance'] = values['motor_resistance'] / 2.0
    result['bus_compensation'], result['bus_gain'] = DUTY_SCALE / bus, bus / peak

    if abs(values['counts_per_electrical_cycle']) < 1.0:
        raise UserError(
            f'{where}: counts_per_electrical_cycle is {values["counts_per_electrical_cycle"]:g}; '
            'a motor cannot be commutated with less than one count in an electrical cycle'
        )
    result['commutation_offset_turn'] = values['commutation_offset'] / (2.0 * math.pi)
    sections = [_filter_section(values, number, timing, where) for number in FILTERS]
    result['filter_coefficients'] = sections
    result['filtered'] = any(section != filters.PASS_THROUGH for section in sections)

    result['over_current'] = values['over_current_ratio'] * peak
    # Three lines of amplitude I in resistances R lose 3/2 R I^2.
    result['heat_sink_rise'] = 1.5 * values['bridge_resistance'] * values['heat_sink_resistance']
    result['heat_sink_share'] = -math.expm1(-timing.tick_s / values['heat_sink_time_constant'])
    result['phasing_tolerance_sine'] = math.sin(values['phasing_tolerance'])
    return result


def _rating(values: Mapping[str, Value], owner: str, where: str) -> tuple[float, float, float]:
    """Return peak and continuous current (A) and I2T time (s) of the drive or of the user."""
    peak, continuous, time = (
        values[owner + name] or values[name]
        for name in ('peak_current', 'continuous_current', 'i2t_time')
    )
    if owner and not values[owner + 'continuous_current']:
        continuous = min(continuous, peak)
    for name, value in (('peak_current', peak), ('continuous_current', continuous)):
        if value > values[name]:
            raise UserError(
                f'{where}: {owner}{name} is {value:g} A; '
                f'the rating of the drive is only {values[name]:g} A'
            )
    if continuous > peak:
        raise UserError(
            f'{where}: {owner}continuous_current is {continuous:g} A; '
            f'it must not exceed {owner}peak_current, {peak:g} A'
        )
    return peak, continuous, time


def _filter_section(
    values: Mapping[str, Value], number: int, timing: Timing, where: str
) -> filters.Coefficients:
    """Return the coefficients of command filter 1 or 2."""
    prefix = f'filter_{number}_'
    kind, poles = int(values[prefix + 'kind']), int(values[prefix + 'poles'])
    frequency, width = values[prefix + 'frequency'], values[prefix + 'width']
    rate = timing.current_loop_hz
    if kind == filters.DISABLED:
        return filters.PASS_THROUGH
    if kind == filters.CUSTOM:
        b0, b1, b2, a1, a2 = (values[prefix + name] for name in FILTER_COEFFICIENTS)
        section = (b0, b1, b2, a1, a2)
        if not filters.is_stable(section):
            raise UserError(
                f'{where}: {prefix}a1 = {a1:g}, {prefix}a2 = {a2:g} is an unstable filter; it '
                'needs |a2| < 1 and |a1| < 1 - a2 (the drive adds them; many tools subtract)'
            )
        return section
    if frequency >= rate / 2:
        raise UserError(
            f'{where}: {prefix}frequency is {frequency:g} Hz; it must be below half the rate of '
            f'the current loop, {rate / 2:g} Hz'
        )
    if kind == filters.LOW_PASS:
        return filters.low_pass(frequency, rate, poles)
    if kind == filters.HIGH_PASS:
        return filters.high_pass(frequency, rate, poles)
    if kind not in (filters.NOTCH, filters.BAND_PASS):
        raise UserError(f'{where}: {prefix}kind is {kind}; there is no such kind of filter')
    if width >= rate / 2:
        raise UserError(
            f'{where}: {prefix}width is {width:g} Hz; it must be below half the rate of the '
            f'current loop, {rate / 2:g} Hz'
        )
    design = filters.notch if kind == filters.NOTCH else filters.band_pass
    return design(frequency, width, rate)
