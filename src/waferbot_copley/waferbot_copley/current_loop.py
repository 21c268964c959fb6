# SPDX-License-Identifier: Apache-2.0
"""
The current loop's parts: gains and the limit of the voltage.

The loop of the thesis (Fig. 3.11) turns the error e of a line current into its terminal voltage,

    V = PI(e) * (32 / Vbus) * (Vbus / Ipeak)       PI(e) = s (Cp e + c Ci sum(e))

with the drive's whole-number gains Cp and Ci. The first factor makes a duty cycle that does not
depend on the bus, the second turns it into volts; the bus voltage cancels and only limits. The
integer scaling s (V) and c (-) of the gains is not published; see the settings `gain_scale` and
`integral_scale`. In ohms the gains are

    Kp = 32 s Cp / Ipeak       Ki = c 32 s Ci / Ipeak per tick

and C(z) = Kp + Ki / (z - 1): the sum holds the errors up to the tick before.

When the voltage is limited by a factor f < 1, the integrator follows what was really put out
(back-calculation): it additionally moves by (Ki / Kp) (f - 1) PI. It then never holds more than
the limit allows and leaves it as soon as the error calls for less. The drive's own rule is not
published.

Voltages are averages over the switching period of the pulse-width modulation.

Two imperfections of the bridge, both off by default:

- While both switches of a leg are off (dead time), its terminal goes with the current: it loses
  V_d = t_dead f_switch Vbus on average, against the sign of the current; near zero current in
  proportion to it, as the ripple crosses zero and the capacitances of the switches take over. The
  voltage is held over a tick, so V_d over that current has to stay below L f_loop.
- Behind the bus is a supply of resistance R. With P the power that the motor drew in the tick
  before, Vbus = V0 - R P / Vbus, so Vbus = (V0 + sqrt(V0^2 - 4 R P)) / 2. A braking motor (P < 0)
  lifts the bus; there is no brake resistor. Losses of the bridge are not in P. Each amplifier has a
  supply of its own. Without a voltage limit the loop may ask for more than any bus can give, and P
  is then as unreal as the voltage: set one together with R.

Source of the first: S.-G. Jeong, M.-H. Park, The analysis and compensation of dead-time effects in
PWM inverters, IEEE Transactions on Industrial Electronics 38(2), 1991.
"""

from __future__ import annotations

import math

from waferbot_copley.commutation import amplitude_squared
from waferbot_lockstep.compiled import compiled

DUTY_SCALE = 32.0

PER_PHASE, FIELD_ORIENTED = 0, 1
"""Values of the setting `mode`."""

UNLIMITED, CIRCULAR, HEXAGONAL = 0, 1, 2
"""Values of the setting `voltage_limit`."""


def gains_from_motor(
    resistance_line_to_line: float,
    inductance_line_to_line: float,
    *,
    bandwidth_hz: float = 1500.0,
    peak_current: float,
    gain_scale: float,
    integral_scale: float,
    current_loop_hz: float = 18000.0,
) -> tuple[int, int]:
    """
    Return whole-number gains (Cp, Ci) for a motor, from its catalogue data between two lines.

    Kp = 2 pi f L puts the loop's unity gain near the frequency f, Ki = Kp R / (L f_loop) per tick
    puts the zero of the controller on the pole of the motor. L and R are those of one branch of
    the (equivalent) star: half of the values between lines, for wye and delta alike. At 18 kHz and
    1.5 kHz the phase margin is about 75 degrees, 45 with one tick of update delay.
    Ohms, henries, hertz, amperes; `gain_scale` in volts. The rounding to whole numbers is the only
    error.
    """
    resistance, inductance = resistance_line_to_line / 2.0, inductance_line_to_line / 2.0
    ohms_per_step = DUTY_SCALE * gain_scale / peak_current
    proportional = 2.0 * math.pi * bandwidth_hz * inductance
    integral = proportional * resistance / (inductance * current_loop_hz)
    return round(proportional / ohms_per_step), round(integral / (integral_scale * ohms_per_step))


@compiled
def voltage_factor(voltage_1, voltage_2, bus_voltage, limit):
    """
    Return the factor 0 < f <= 1 that brings a voltage vector within what the bus can give.

    Lines 1 and 2 in V, of three that sum to zero; the vector keeps its direction. CIRCULAR: the
    amplitude stays within Vbus / sqrt(3), the largest sine of space-vector modulation. HEXAGONAL:
    the largest line-to-line voltage stays within Vbus, which reaches 2/3 Vbus in the six corners.
    UNLIMITED: 1, as in the thesis.
    """
    if limit == CIRCULAR:
        largest_squared = 3.0 * amplitude_squared(voltage_1, voltage_2)
        if largest_squared > bus_voltage * bus_voltage:
            return bus_voltage / math.sqrt(largest_squared)
    elif limit == HEXAGONAL:
        voltage_3 = -(voltage_1 + voltage_2)
        largest = max(
            abs(voltage_1 - voltage_2), abs(voltage_2 - voltage_3), abs(voltage_3 - voltage_1)
        )
        if largest > bus_voltage:
            return bus_voltage / largest
    return 1.0


@compiled
def dead_time_loss(current, voltage, full_current):
    """
    Return the voltage (V) that a terminal loses with `current` (A) flowing out of it.

    `voltage` times the sign of the current, in proportion to it within +-`full_current`.
    """
    return voltage * min(max(current / full_current, -1.0), 1.0)


@compiled
def loaded_bus(voltage, resistance, power):
    """
    Return the bus voltage (V) under a load of `power` (W), of the supply's open `voltage`.

    The upper root of V = V0 - R P / V; V0 / 2 where the load is more than the supply can give,
    V0^2 / (4 R).
    """
    return 0.5 * (voltage + math.sqrt(max(voltage * voltage - 4.0 * resistance * power, 0.0)))


@compiled
def common_mode(voltage_1, voltage_2, voltage_3):
    """
    Return the voltage that space-vector modulation adds to all three terminals, in V.

    It centres the highest and the lowest terminal about the middle of the bus, so that no terminal
    leaves +-Vbus/2 while the line-to-line voltages stay within Vbus. The motor does not see it.
    """
    highest = max(voltage_1, voltage_2, voltage_3)
    lowest = min(voltage_1, voltage_2, voltage_3)
    return -0.5 * (highest + lowest)
