# SPDX-License-Identifier: Apache-2.0
"""The laws against scipy's discrete filters, and their limits against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from waferbot_plant.description import Controller
from waferbot_twin.controllers import law

RATE = 1000.0
STEP = 1.0 / RATE
AXIS, PLACE = 'x_rotate', 1
NOTHING = np.zeros(3)

SEED = 5


def controller(kind, **gains):
    return Controller(AXIS, kind, RATE, 'A', 1.0, 'A', **gains)


def outputs_of(one, commanded, position, integral=0.0, controllers=None):
    """Return the output (n,) of one controller over both (n,), from rest."""
    paths = np.zeros((2, len(commanded), 3))
    paths[0, :, PLACE], paths[1, :, PLACE] = commanded, position
    output = np.zeros((len(commanded), 3))
    start = np.array([0.0, integral, 0.0])
    parameters = law.law_parameters(controllers or {AXIS: one})
    law.replay(law.initial_state(parameters), parameters, *paths, NOTHING, start, output)
    return output[:, PLACE]


def paths(random, count=400):
    """Return a commanded and a measured path that both begin at zero and at rest."""
    noise = np.cumsum(random.standard_normal((2, count)), axis=1) * 1e-3
    return np.concatenate([np.zeros((2, 1)), noise], axis=1)


def filtered(corner_hz, values):
    share = -math.expm1(-2.0 * math.pi * corner_hz * STEP)
    return signal.lfilter([share], [1.0, share - 1.0], values)


def rate_of(values):
    return signal.lfilter([RATE, -RATE], [1.0], values)


def integral_of(values):
    """Backward rectangles: z T / (z - 1)."""
    return signal.lfilter([STEP], [1.0, -1.0], values)


def test_pid_is_the_sum_of_its_filters(random) -> None:
    commanded, position = paths(random)
    error = commanded - position
    one = controller(
        'pid', proportional=3.0, integral=20.0, derivative=0.04, derivative_filter=80.0,
        velocity_feedforward=0.5, acceleration_feedforward=0.002,
    )  # fmt: skip
    expected = 3.0 * error + 20.0 * integral_of(error) + 0.04 * filtered(80.0, rate_of(error))
    expected += 0.5 * rate_of(commanded) + 0.002 * rate_of(rate_of(commanded))
    assert outputs_of(one, commanded, position) == pytest.approx(expected, abs=1e-9)


def test_derivative_of_the_position_does_not_answer_to_the_command(random) -> None:
    commanded, position = paths(random)
    one = controller('pid', proportional=3.0, derivative=0.04, derivative_of='position')
    expected = 3.0 * (commanded - position) - 0.04 * rate_of(position)
    assert outputs_of(one, commanded, position) == pytest.approx(expected, abs=1e-9)


def test_cascade_is_the_sum_of_its_filters(random) -> None:
    commanded, position = paths(random)
    error = commanded - position
    one = controller(
        'cascade', position_gain=40.0, position_integral=300.0, velocity_gain=0.7,
        velocity_integral=9.0, velocity_filter=120.0, velocity_feedforward=0.8,
        acceleration_feedforward=0.01,
    )  # fmt: skip
    wanted = 40.0 * error + 300.0 * integral_of(error) + 0.8 * rate_of(commanded)
    slip = wanted - filtered(120.0, rate_of(position))
    expected = 0.7 * slip + 9.0 * integral_of(slip) + 0.01 * rate_of(rate_of(commanded))
    assert outputs_of(one, commanded, position) == pytest.approx(expected, abs=1e-8)


def test_limits_hold_and_a_cascade_keeps_its_speed() -> None:
    far = np.ones(50)
    one = controller('cascade', position_gain=40.0, velocity_gain=0.7, velocity_limit=2.0)
    assert outputs_of(one, far, np.zeros(50)) == pytest.approx(0.7 * 2.0)
    limited = replace(one, output_limit=0.3)
    assert outputs_of(limited, far, np.zeros(50)) == pytest.approx(0.3)
    held = controller('pi', proportional=1.0, integral=100.0, integral_limit=0.25)
    assert outputs_of(held, far, np.zeros(50))[-1] == pytest.approx(1.25)


def cycles_until_it_turns(anti_windup, tracking_time=0.0):
    """Cycles after the error has turned that a saturated output stays at its upper limit."""
    error = np.concatenate([np.ones(300), -np.ones(300)])
    one = controller(
        'pi', proportional=0.5, integral=10.0, output_limit=1.0, anti_windup=anti_windup,
        tracking_time=tracking_time,
    )  # fmt: skip
    output = outputs_of(one, error, np.zeros(600))
    return int(np.count_nonzero(output[300:] >= 1.0))


def test_windup_lasts_as_long_as_its_closed_form_and_each_remedy_ends_it() -> None:
    # Without a remedy I has grown to Ki t = 3, and shrinks by 0.01 a cycle until I - 0.5 < 1.
    assert cycles_until_it_turns('none') == pytest.approx(150, abs=1)
    assert cycles_until_it_turns('conditional') == 0
    assert cycles_until_it_turns('back_calculation', 0.005) == 0


def test_back_calculation_settles_where_it_balances() -> None:
    """Saturated with error e: I settles at limit - Kp e + Ki e Tt (less a cycle's Ki T e)."""
    one = controller(
        'pi', proportional=0.5, integral=10.0, output_limit=1.0, anti_windup='back_calculation',
        tracking_time=0.02,
    )  # fmt: skip
    error = np.concatenate([np.ones(800), [0.0]])
    # With the error gone, what is left is the integrator.
    left = outputs_of(one, error, np.zeros(801))[-1]
    assert left == pytest.approx(1.0 - 0.5 + 10.0 * 0.02 - 10.0 * STEP, abs=1e-9)


@pytest.mark.parametrize(
    'one',
    [
        controller('pid', proportional=3.0, integral=20.0, derivative=0.1),
        controller('cascade', position_gain=40.0, velocity_gain=0.7, velocity_integral=9.0),
        controller('cascade', position_gain=40.0, velocity_gain=0.7, position_integral=9.0),
    ],
    ids=['pid', 'cascade', 'position integral'],
)
def test_an_integrator_begins_with_what_it_is_given(one) -> None:
    still = np.full(20, 0.3)
    assert outputs_of(one, still, still, integral=1.7) == pytest.approx(1.7)


def test_a_motion_can_begin_at_speed(random) -> None:
    """No difference jumps: an axis that follows exactly asks for nothing but its feedforward."""
    time_s = STEP * np.arange(50)
    path = np.zeros((50, 3))
    path[:, PLACE] = 2.0 * time_s
    one = controller('pid', proportional=3.0, derivative=0.1, velocity_feedforward=0.25)
    output = np.zeros((50, 3))
    speed = np.array([0.0, 2.0, 0.0])
    parameters = law.law_parameters({AXIS: one})
    law.replay(law.initial_state(parameters), parameters, path, path, speed, NOTHING, output)
    assert output[:, PLACE] == pytest.approx(0.5)


def test_a_slower_controller_acts_in_every_so_many_cycles(random) -> None:
    commanded, position = paths(random)
    slow = controller('p', proportional=2.0)
    fast = replace(slow, axis='y_linear', rate=4.0 * RATE)
    output = outputs_of(slow, commanded, position, controllers={AXIS: slow, 'y_linear': fast})
    expected = 2.0 * np.repeat((commanded - position)[::4], 4)[: len(commanded)]
    assert output == pytest.approx(expected)
