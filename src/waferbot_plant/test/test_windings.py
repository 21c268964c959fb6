# SPDX-License-Identifier: Apache-2.0
"""Windings alone: circuits whose answer is known, and the motion behind imperfect encoders."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from waferbot_plant import windings
from waferbot_plant.plant import load_machine

TICK_S = 1.0 / 18000.0
RESISTANCE, INDUCTANCE, BACK_EMF, PITCH = 2.0, 0.012, 127.0, 0.032
COUNTS_PER_M = 1e7


def description(winding='wye', sensors=None, errors=None):
    """Return a linear motor with an encoder of its own."""
    return load_machine(
        machines.write_single_mass(
            motors={
                'y_linear': {
                    'coordinate': 'travel',
                    'winding': winding,
                    'resistance_lead_to_lead_ohm': RESISTANCE,
                    'inductance_lead_to_lead_h': INDUCTANCE,
                    'back_emf_lead_to_lead_v_s_m': BACK_EMF,
                    'electrical_cycle_m': PITCH,
                }
            },
            encoders={
                'y_linear': {
                    'coordinate': 'travel',
                    'counts_per_m': COUNTS_PER_M,
                    **(errors or {}),
                }
            },
            **({'current_sensors': {'y_linear': sensors}} if sensors else {}),
        )
    ).description


def currents(parameters, position, voltage):
    """Return line currents 1 and 2 (n + 1, 2) of the motor of y_linear as its sensors show them."""
    state = windings.initial_state(parameters, np.zeros(6))
    shown, lines = [], np.zeros(6)
    for tick in range(len(voltage) + 1):
        windings.show(state, parameters, lines)
        shown.append(lines[:2].copy())
        if tick < len(voltage):
            before, after = (np.array([position[tick + k], 0.0, 0.0]) for k in range(2))
            terminals = np.concatenate([voltage[tick], np.zeros(6)])
            windings.advance(state, parameters, before, after, terminals, TICK_S, 1)
    return np.array(shown)


@pytest.mark.parametrize('winding', ['wye', 'delta'])
def test_a_voltage_between_two_leads_drives_the_current_of_a_coil(winding):
    """Standing: i = U / R_ll (1 - exp(-t R / L)) in at lead 1 and out at lead 2."""
    parameters = windings.winding_parameters(description(winding))
    ticks = 400
    found = currents(parameters, np.zeros(ticks + 1), np.tile([3.0, -3.0, 0.0], (ticks, 1)))
    time = TICK_S * np.arange(ticks + 1)
    expected = 6.0 / RESISTANCE * (1.0 - np.exp(-time * RESISTANCE / INDUCTANCE))
    assert found[:, 0] == pytest.approx(expected, abs=1e-5)
    assert found[:, 1] == pytest.approx(-expected, abs=1e-5)


@pytest.mark.parametrize('winding', ['wye', 'delta'])
def test_a_short_circuited_motor_that_is_moved_evenly(winding):
    """Steady line current of amplitude k v / |R + j w L|, of the equivalent star of each winding."""
    speed = 0.7
    parameters = windings.winding_parameters(description(winding))
    ticks = 4000
    position = speed * TICK_S * np.arange(ticks + 1)
    found = currents(parameters, position, np.zeros((ticks, 3)))
    turning = 2.0 * math.pi * speed / PITCH
    impedance = math.hypot(RESISTANCE / 2.0, turning * INDUCTANCE / 2.0)
    amplitude = BACK_EMF / math.sqrt(3.0) * speed / impedance
    last = found[3000:]
    squares = last[:, 0] ** 2 + last[:, 0] * last[:, 1] + last[:, 1] ** 2
    assert np.sqrt(4.0 / 3.0 * squares) == pytest.approx(amplitude, rel=1e-3)


def test_sensors_show_gain_and_offset_and_no_noise():
    sensors = {
        'gain_1': 0.1, 'gain_2': -0.2, 'offset_1_a': 0.3, 'offset_2_a': 0.0,
        'noise_a': 5.0, 'noise_seed': 3,
    }  # fmt: skip
    parameters = windings.winding_parameters(description(sensors=sensors))
    perfect = windings.winding_parameters(description())
    voltage = np.tile([3.0, -2.0, -1.0], (50, 1))
    # The state begins with no *shown* current, so the true one begins with what cancels the offset.
    state = windings.initial_state(parameters, np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    lines = np.zeros(6)
    windings.show(state, parameters, lines)
    assert lines[:2] == pytest.approx([0.3, 0.0])
    for place in range(50):
        windings.advance(
            state, parameters, np.zeros(3), np.zeros(3),
            np.concatenate([voltage[place], np.zeros(6)]), TICK_S, 1,
        )  # fmt: skip
    windings.show(state, parameters, lines)
    true = currents(perfect, np.zeros(51), voltage)[-1]
    assert lines[:2] == pytest.approx([1.1 * true[0] + 0.3, 0.8 * true[1]])


@given(
    scale=st.floats(-0.05, 0.05),
    amplitude_m=st.floats(0.0, 2e-5),
    phase=st.floats(-3.0, 3.0),
    ripple=st.floats(0.0, 5.0),
)
@example(scale=-0.046875, amplitude_m=6.028e-06, phase=0.0, ripple=3.0)
@settings(max_examples=25, deadline=None)
def test_positions_behind_an_imperfect_encoder(scale, amplitude_m, phase, ripple):
    """Counts made by the formula of the encoders' page are brought back to the path they came from."""
    errors = {
        'scale_error': scale,
        'eccentricity': {'amplitude_m': amplitude_m, 'period_m': 0.1, 'phase_rad': phase},
        'interpolation': {'amplitude_counts': ripple, 'period_counts': 200.0, 'phase_rad': phase},
    }
    parameters = windings.winding_parameters(description(errors=errors))
    path = 0.05 * np.sin(np.linspace(0.0, 6.0, 4000)) + 0.02
    ideal = COUNTS_PER_M * path
    seen = (1.0 + scale) * ideal
    seen += COUNTS_PER_M * amplitude_m * np.cos(2.0 * math.pi * path / 0.1 - phase)
    seen += ripple * np.cos(2.0 * math.pi * seen / 200.0 - phase)
    counts = np.zeros((len(path), 4))
    counts[:, 0] = seen
    found = windings.motor_positions(parameters, counts)[:, 0]
    assert COUNTS_PER_M * found == pytest.approx(ideal, abs=0.3)


def test_a_motor_without_an_encoder_stands_still():
    parameters = windings.winding_parameters(description())
    counts = np.full((10, 4), 5e4)
    positions = windings.motor_positions(parameters, counts)
    assert positions[:, 0] == pytest.approx(5e4 / COUNTS_PER_M)
    assert not positions[:, 1:].any()
