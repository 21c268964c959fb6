# SPDX-License-Identifier: Apache-2.0
"""
P, PI, PID on position, and a cascade of position and velocity loop: one cycle at a time.

Once in T = 1 / rate the controller takes the commanded position r and the measured one y, m or rad. With
e = r - y and backward differences, for example v_r(n) = (r(n) - r(n-1)) / T and a_r likewise of v_r,

    p, pi, pid    u = Kp e + I + Kd d + Kv v_r + Ka a_r
                  I(n) = I(n-1) + Ki T e(n)             held within +- integral_limit
                  d    = de/dt, or -dy/dt where it is of the position

    cascade       w = kp e + J + kv v_r                 held within +- velocity_limit
                  J(n) = J(n-1) + ki T e(n)             held within +- position_integral_limit
                  u = K (w - v) + I + Ka a_r
                  I(n) = I(n-1) + L T (w - v)           held within +- integral_limit

where v is the rate of y. Rates d and v go through a first-order filter of corner frequency F,

    x(n) = x(n-1) + (1 - exp(-2 pi F T)) (difference - x(n-1)),      no filter: x = the difference.

The output is u within +- output_limit. While it is limited, integrators wind up unless something is done
about it, `anti_windup`:

    conditional         an integrator that drives u further into the limit keeps its value
                        (that of the cascade's position loop also while w is limited)
    back_calculation    I += T / Tt (limited u - u), with the tracking time Tt; J is conditional
    none                nothing

The computation delay is not in here: who runs the law holds its output back (`closed_loop`).

Sources: K. J. Astrom, T. Hagglund, Advanced PID Control, ISA 2006, chapters 3 and 13.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from waferbot_lockstep.compiled import compiled
from waferbot_lockstep.layout import SHIPPED
from waferbot_plant.description import Controller

NONE, ON_POSITION, CASCADE = range(3)
"""Laws by number: an axis without one, p pi and pid, cascade."""

WINDS_UP, CONDITIONAL, BACK_CALCULATION = range(3)
"""What is done against windup."""


@functools.cache
def parameter_dtype(axes: int) -> np.dtype:
    """
    Return the dtype of the parameters of so many axes.

    `every`: cycles of the fastest controller in one of its own; shares are of 1.
    """
    return np.dtype(
        [
            (name, 'f8', (axes,))
            for name in (
                'step_s',
                'output_limit',
                'proportional',
                'integral',
                'derivative',
                'derivative_share',
                'derivative_of_position',
                'integral_limit',
                'tracking_share',
                'velocity_feedforward',
                'acceleration_feedforward',
                'position_gain',
                'position_integral',
                'position_integral_limit',
                'velocity_limit',
                'velocity_gain',
                'velocity_integral',
                'velocity_share',
            )
        ]
        + [(name, 'i8', (axes,)) for name in ('law', 'every', 'anti_windup')],
        align=True,
    )


@functools.cache
def state_dtype(axes: int) -> np.dtype:
    """
    Return the dtype of the state of so many axes.

    The values of the cycle before, filtered rate (d or v), integrators, and the output.
    """
    return np.dtype(
        [
            (name, 'f8', (axes,))
            for name in (
                'commanded',
                'commanded_velocity',
                'position',
                'error',
                'rate',
                'integral',
                'position_integral',
                'output',
            )
        ]
        + [(name, 'i8', (axes,)) for name in ('cycle',)],
        align=True,
    )


def cycle_hz(controllers: Mapping[str, Controller]) -> float:
    """Return the rate of the fastest controller, Hz."""
    return max(controller.rate for controller in controllers.values())


def law_parameters(
    controllers: Mapping[str, Controller], axes: Sequence[str] = SHIPPED.axes
) -> np.ndarray:
    """
    Return the parameters of the controllers of a machine's axes, a structured array of one element.

    Slower controllers act every so many cycles of the fastest, a whole number.
    """
    parameters = np.zeros(1, parameter_dtype(len(axes)))
    p = parameters[0]
    p['every'] = 1
    for place, axis in enumerate(axes):
        controller = controllers.get(axis)
        if controller is None:
            continue
        step_s = 1.0 / controller.rate
        values = {
            'law': CASCADE if controller.kind == 'cascade' else ON_POSITION,
            'every': round(cycle_hz(controllers) / controller.rate),
            'step_s': step_s,
            'anti_windup': {
                'none': WINDS_UP,
                'conditional': CONDITIONAL,
                'back_calculation': BACK_CALCULATION,
            }[controller.anti_windup],
            'tracking_share': (
                step_s / controller.tracking_time if controller.tracking_time else 0.0
            ),
            'derivative_of_position': controller.derivative_of == 'position',
            'derivative_share': _share(controller.derivative_filter, step_s),
            'velocity_share': _share(controller.velocity_filter, step_s),
        }
        for name in parameters.dtype.names or ():
            p[name][place] = values.get(name, getattr(controller, name, 0.0))
    return parameters


def _share(corner_hz: float, step_s: float) -> float:
    """Return how much of a step a first-order filter makes in one cycle."""
    return -math.expm1(-2.0 * math.pi * corner_hz * step_s) if corner_hz > 0.0 else 1.0


@compiled
def prime(state, parameters, commanded, position, velocity, integral):
    """
    Begin in the middle of a motion: no difference jumps.

    state: (1,), overwritten. `commanded`, `position` m or rad, `velocity` m/s or rad/s of both;
    `integral`: what the integrator makes of the output, in its unit; where only the position loop of a
    cascade has one, it is that. All (3,).
    """
    s = state[0]
    p = parameters[0]
    for i in range(len(commanded)):
        s['cycle'][i] = 0
        s['commanded'][i] = commanded[i] - velocity[i] * p['step_s'][i]
        s['commanded_velocity'][i] = velocity[i]
        s['position'][i] = position[i] - velocity[i] * p['step_s'][i]
        s['error'][i] = commanded[i] - position[i]
        s['rate'][i] = 0.0
        s['integral'][i] = 0.0
        s['position_integral'][i] = 0.0
        s['output'][i] = 0.0
        if p['law'][i] == CASCADE:
            s['rate'][i] = velocity[i]
        elif p['derivative_of_position'][i]:
            s['rate'][i] = -velocity[i]
        if p['integral'][i] > 0.0 or p['velocity_integral'][i] > 0.0:
            s['integral'][i] = _within(integral[i], p['integral_limit'][i])
        elif p['position_integral'][i] > 0.0:
            held = integral[i] / p['velocity_gain'][i]
            s['position_integral'][i] = _within(held, p['position_integral_limit'][i])


@compiled
def step(state, parameters, commanded, position, output):
    """
    Run one cycle of the fastest controller, and of those whose turn it is.

    state: (1,), advanced in place. parameters: (1,). commanded, position: float64 (axes,),
    m or rad. output: float64 (3,), out, each in its unit, before the computation delay; that of an
    axis whose turn it is not stands, that of one without a controller is 0.
    """
    s = state[0]
    p = parameters[0]
    for i in range(len(output)):
        if p['law'][i] == NONE:
            output[i] = 0.0
            continue
        if s['cycle'][i] == 0:
            _compute(s, p, i, commanded[i], position[i])
        s['cycle'][i] = (s['cycle'][i] + 1) % p['every'][i]
        output[i] = s['output'][i]


@compiled
def _compute(s, p, i, commanded, position):
    """Compute the output of controller i; leaves it in `s['output'][i]`."""
    step_s = p['step_s'][i]
    error = commanded - position
    commanded_velocity = (commanded - s['commanded'][i]) / step_s
    commanded_acceleration = (commanded_velocity - s['commanded_velocity'][i]) / step_s
    forward = p['acceleration_feedforward'][i] * commanded_acceleration
    velocity = (position - s['position'][i]) / step_s
    if p['law'][i] == ON_POSITION:
        difference = (error - s['error'][i]) / step_s
        if p['derivative_of_position'][i]:
            difference = -velocity
        s['rate'][i] += p['derivative_share'][i] * (difference - s['rate'][i])
        forward += p['proportional'][i] * error + p['derivative'][i] * s['rate'][i]
        forward += p['velocity_feedforward'][i] * commanded_velocity
        _limited_output(s, p, i, forward, p['integral'][i] * step_s * error)
    else:
        s['rate'][i] += p['velocity_share'][i] * (velocity - s['rate'][i])
        more = p['position_integral'][i] * step_s * error
        before = s['position_integral'][i]
        after = _within(before + more, p['position_integral_limit'][i])
        wanted = p['position_gain'][i] * error
        wanted += p['velocity_feedforward'][i] * commanded_velocity
        winds_up = p['anti_windup'][i] == WINDS_UP
        too_fast = abs(wanted + after) > p['velocity_limit'][i]
        if not winds_up and too_fast and (wanted + after) * more > 0.0:
            after = before
        slip = _within(wanted + after, p['velocity_limit'][i]) - s['rate'][i]
        forward += p['velocity_gain'][i] * slip
        beyond = _limited_output(s, p, i, forward, p['velocity_integral'][i] * step_s * slip)
        if not winds_up and beyond * more > 0.0:
            after = before
        s['position_integral'][i] = after
    s['commanded'][i] = commanded
    s['commanded_velocity'][i] = commanded_velocity
    s['position'][i] = position
    s['error'][i] = error


@compiled
def _limited_output(s, p, i, others, more):
    """
    Add the integrator to the other terms, and limit their sum.

    `more` is what the integrator gains in this cycle. Returns by how much the output was beyond its
    limit, signed.
    """
    limit = p['output_limit'][i]
    before = s['integral'][i]
    after = _within(before + more, p['integral_limit'][i])
    whole = others + after
    beyond = whole - _within(whole, limit)
    if p['anti_windup'][i] == CONDITIONAL and beyond * more > 0.0:
        after = before
        whole = others + after
    limited = _within(whole, limit)
    if p['anti_windup'][i] == BACK_CALCULATION:
        after = _within(after + p['tracking_share'][i] * (limited - whole), p['integral_limit'][i])
    s['integral'][i] = after
    s['output'][i] = limited
    return beyond


@compiled
def _within(value, limit):
    """Return a value held within +- limit."""
    return min(max(value, -limit), limit)


def initial_state(parameters: np.ndarray) -> np.ndarray:
    """Return a state, shape (1,), for these parameters; call `prime` before the first `step`."""
    return np.zeros(1, state_dtype(len(parameters['law'][0])))


@compiled
def replay(state, parameters, commanded, position, velocity, integral, output):
    """
    Run the law over commanded and measured positions (n, axes); fill `output` (n, axes).

    It begins with `velocity` and `integral` (3,), as `prime` does.
    """
    prime(state, parameters, commanded[0], position[0], velocity, integral)
    for cycle in range(len(commanded)):
        step(state, parameters, commanded[cycle], position[cycle], output[cycle])
