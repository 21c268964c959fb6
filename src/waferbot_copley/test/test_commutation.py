# SPDX-License-Identifier: Apache-2.0
"""Commutation against NumPy's trigonometry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from waferbot_copley.commutation import (
    amplitude_squared,
    electrical_turn,
    sine_and_cosine,
    to_lines,
    to_rotor_frame,
)

turns = st.floats(0.0, 1.0, exclude_max=True)
amperes = st.floats(-1e3, 1e3)


@given(turns)
def test_sine_and_cosine_are_accurate(turn):
    """As accurate as the C library on the rounded argument."""
    sine, cosine = sine_and_cosine(turn)
    assert sine == pytest.approx(math.sin(2 * math.pi * turn), abs=7e-16)
    assert cosine == pytest.approx(math.cos(2 * math.pi * turn), abs=7e-16)


def test_quarter_turns_are_exact():
    """The four axis directions carry no rounding at all."""
    quarters = [sine_and_cosine(0.25 * q) for q in range(4)]
    assert quarters == [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]


@given(st.integers(-(2**50), 2**50), st.integers(1, 10**9))
def test_whole_cycles_do_not_matter(counts, cycle):
    """The angle repeats with the electrical cycle, also for negative counts and far from zero."""
    turn = electrical_turn(counts, float(cycle), 0.0)
    exact = (counts % cycle) / cycle
    distance = abs(turn - exact)
    assert 0.0 <= turn < 1.0
    assert min(distance, 1.0 - distance) <= 1e-15 * (1 + abs(counts) / cycle)


def test_offset_shifts_the_angle_and_wraps():
    """An offset is added, and the sum stays within one turn."""
    assert electrical_turn(75, 100.0, 0.5) == pytest.approx(0.25)
    assert electrical_turn(0, 100.0, -0.25) == pytest.approx(0.75)
    assert electrical_turn(0, 100.0, -1e-18) == 0.0
    assert electrical_turn(25, -100.0, 0.0) == pytest.approx(0.75)


@given(turns, amperes)
def test_force_current_follows_the_phasing(turn, amplitude):
    """A vector along q is the sine of eq. (3.1) in all three lines."""
    line_1, line_2 = to_lines(0.0, amplitude, *sine_and_cosine(turn))
    expected = amplitude * np.sin(2 * np.pi * turn - 2 * np.pi / 3 * np.arange(3))
    assert np.allclose([line_1, line_2, -(line_1 + line_2)], expected, rtol=0, atol=1e-11)


@given(turns, amperes, amperes)
def test_rotor_frame_there_and_back(turn, d, q):
    """Lines and rotor frame are inverse to one another, and keep the amplitude."""
    angle = sine_and_cosine(turn)
    lines = to_lines(d, q, *angle)
    assert to_rotor_frame(*lines, *angle) == pytest.approx((d, q), abs=1e-11)
    assert amplitude_squared(*lines) == pytest.approx(d * d + q * q, rel=1e-11, abs=1e-11)
