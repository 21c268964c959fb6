# SPDX-License-Identifier: Apache-2.0
"""
From tuning values to I-variables, and back.

Tuning values are the loop's natural frequency wn, damping ratio z, feedforward ratio v and integral
rate k as an ideal rigid axis would have them:

    Ixx30 = 2^19 wn^2 M / (K Ixx08 c Ka)    Ixx31 = 128 (2 z / wn) / Ts
    Ixx32 = v Ixx31                          Ixx33 = 2^23 k Ts

with M the moving mass or inertia, K force or torque at the axis per ampere, c counts per unit, Ka
amperes per DAC unit, Ts the servo cycle. I-variables are whole numbers.

A notch at f with the damping ratios zn (of its zeros) and zd (of its poles), zn / zd deep, is the
bilinear transform of (s^2 + 2 zn w s + w^2) / (s^2 + 2 zd w s + w^2) with w prewarped, so that its
gain at rest is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from waferbot_lockstep.timing import Timing
from waferbot_plant import motors, plant
from waferbot_plant.plant import Machine
from waferbot_pmac.i_variables import as_held

IVariables = dict[str, int | float]


@dataclass(frozen=True)
class Tuning:
    """
    Tuning values of an axis: wn (rad/s), z, v, k (1/s); a notch at `notch_hz` (0: none).

    `notch_depth` is the gain of the notch at its frequency, `notch_width` the damping ratio of its
    poles.
    """

    natural_frequency: float
    damping_ratio: float
    feedforward_ratio: float
    integral_rate: float
    notch_hz: float = 0.0
    notch_depth: float = 0.2
    notch_width: float = 0.5


@dataclass(frozen=True)
class AxisScale:
    """
    What gains are scaled by: moving inertia (kg, kg m2), force at the axis per A, servo cycle (s).

    `place` is that of the axis.
    """

    inertia: float
    force_per_ampere: float
    cycle_s: float
    place: int

    @classmethod
    def of(cls, rigid: Machine, axis: str) -> AxisScale:
        """Return the scale of an axis of a machine in which nothing gives, at home."""
        parameters = rigid.parameters()
        state = rigid.initial_state(parameters)
        size = len(rigid.coordinates)
        mass = np.zeros((size, size))
        plant.mass_matrix(state, parameters, mass)
        motor = rigid.description.motors[axis]
        row, to_axis = rigid.assembly.placing[rigid.description.axes[axis]]
        ratio = rigid.assembly.placing[motor.coordinate][1] / to_axis
        return cls(
            float(mass[row, row]) / to_axis**2,
            motors.force_constant(motor) * abs(ratio),
            cycle_of(rigid.timing),
            rigid.layout.place(axis),
        )


def cycle_of(timing: Timing) -> float:
    """Return the servo cycle, s."""
    return timing.servo_divider * timing.tick_s


def i_variables(tuning: Tuning, scale: AxisScale, base: np.void) -> IVariables:
    """
    Return Ixx30 to Ixx33 and Ixx36 to Ixx39; `base` (a `SERVO_PARAMETERS` record) has the scaling.

    What gain the notch has at rest, Ixx30 makes up for.
    """
    found = loop_gains(tuning, scale, base)
    notch = notch_coefficients(
        tuning.notch_hz, tuning.notch_depth, tuning.notch_width, scale.cycle_s
    )
    return {**found, 'Ixx30': round(found['Ixx30'] / rest_gain(notch)), **notch}


def loop_gains(tuning: Tuning, scale: AxisScale, base: np.void) -> IVariables:
    """Return Ixx30 to Ixx33 as they are without a notch."""
    place = scale.place
    amperes = base['amplifier_peak_current'][place] / 32768.0
    counts = base['Ixx08'][place] * base['counts_per_unit'][place]
    derivative = 128.0 * (2.0 * tuning.damping_ratio / tuning.natural_frequency) / scale.cycle_s
    proportional = 2.0**19 * tuning.natural_frequency**2 * scale.inertia
    return {
        'Ixx30': round(proportional / (scale.force_per_ampere * counts * amperes)),
        'Ixx31': round(derivative),
        'Ixx32': round(tuning.feedforward_ratio * derivative),
        'Ixx33': round(2.0**23 * tuning.integral_rate * scale.cycle_s),
    }


def tuning_of(servo: np.void, scale: AxisScale) -> Tuning:
    """Return the tuning values of an axis' present gains; a notch that is there is not read."""
    place = scale.place
    amperes = servo['amplifier_peak_current'][place] / 32768.0
    counts = servo['Ixx08'][place] * servo['counts_per_unit'][place]
    per_inertia = servo['Ixx30'][place] * scale.force_per_ampere * counts * amperes
    natural = math.sqrt(max(float(per_inertia / scale.inertia), 0.0)) / 2.0**9.5
    derivative = float(servo['Ixx31'][place])
    return Tuning(
        natural,
        0.5 * natural * derivative * scale.cycle_s / 128.0,
        float(servo['Ixx32'][place]) / derivative if derivative else 0.0,
        float(servo['Ixx33'][place]) / (2.0**23 * scale.cycle_s),
    )


def notch_coefficients(
    frequency_hz: float, depth: float, width: float, cycle_s: float
) -> dict[str, float]:
    """
    Return Ixx36 to Ixx39 of a notch: N1, N2, D1, D2 of (1 + N1/z + N2/z^2) / (1 + D1/z + D2/z^2).

    The controller has no gain in front of it. Its zeros and poles are those of the bilinear transform;
    what gain that leaves at rest is for Ixx30 to make up (`rest_gain`). Zeros for 0 Hz: no notch.
    """
    if frequency_hz == 0.0:
        return dict.fromkeys(('Ixx36', 'Ixx37', 'Ixx38', 'Ixx39'), 0.0)
    k = math.tan(math.pi * frequency_hz * cycle_s)

    def section(ratio: float) -> tuple[float, float]:
        first = 1.0 + 2.0 * ratio * k + k * k
        return 2.0 * (k * k - 1.0) / first, (1.0 - 2.0 * ratio * k + k * k) / first

    values = (*section(width * depth), *section(width))
    names = ('Ixx36', 'Ixx37', 'Ixx38', 'Ixx39')
    return {name: float(as_held(name, value)) for name, value in zip(names, values, strict=True)}


def rest_gain(notch: dict[str, float]) -> float:
    """Return the gain of a notch at rest."""
    return (1.0 + notch['Ixx36'] + notch['Ixx37']) / (1.0 + notch['Ixx38'] + notch['Ixx39'])
