# SPDX-License-Identifier: Apache-2.0
"""
The I-variables of a motor, declared once, and the array in which the servo reads them.

`Ixx30` stands for I130 on motor 1, I230 on motor 2 and so on; motor 1 is `y_linear`, 2 `x_rotate`,
3 `y_rotate`. Meaning, range and default are those of the Turbo PMAC Software Reference, except
that

- Ixx03 and Ixx04 hold the place of an encoder among those of the machine (on the shipped one 0
  `y_linear`, 1 `x_rotate`, 2 `y_rotate_load`, 3 `y_rotate_motor`), where the controller holds the
  address of an entry of its encoder conversion table;
- `feedback_filter` stands for the exponential filter of that table;
- `command_delay` is what the way from the servo's result to the amplifier takes beyond the usual:
  no setting of the controller, but of the ring and the amplifier's interface;
- `counts_per_unit` stands for the controller's axis definition statement, and
  `amplifier_peak_current` for the scaling of the amplifier's command (thesis, chapter 3:
  "transconductance").
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from waferbot_lockstep.errors import UserError
from waferbot_lockstep.layout import MOST_AXES, SHIPPED, Layout
from waferbot_lockstep.parameters import Parameter, check_settings, check_value

LARGEST_24_BIT = 2**23 - 1
SMALLEST_24_BIT = -(2**23)
NOTCH_FRACTIONAL_BITS = 22
LONGEST_COMMAND_DELAY = 8


def _whole(
    name: str,
    default: int,
    unit: str,
    low: int,
    high: int,
    description: str,
    *,
    fixed: bool = False,
) -> Parameter:
    return Parameter(name, default, unit, low, high, description, integer=True, fixed=fixed)


def _real(
    name: str, default: float, unit: str, low: float, high: float, description: str
) -> Parameter:
    return Parameter(name, default, unit, low, high, description)


def _gain(name: str, default: int, description: str, low: int = SMALLEST_24_BIT) -> Parameter:
    return _whole(name, default, '', low, LARGEST_24_BIT, description)


def _notch(name: str, symbol: str) -> Parameter:
    return _real(
        name,
        0.0,
        '',
        -2.0,
        2.0 - 2.0**-NOTCH_FRACTIONAL_BITS,
        f'Notch coefficient {symbol} of (1 + N1/z + N2/z^2) / (1 + D1/z + D2/z^2), '
        'held with 22 fractional bits',
    )


I_VARIABLES: tuple[Parameter, ...] = (
    _whole('Ixx03', 0, '', 0, 3, 'Position loop feedback: place of the encoder', fixed=True),
    _whole('Ixx04', 0, '', 0, 3, 'Velocity loop feedback: place of the encoder', fixed=True),
    _whole(
        'Ixx07',
        96,
        '',
        SMALLEST_24_BIT,
        LARGEST_24_BIT,
        'Master scale factor of position following; without effect, there is no master here',
    ),
    _whole('Ixx08', 96, '', 1, LARGEST_24_BIT, 'Position scale factor', fixed=True),
    _whole('Ixx09', 96, '', 0, LARGEST_24_BIT, 'Velocity loop scale factor', fixed=True),
    _whole(
        'Ixx11',
        32000,
        '1/16 count',
        0,
        LARGEST_24_BIT,
        'Fatal following error: the motor is killed above it; 0 switches the check off',
    ),
    _whole(
        'Ixx12',
        16000,
        '1/16 count',
        0,
        LARGEST_24_BIT,
        'Warning following error: a flag is set above it; 0 switches the check off',
    ),
    _real('Ixx15', 0.25, 'counts/ms^2', 1e-9, 1e6, 'Deceleration after an abort'),
    _real('Ixx16', 32.0, 'counts/ms', 1e-6, 1e6, 'Maximum velocity of programmed moves'),
    _real('Ixx17', 0.5, 'counts/ms^2', 1e-9, 1e6, 'Maximum acceleration of LINEAR moves'),
    _real('Ixx19', 0.15625, 'counts/ms^2', 1e-9, 1e6, 'Maximum acceleration of jog and RAPID'),
    _whole('Ixx20', 0, 'ms', 0, LARGEST_24_BIT, 'Acceleration time of jog and RAPID moves'),
    _whole('Ixx21', 50, 'ms', 0, LARGEST_24_BIT, 'S-curve time of jog and RAPID moves'),
    _real('Ixx22', 32.0, 'counts/ms', 1e-6, 1e6, 'Jog speed'),
    _whole(
        'Ixx24',
        0,
        '',
        0,
        2**24 - 1,
        'Flag mode. Bits 22-21 say whom a fault of this motor kills: 0 and 1 all motors (all are '
        'in one coordinate system here), 2 and 3 only this one; other bits are without effect',
    ),
    _whole('Ixx28', 160, '1/16 count', 0, LARGEST_24_BIT, 'In-position band'),
    _whole('Ixx29', 0, 'DAC bits', -32768, 32767, 'Bias added to the output'),
    _gain('Ixx30', 2000, 'Proportional gain, in Ixx08/2^19 DAC bits/count'),
    _gain('Ixx31', 1280, 'Derivative gain, in Ixx30*Ixx09/2^26 DAC bits/(count/cycle)'),
    _gain('Ixx32', 1280, 'Velocity feedforward, in Ixx30*Ixx08/2^26 DAC bits/(count/cycle)'),
    _gain(
        'Ixx33',
        0,
        'Integral gain, in Ixx30*Ixx08/2^42 DAC bits/(count*cycle); '
        '0 stops the input of the integrator and keeps its output',
        low=0,
    ),
    _whole(
        'Ixx34',
        1,
        '',
        0,
        1,
        'Integration mode: 0 always, 1 only while the commanded velocity is zero',
    ),
    _gain('Ixx35', 0, 'Acceleration feedforward, in Ixx30*Ixx08/2^26 DAC bits/(count/cycle^2)'),
    _notch('Ixx36', 'N1'),
    _notch('Ixx37', 'N2'),
    _notch('Ixx38', 'D1'),
    _notch('Ixx39', 'D2'),
    _whole(
        'Ixx57',
        0,
        'DAC bits',
        -32768,
        32767,
        'Continuous current limit of the I2T protection; negative selects |I|T',
    ),
    _whole(
        'Ixx58',
        0,
        '(32768 DAC bits)^2*cycles',
        0,
        LARGEST_24_BIT,
        'Integrated current limit; 0 switches the I2T protection off',
    ),
    _whole('Ixx60', 0, 'servo interrupts', 0, 255, 'Servo cycle period extension', fixed=True),
    _whole(
        'Ixx63',
        4194304,
        '1/16 count',
        SMALLEST_24_BIT,
        LARGEST_24_BIT,
        'Integration limit, as proportional error; 0 clears the integrator; '
        'negative: reaching the limit kills the motor',
    ),
    _whole(
        'Ixx64',
        0,
        '',
        -32768,
        32767,
        'Deadband gain: inside the deadband the gain is (Ixx64 + 16) / 16 times the usual one; '
        '-16 true deadband, 0 off, 16 double gain',
    ),
    _whole('Ixx65', 16, '1/16 count', 0, 32767, 'Deadband size, from zero error to its edge'),
    _whole(
        'Ixx67',
        4194304,
        '1/16 count',
        0,
        LARGEST_24_BIT,
        'Position error limit: the filter sees no larger following error',
    ),
    _whole('Ixx68', 0, 'DAC bits', 0, 32767, 'Friction feedforward'),
    _whole('Ixx69', 20480, 'DAC bits', 0, 32767, 'Output limit'),
    _whole(
        'Ixx96',
        0,
        '',
        0,
        3,
        'Bit 1: integrator inside the velocity loop; bit 0 (output mode) is without effect',
    ),
)
"""The I-variables of one motor, in the order of their numbers."""

MOTOR_SETTINGS: tuple[Parameter, ...] = (
    Parameter(
        'counts_per_unit',
        1.0,
        'counts/m or counts/rad',
        1e-3,
        1e15,
        'Counts of the position encoder per metre or radian of the axis',
        fixed=True,
    ),
    Parameter(
        'amplifier_peak_current',
        40.0,
        'A',
        1e-3,
        1e4,
        'Current that the amplifier makes of 32768 DAC bits, peak of the sine in a line',
        fixed=True,
    ),
    Parameter(
        'feedback_filter',
        0.0,
        'servo interrupts',
        0.0,
        10000.0,
        'Time constant of a first-order low-pass on both feedback encoders; 0: none. Its cut-off is '
        'about the servo rate over 2 pi times it',
        fixed=True,
    ),
    _whole(
        'command_delay',
        0,
        'servo interrupts',
        0,
        LONGEST_COMMAND_DELAY,
        'Servo interrupts from the result of the servo to the command that goes out, beyond none',
        fixed=True,
    ),
)
"""What a controller keeps elsewhere than in I-variables."""

COUNTS_PER_RADIAN = 2**20 / (2.0 * math.pi)

_COUNTS_PER_UNIT = {
    'y_linear': 1e7,
    'x_rotate': COUNTS_PER_RADIAN,
    'y_rotate': COUNTS_PER_RADIAN,
}
"""Of the shipped machine."""

FEEDBACK = ('Ixx03', 'Ixx04')
"""What holds the place of an encoder."""

_USED_AS_INTEGER = ('Ixx03', 'Ixx04', 'Ixx24', 'Ixx34', 'Ixx60', 'Ixx96', 'command_delay')


@lru_cache(maxsize=MOST_AXES)
def servo_parameter_dtype(motors: int) -> np.dtype:
    """
    Return the dtype of all settings of so many motors: fields of shape (motors,), in order of the axes.

    Gains are whole numbers carried as float64; a float64 holds every 24-bit number exactly.
    """
    return np.dtype(
        [
            (parameter.name, 'i8' if parameter.name in _USED_AS_INTEGER else 'f8', (motors,))
            for parameter in I_VARIABLES + MOTOR_SETTINGS
        ],
        align=True,
    )


@lru_cache(maxsize=8 * MOST_AXES)
def axis_parameters(axis: str, layout: Layout = SHIPPED) -> tuple[Parameter, ...]:
    """
    Return the declarations for one axis of a machine, with the defaults of that axis.

    They differ from the factory defaults only where those would be meaningless: encoders of the
    motor (position by that of the load, velocity by that of the motor, if there are both), of which
    there are as many as the machine has, and its counts per unit. Raises `ValueError` for a name that is
    no axis.
    """
    layout.place(axis)
    encoders = [layout.encoder_place(name) for name in layout.encoders_of(axis)]
    defaults: dict[str, int | float] = {'Ixx03': encoders[0], 'Ixx04': encoders[-1]}
    if axis in _COUNTS_PER_UNIT:
        defaults['counts_per_unit'] = _COUNTS_PER_UNIT[axis]
    highest = {name: len(layout.encoders) - 1 for name in FEEDBACK}
    return tuple(
        replace(
            parameter,
            default=defaults.get(parameter.name, parameter.default),
            high=highest.get(parameter.name, parameter.high),
        )
        for parameter in I_VARIABLES + MOTOR_SETTINGS
    )


def servo_parameters(
    settings: Mapping[str, Mapping[str, object]], where: str = '', layout: Layout = SHIPPED
) -> np.ndarray:
    """
    Build the parameters (`servo_parameter_dtype`, shape (1,)) from `{'y_linear': {'Ixx30': 2000}, ...}`.

    What is not given has its default. Raises `UserError`, naming `where`, the axis and the
    setting, for an unknown axis or setting and for a value out of range.
    """
    parameters = np.zeros(1, servo_parameter_dtype(len(layout.axes)))
    prefix = f'{where}: ' if where else ''
    for axis in settings:
        if axis not in layout.axes:
            raise UserError(f'{prefix}{axis!r} is no axis; the axes are {", ".join(layout.axes)}')
    for place, axis in enumerate(layout.axes):
        values = check_settings(
            axis_parameters(axis, layout), settings.get(axis, {}), prefix + axis
        )
        for name, value in values.items():
            parameters[name][0, place] = as_held(name, value)
    return parameters


def change_parameter(
    parameters: np.ndarray,
    axis: str,
    name: str,
    value: object,
    loop_closed: bool,
    layout: Layout = SHIPPED,
) -> None:
    """
    Change one setting of one axis in place, as a command to the running controller does.

    Raises `UserError` for an unknown axis or setting, a value out of range, and a setting that
    cannot change while the loop is closed (`loop_closed`); nothing is changed then.
    """
    if axis not in layout.axes:
        raise UserError(f'{axis!r} is no axis; the axes are {", ".join(layout.axes)}')
    for parameter in axis_parameters(axis, layout):
        if parameter.name == name:
            break
    else:
        raise UserError(f'{axis}: unknown setting {name!r}')
    checked = as_held(name, check_value(parameter, value, axis))
    place = layout.place(axis)
    if parameter.fixed and loop_closed and checked != parameters[name][0, place]:
        raise UserError(
            f'{axis}: {name} cannot change while the loop is closed; stop the run first'
        )
    parameters[name][0, place] = checked


def as_held(name: str, value: int | float) -> int | float:
    """
    Return `value` as the controller's register holds it.

    Notch coefficients are 24-bit numbers with 22 fractional bits, so they are rounded to the
    nearest multiple of 2^-22; everything else is held as given.
    """
    if name in ('Ixx36', 'Ixx37', 'Ixx38', 'Ixx39'):
        return round(value * 2**NOTCH_FRACTIONAL_BITS) / 2**NOTCH_FRACTIONAL_BITS
    return value
