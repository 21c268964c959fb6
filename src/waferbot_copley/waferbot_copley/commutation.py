# SPDX-License-Identifier: Apache-2.0
"""
Commutation: from encoder counts to the currents of three lines, and back.

Eq. (3.1) of the thesis gives the phasing of line k = 1, 2, 3 at the electrical angle theta,

    phasing_k = sin(theta - 2 pi (k - 1) / 3)

A command of amplitude I asks for the line currents I * phasing_k, which with I > 0 drive the axis
forward with the largest force. The electrical angle is zero at encoder position zero and grows
with the counts; one electrical cycle is one pole pair of a rotary motor (the thesis says "poles")
or one electrical pitch of a linear one.

The rotor frame has its q axis along the phasing and its d axis 90 degrees ahead of it:

    i_k = q sin(theta_k) + d cos(theta_k)       theta_k = theta - 2 pi (k - 1) / 3

so q makes force and d does not, and the amplitude of the line currents is sqrt(q^2 + d^2).

Angles are carried in turns, because the counts within one cycle reduce to a turn without rounding
errors that grow with the distance from zero. The sine and cosine are a polynomial of our own: the
C library's differ in the last bit from one processor and version to the next, and results would.
"""

from __future__ import annotations

import math

from waferbot_lockstep.compiled import compiled

HALF_ROOT_3 = math.sqrt(3.0) / 2.0
TWO_OVER_ROOT_3 = 2.0 / math.sqrt(3.0)
TWO_PI = 2.0 * math.pi

# Taylor coefficients 1/n!; within 1/8 turn the first one left out is below 1e-16 of the result.
_SIN_3, _SIN_5, _SIN_7, _SIN_9 = (1 / math.factorial(n) for n in (3, 5, 7, 9))
_SIN_11, _SIN_13, _SIN_15 = (1 / math.factorial(n) for n in (11, 13, 15))
_COS_4, _COS_6, _COS_8, _COS_10 = (1 / math.factorial(n) for n in (4, 6, 8, 10))
_COS_12, _COS_14, _COS_16 = (1 / math.factorial(n) for n in (12, 14, 16))


@compiled
def electrical_turn(counts, counts_per_electrical_cycle, offset_turn):
    """
    Return the electrical angle in turns, 0 <= turn < 1.

    `counts` is the whole-number reading of the encoder that the motor is commutated by,
    `counts_per_electrical_cycle` need not be whole (2^20 counts on 11 pole pairs) and is negative
    for an encoder that counts against the motor; `offset_turn` is added to the angle. Exact to
    rounding for |counts| < 2^53.
    """
    turn = counts / counts_per_electrical_cycle + offset_turn
    turn -= math.floor(turn)
    return turn if turn < 1.0 else 0.0


@compiled
def sine_and_cosine(turn):
    """
    Return (sin, cos) of an angle of `turn` turns, 0 <= turn < 1, to about 2e-16.

    The angle is split into whole quarters and a rest of at most 1/8 turn; the rest goes through
    the Taylor polynomial, the quarters only swap and negate. Additions and multiplications only,
    so the result is the same on every machine with IEEE 754 doubles.
    """
    quarters = math.floor(4.0 * turn + 0.5)
    x = TWO_PI * (turn - 0.25 * quarters)
    y = x * x
    sine = _SIN_11 - y * (_SIN_13 - y * _SIN_15)
    sine = _SIN_3 - y * (_SIN_5 - y * (_SIN_7 - y * (_SIN_9 - y * sine)))
    sine = x - x * y * sine
    cosine = _COS_12 - y * (_COS_14 - y * _COS_16)
    cosine = _COS_4 - y * (_COS_6 - y * (_COS_8 - y * (_COS_10 - y * cosine)))
    cosine = 1.0 - y * (0.5 - y * cosine)
    if quarters == 1:
        return cosine, -sine
    if quarters == 2:
        return -sine, -cosine
    if quarters == 3:
        return -cosine, sine
    return sine, cosine


@compiled
def to_lines(d, q, sine, cosine):
    """Return lines 1 and 2 of the vector (d, q) at the angle whose sine and cosine are given."""
    line_1 = q * sine + d * cosine
    line_2 = HALF_ROOT_3 * (d * sine - q * cosine) - 0.5 * line_1
    return line_1, line_2


@compiled
def to_rotor_frame(line_1, line_2, sine, cosine):
    """
    Return (d, q) of three line quantities that sum to zero, given lines 1 and 2.

    Keeps the amplitude: line currents of peak I come out as a vector of length I.
    """
    quadrature = TWO_OVER_ROOT_3 * (line_2 + 0.5 * line_1)
    return cosine * line_1 + sine * quadrature, sine * line_1 - cosine * quadrature


@compiled
def amplitude_squared(line_1, line_2):
    """Return the squared amplitude, 2/3 of the sum of squares, of three lines that sum to 0."""
    return (4.0 / 3.0) * (line_1 * line_1 + line_1 * line_2 + line_2 * line_2)
