# SPDX-License-Identifier: Apache-2.0
"""
Units that a log may be in, and how they become SI.

A table rather than a library of units: half of what stands in motion logs are units that no library
has, because they are a machine's own (counts, DAC bits, counts per servo cycle) or hide a convention
(amperes as root mean square or as peak of the sine). A unit has one quantity, so a unit that does
not fit the kind of a signal is an error here, not a wrong number later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_TURN = 2.0 * math.pi
_DEGREE = math.pi / 180.0
_INCH = 0.0254
_POUND = 0.45359237 * 9.80665  # force: exact by definition of pound and standard gravity


@dataclass(frozen=True)
class Unit:
    """SI value = `factor` * number + `offset`."""

    quantity: str
    factor: float
    offset: float = 0.0


UNITS_IN_LOGS = {
    'm': Unit('length', 1.0),
    'cm': Unit('length', 1e-2),
    'mm': Unit('length', 1e-3),
    'um': Unit('length', 1e-6),
    'nm': Unit('length', 1e-9),
    'inch': Unit('length', _INCH),
    'in': Unit('length', _INCH),
    'rad': Unit('angle', 1.0),
    'mrad': Unit('angle', 1e-3),
    'urad': Unit('angle', 1e-6),
    'deg': Unit('angle', _DEGREE),
    'arcmin': Unit('angle', _DEGREE / 60.0),
    'arcsec': Unit('angle', _DEGREE / 3600.0),
    'rev': Unit('angle', _TURN),
    'turn': Unit('angle', _TURN),
    'm/s': Unit('speed', 1.0),
    'mm/s': Unit('speed', 1e-3),
    'um/s': Unit('speed', 1e-6),
    'in/s': Unit('speed', _INCH),
    'rad/s': Unit('angular speed', 1.0),
    'mrad/s': Unit('angular speed', 1e-3),
    'deg/s': Unit('angular speed', _DEGREE),
    'rev/s': Unit('angular speed', _TURN),
    'turn/s': Unit('angular speed', _TURN),
    'rpm': Unit('angular speed', _TURN / 60.0),
    'A': Unit('current', 1.0),
    'mA': Unit('current', 1e-3),
    'A_rms': Unit('current', math.sqrt(2.0)),
    'mA_rms': Unit('current', 1e-3 * math.sqrt(2.0)),
    'N': Unit('force', 1.0),
    'mN': Unit('force', 1e-3),
    'kN': Unit('force', 1e3),
    'lb': Unit('force', _POUND),
    'kip': Unit('force', 1e3 * _POUND),
    'Nm': Unit('torque', 1.0),
    'mNm': Unit('torque', 1e-3),
    'Ncm': Unit('torque', 1e-2),
    'kNm': Unit('torque', 1e3),
    'oz-in': Unit('torque', _POUND / 16.0 * _INCH),
    'lb-in': Unit('torque', _POUND * _INCH),
    'lb-ft': Unit('torque', _POUND * 12.0 * _INCH),
    'DAC_bits': Unit('share', 1.0 / 32768.0),
    '%': Unit('share', 0.01),
    '1': Unit('share', 1.0),
    'V': Unit('voltage', 1.0),
    'mV': Unit('voltage', 1e-3),
    'degC': Unit('temperature', 1.0),
    'K': Unit('temperature', 1.0, -273.15),
}
"""
Units with a fixed factor. `A_rms` of a sine is its peak over the square root of two; lb and oz are
forces.
"""

COUNT_UNITS = ('counts', 'counts/s', 'counts/servo_cycle')
"""Units whose factor is the machine's: counts of the encoder that belongs to the kind."""

TIME_UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9, 'min': 60.0}
"""Units of a time column, in s; `servo_cycle` comes with its own length."""

SERVO_CYCLE = 'servo_cycle'

_TELLING = (
    (-1.0, 'its sign is the other way round'),
    (60.0 / _TURN, 'as if rpm had been taken for rad/s'),
    (_TURN / 60.0, 'as if rad/s had been taken for rpm'),
    (180.0 / math.pi, 'as if degrees had been taken for radians'),
    (math.pi / 180.0, 'as if radians had been taken for degrees'),
    (_TURN, 'as if radians had been taken for revolutions'),
    (1.0 / _TURN, 'as if revolutions had been taken for radians'),
    (1e3, 'a thousand times too large'),
    (1e-3, 'a thousand times too small'),
    (1e6, 'a million times too large'),
    (1e-6, 'a million times too small'),
    (math.sqrt(2.0), 'as if the peak had been taken for the root mean square'),
    (math.sqrt(0.5), 'as if the root mean square had been taken for the peak'),
)


def explain_factor(factor: float) -> str:
    """Return what a wrong factor of this size usually comes from, or nothing."""
    for known, text in _TELLING:
        if abs(factor / known - 1.0) < 0.03:
            return f' ({text})'
    return ''
