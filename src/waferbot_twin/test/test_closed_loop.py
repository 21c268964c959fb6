# SPDX-License-Identifier: Apache-2.0
"""Modes of the closed loop against a textbook axis and against the running twin."""

from __future__ import annotations

import numpy as np
import pytest

from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import load_machine
from waferbot_twin.calibration.evaluation import servo_record
from waferbot_twin.calibration.values import calibrated
from waferbot_twin.closed_loop import fastest_growth, loop_modes
from waferbot_twin.engines.inprocess import Twin
from waferbot_twin.step_runs import step_plan

TIMING = Timing()


def test_rigid_y_rotate_has_the_loop_that_its_gains_ask_for() -> None:
    """The slow pair of Y-Rotate is that of wn and z, but for the delays of some 0.6 ms."""
    values = calibrated()
    wn = values['y_rotate_natural_frequency_rad_s']
    z = values['y_rotate_damping_ratio']
    machine = load_machine('rigid', timing=TIMING)
    servo = servo_record({})
    servo['Ixx33'] = 0  # no integrator: a plain second-order loop
    pairs = [mode for mode in loop_modes(machine, servo[0], TIMING) if mode.frequency_hz > 4.0]
    damped = wn * np.sqrt(1.0 - z**2) / (2.0 * np.pi)
    nearest = min(pairs, key=lambda mode: abs(mode.frequency_hz - damped))
    assert nearest.frequency_hz == pytest.approx(damped, rel=0.03)
    assert nearest.growth_rate == pytest.approx(-z * wn, rel=0.05)


def test_growth_rate_is_that_of_the_running_twin() -> None:
    """
    With the calculated damping and without friction a vibration grows, or decays, as predicted.

    The machine is let go with its bearings a little deflected, and the line of the slowest decaying
    structural mode is followed over 0.4 s of the running loop, too small for any limit to act.
    """
    plan = step_plan('calculated', 'y_linear')
    twin = Twin.of(plan.model, plan.timing, plan.experiment)
    twin.plant_parameters['friction_resistance'] = 0.0
    twin.plant_state = twin.machine.resting_state(twin.plant_parameters)
    twin.commanded[:] = 0.0
    modes = loop_modes(twin.machine, twin.servo_parameters[0], TIMING)
    predicted = next(mode for mode in modes if 300.0 < mode.frequency_hz < 1000.0)
    watched = [
        twin.machine.coordinates.index(name)
        for name in ('x_rotate_bearing_radial', 'payload_bearing_z')
    ]
    twin.plant_state[0]['position'][watched] += [3e-7, 3e-6]
    motion = np.empty(TIMING.ticks(0.4))
    for tick in range(len(motion)):
        twin.advance(1)
        motion[tick] = twin.plant_state[0]['position'][watched[0]]
    window = TIMING.ticks(0.05)
    lines, heights = [], []
    for start in range(2 * window, len(motion), window):
        bend = np.diff(motion[start : start + window], 2)
        spectrum = np.abs(np.fft.rfft(bend * np.hanning(len(bend)), 16 * len(bend)))
        frequency = np.fft.rfftfreq(16 * len(bend), TIMING.tick_s)
        near = np.abs(frequency - predicted.frequency_hz) < 25.0
        lines.append(frequency[near][np.argmax(spectrum[near])])
        heights.append(spectrum[near].max())
    seconds = 0.05 * np.arange(len(heights))
    growth = np.polyfit(seconds, np.log(heights), 1)[0]
    assert lines[-1] == pytest.approx(predicted.frequency_hz, abs=6.0)
    # 2 1/s is 0.1 % of critical damping here: what the lag of the current loop is known to.
    assert growth == pytest.approx(predicted.growth_rate, rel=0.1, abs=2.5)


def test_improved_damping_leaves_no_growing_mode() -> None:
    machine = load_machine('flexible', damping='improved', timing=TIMING)
    assert fastest_growth(loop_modes(machine, servo_record({})[0], TIMING), 30.0) < 0.0
