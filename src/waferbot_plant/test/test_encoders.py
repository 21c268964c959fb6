# SPDX-License-Identifier: Apache-2.0
"""Encoders: whole counts, rounded down, one phase cycle late, at the right ticks."""

from __future__ import annotations

import math

import numpy as np
import plant_machines as machines
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from waferbot_lockstep.timing import Timing
from waferbot_plant import encoders, plant
from waferbot_plant.plant import load_machine


def encoder_machine(divider: int = 2, delay: int = 1):
    """Return a slide with an encoder of 1e6 counts per m and no gravity."""
    return load_machine(
        machines.write_single_mass(
            gravity_m_s2=[0, 0, 0],
            encoders={'y_linear': {'coordinate': 'travel', 'counts_per_m': 1.0e6}},
            feedback={'delay_cycles': delay},
        ),
        timing=Timing(encoder_divider=divider, servo_divider=4 * divider),
    )


@pytest.mark.parametrize(('divider', 'delay'), [(2, 1), (1, 0), (2, 0), (3, 4), (2, 15)])
def test_counts_are_those_of_earlier_encoder_ticks(divider: int, delay: int) -> None:
    machine = encoder_machine(divider, delay)
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    counts = np.zeros(4, np.int64)
    lines = np.zeros(6)
    truth = []
    for tick in range(200):
        state[0]['position'][0] = 1e-4 * math.sin(0.05 * tick)
        truth.append(math.floor(1.0e6 * state[0]['position'][0]))
        counts[0] = 999_999_999
        plant.measure(state, parameters, tick, counts, lines)
        if tick % divider:
            assert counts[0] == 999_999_999
        else:
            assert counts[0] == truth[max(0, tick - delay * divider)]


@given(st.floats(-3.0, 3.0))
@settings(deadline=None, max_examples=200)
def test_counts_are_rounded_down(position: float) -> None:
    machine = SLIDE
    parameters = PARAMETERS
    state = machine.initial_state(parameters)
    state[0]['position'][0] = position
    count = encoders.read_encoder(parameters[0], state[0]['position'], 0)
    assert count == int(count)
    assert count <= 1.0e6 * position < count + 1


SLIDE = encoder_machine()
PARAMETERS = SLIDE.parameters()


def test_encoders_of_the_machine_count_in_their_units() -> None:
    """0.1 um, 2^20 per revolution at loads, 2^16 at a motor that turns 48 times as far."""
    machine = load_machine('rigid')
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['position'][:3] = 0.01, 0.25, 0.125
    counts = [
        encoders.read_encoder(parameters[0], state[0]['position'], place) for place in range(4)
    ]
    turn = 2.0 * math.pi
    assert counts == [
        math.floor(0.01 * 1e7),
        math.floor(0.25 / turn * 2**20),
        math.floor(0.125 / turn * 2**20),
        math.floor(48 * 0.125 / turn * 2**16),
    ]


def test_places_without_encoder_stay_zero() -> None:
    machine = encoder_machine()
    parameters = machine.parameters()
    state = machine.initial_state(parameters)
    state[0]['position'][0] = 0.5
    counts = np.full(4, 7, np.int64)
    lines = np.full(6, 7.0)
    for tick in range(4):
        plant.measure(state, parameters, tick, counts, lines)
    assert counts.tolist() == [500000, 0, 0, 0]
    assert not lines.any()


def test_joint_positions_are_those_of_the_axes() -> None:
    machine = load_machine('flexible')
    parameters = machine.parameters()
    state = machine.initial_state(parameters, {'y_linear': 0.1, 'x_rotate': 0.3, 'y_rotate': -0.2})
    position, velocity = np.zeros(3), np.zeros(3)
    plant.joint_positions(state, parameters, position, velocity)
    assert position == pytest.approx([0.1, 0.3, -0.2], rel=1e-14)
    assert not velocity.any()
