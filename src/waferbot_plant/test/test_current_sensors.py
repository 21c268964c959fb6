# SPDX-License-Identifier: Apache-2.0
"""Errors of current sensors: gains, offsets, noise, and what the ripples of the docstring are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from waferbot_plant import motors, plant
from waferbot_plant.plant import load_machine

CURRENTS = (3.0, -1.25)


def measured(sensors: dict, ticks: int = 1, first: int = 0) -> np.ndarray:
    """Return lines 1 and 2 of all motors as measured, (ticks, 6), with constant true currents."""
    machine = load_machine('rigid', overlays=[{'current_sensors': sensors}])
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    for motor in range(3):
        motors.set_line_currents(state, parameters, motor, CURRENTS)
    counts, lines = np.zeros(4, np.int64), np.zeros(6)
    told = []
    for tick in range(first, first + ticks):
        plant.measure(state, parameters, tick, counts, lines)
        told.append(lines.copy())
    return np.array(told)


def test_gain_and_offset_of_each_line() -> None:
    wrong = {'gain_1': 0.02, 'gain_2': -0.03, 'offset_1_a': 0.1, 'offset_2_a': -0.2}
    told = measured({'x_rotate': wrong})[0]
    assert told[2:4] == pytest.approx([1.02 * 3.0 + 0.1, 0.97 * -1.25 - 0.2], rel=1e-12)
    assert told[[0, 1, 4, 5]] == pytest.approx([3.0, -1.25, 3.0, -1.25], rel=1e-12)


def test_noise_is_white_of_its_rms_and_the_lines_have_their_own() -> None:
    number = 20000
    noise = {'noise_a': 0.05, 'noise_seed': 8}
    told = measured({'y_linear': noise, 'x_rotate': noise}, number)
    told = told - np.array([*CURRENTS] * 3)
    noisy = told[:, :4]
    assert noisy.std(axis=0) == pytest.approx([0.05] * 4, rel=4.0 / math.sqrt(2 * number))
    assert np.abs(noisy.mean(axis=0)).max() < 4.0 * 0.05 / math.sqrt(number)
    both = np.corrcoef(np.hstack([noisy[1:], noisy[:-1]]).T) - np.eye(8)
    assert np.abs(both).max() < 4.5 / math.sqrt(number)
    assert np.abs(told[:, 4:]).max() < 1e-12


def test_noise_depends_on_seed_and_tick_only() -> None:
    noise = {'y_linear': {'noise_a': 0.05, 'noise_seed': 8}}
    whole = measured(noise, 50)
    assert np.array_equal(measured(noise, 10, first=20), whole[20:30])
    other = measured({'y_linear': {'noise_a': 0.05, 'noise_seed': 9}}, 50)
    assert not np.any(other[:, 0] == whole[:, 0])


def test_neutral_values_are_no_effect_at_all() -> None:
    neutral = dict.fromkeys(('gain_1', 'gain_2', 'offset_1_a', 'offset_2_a', 'noise_a'), 0.0)
    assert np.array_equal(measured({'y_linear': neutral}), measured({}))
    machine = load_machine('rigid', overlays=[{'current_sensors': {'y_linear': neutral}}])
    assert not machine.parameters()['current_imperfect'].any()


def test_ripples_of_a_loop_that_believes_its_sensors() -> None:
    """True currents that look right: mean force falls by the mean gain, two periods remain."""
    gains = 1e-3 * np.array([4.0, -2.0])
    angle = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    lines = np.array([np.sin(angle), np.sin(angle - 2.0 * math.pi / 3.0)])
    true = lines / (1.0 + gains[:, None])
    machine = load_machine('rigid')
    parameters = machine.parameters()[0]
    force = np.array(
        [
            motors.force_of_line_currents(parameters, 1, one, *true[:, place])
            for place, one in enumerate(angle)
        ]
    )
    force /= motors.force_constant(machine.description.motors['x_rotate'])
    spectrum = np.fft.rfft(force) / len(angle)
    assert spectrum[0].real == pytest.approx(1.0 - gains.mean(), abs=2e-5)
    assert 2.0 * abs(spectrum[2]) == pytest.approx((gains[0] - gains[1]) / math.sqrt(3), rel=0.01)
    assert 2.0 * abs(spectrum[1]) < 1e-12
